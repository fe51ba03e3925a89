"""Fan-out of independent tasks over Ray; no other module imports it.

Tasks are bounded in flight, outcomes come as they finish, and a task whose worker or node died, or that raised, is
given to another worker with the same arguments, so what comes out does not depend on luck. What decides (retries, time
limits, order) is in the driver.
"""

import os
import signal
import socket
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import FrameType, TracebackType
from typing import Any, Generic, Literal, TypeVar

os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")

import ray
from ray.exceptions import GetTimeoutError, RayError, RayTaskError

from pipeline import interrupt
from pipeline.config import Cluster, UserError

OBJECT_STORE_BYTES = 512 * 2**20
"""For the few megabytes that all tasks share; Ray's default takes 30 % of the memory."""
IN_FLIGHT_PER_SLOT = 2
"""One runs, one waits: a worker never idles while the driver is busy."""
HEARTBEAT_S = 1.0
HARD_LIMIT_GRACE_S = 60.0
"""A task that does not react to its time limit (a hang in compiled code) has its worker killed after this much more."""
EXCEPTION_RETRIES = 1
CONNECT_TIMEOUT_S = 5.0

Item = TypeVar("Item")
Value = TypeVar("Value")


@dataclass(frozen=True)
class Failure:
    """Why a task has no value, after all its retries."""

    kind: Literal["error", "timeout", "crash"]
    message: str


@dataclass(frozen=True)
class Outcome(Generic[Item, Value]):
    """A finished task: its item, and a value or a failure. ``attempt`` counts from 1."""

    item: Item
    attempt: int
    value: Value | None = None
    failure: Failure | None = None


@dataclass(frozen=True)
class _Task(Generic[Item]):
    item: Item
    attempt: int = 1
    crashes: int = 0
    submitted_s: float = field(default_factory=time.monotonic)
    killed: bool = False

    def again(self, *, crashed: bool) -> "_Task[Item]":
        return replace(self, attempt=self.attempt + 1, crashes=self.crashes + crashed, submitted_s=time.monotonic())


class TaskTimeoutError(Exception):
    """Raised inside a task that has reached its time limit."""


class Pool:
    """Workers of one cluster; Ray starts with the first task and stops when the pool is closed."""

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster
        self._slots = 0
        self._owns_ray = False

    def __enter__(self) -> "Pool":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._owns_ray:
            ray.shutdown()

    @property
    def slots(self) -> int:
        """How many tasks run at once, by cores and memory."""
        if not self._slots:
            if not ray.is_initialized():
                _start(self._cluster)
                self._owns_ray = True
            self._slots = _count_slots(self._cluster)
        return self._slots

    def run(
        self, function: Callable[..., Value], items: Iterable[Item], *shared: Any, timeout_s: float | None = None
    ) -> Iterator[Outcome[Item, Value] | None]:
        """Runs ``function(item, *shared)`` for each item and yields outcomes as they finish.

        About once a second without an outcome, None is yielded, so that the caller can do what is due. ``shared``
        values are sent to each worker once. Leaving the loop early stops the tasks under way.
        """
        slots = self.slots
        memory_bytes = int(self._cluster.memory_per_task_gb * 2**30)
        call: Any = ray.remote(num_cpus=1, memory=memory_bytes, max_retries=0)(_call)
        references = [ray.put(value) for value in shared]
        source, again = iter(items), deque[_Task[Item]]()
        in_flight: dict[Any, _Task[Item]] = {}
        try:
            while True:
                interrupt.check()
                while len(in_flight) < slots * IN_FLIGHT_PER_SLOT and (task := _next(again, source)) is not None:
                    in_flight[call.remote(function, task.item, references, timeout_s)] = task
                if not in_flight:
                    return
                ready, _ = ray.wait(list(in_flight), timeout=HEARTBEAT_S)
                if not ready:
                    _kill_hung(in_flight, timeout_s)
                    yield None
                for reference in ready:
                    outcome: Outcome[Item, Value] | _Task[Item] = self._settle(in_flight.pop(reference), reference)
                    if isinstance(outcome, _Task):
                        again.append(outcome)
                    else:
                        yield outcome
        finally:
            for reference in in_flight:
                ray.cancel(reference, force=True)

    def _settle(self, task: _Task[Item], reference: Any) -> Outcome[Item, Value] | _Task[Item]:
        """A finished task's outcome, or the task to run again."""
        try:
            value, failure = ray.get(reference)
        except RayTaskError as error:  # what the task gave could not be sent back
            value, failure = None, Failure("error", str(error))
        except RayError as error:
            if task.killed:
                value, failure = None, Failure("timeout", "did not react to its time limit; its worker was stopped")
            elif task.crashes < self._cluster.retries:
                return task.again(crashed=True)
            else:
                value, failure = None, Failure("crash", f"its worker died {task.crashes + 1} times: {error}")
        if failure is not None and failure.kind == "error" and task.attempt - task.crashes <= EXCEPTION_RETRIES:
            return task.again(crashed=False)
        return Outcome(task.item, task.attempt, value, failure)


def _next(again: deque[_Task[Item]], source: Iterator[Item]) -> _Task[Item] | None:
    if again:
        return again.popleft()
    for item in source:
        return _Task(item)
    return None


def _kill_hung(in_flight: dict[Any, _Task[Item]], timeout_s: float | None) -> None:
    if timeout_s is None:
        return
    # A task may have waited for the one before it on its worker.
    limit_s = timeout_s * IN_FLIGHT_PER_SLOT + HARD_LIMIT_GRACE_S
    for reference, task in in_flight.items():
        if not task.killed and time.monotonic() - task.submitted_s > limit_s:
            in_flight[reference] = replace(task, killed=True)
            ray.cancel(reference, force=True)


def _call(
    function: Callable[..., Value], item: Any, references: list[Any], timeout_s: float | None
) -> tuple[Value | None, Failure | None]:
    """Runs in the worker. Exceptions come back as text: they may not survive pickling, and the driver needs no more."""
    try:
        shared = [_fetch(reference) for reference in references]
        with _time_limit(timeout_s):
            return function(item, *shared), None
    except TaskTimeoutError:
        return None, Failure("timeout", f"stopped after {timeout_s:g} s")
    except Exception:
        return None, Failure("error", traceback.format_exc())


_fetched: dict[str, Any] = {}


def _fetch(reference: Any) -> Any:
    """A shared value, unpickled once per worker and kept until another run's values take its place."""
    key = reference.hex()
    if key not in _fetched:
        while len(_fetched) > 8:
            del _fetched[next(iter(_fetched))]
        _fetched[key] = ray.get(reference)
    return _fetched[key]


@contextmanager
def _time_limit(seconds: float | None) -> Iterator[None]:
    if seconds is None:
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise TaskTimeoutError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _start(cluster: Cluster) -> None:
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
    if cluster.address == "local":
        cpus = cluster.cpus or len(os.sched_getaffinity(0))
        options |= {"num_cpus": cpus, "include_dashboard": False, "object_store_memory": OBJECT_STORE_BYTES}
    elif cluster.address != "auto":
        _check_reachable(cluster.address)
    try:
        ray.init(address=cluster.address, **options)
    except (ConnectionError, RuntimeError, ValueError, OSError, GetTimeoutError) as error:
        raise UserError(
            f"cluster.address={cluster.address}: Ray cannot be used there: {error}. "
            "Use cluster.address=local for this machine, auto inside a cluster, or ray://host:10001"
        ) from error


def _check_reachable(address: str) -> None:
    """Ray itself takes minutes to say that nobody answers."""
    host, _, port = address.removeprefix("ray://").partition("/")[0].rpartition(":")
    try:
        socket.create_connection((host, int(port)), CONNECT_TIMEOUT_S).close()
    except (OSError, ValueError) as error:
        raise UserError(
            f"cluster.address={address}: nobody answers there ({error}). "
            "Use cluster.address=local for this machine, auto inside a cluster, or ray://host:10001"
        ) from error


def _count_slots(cluster: Cluster) -> int:
    need_bytes = cluster.memory_per_task_gb * 2**30
    resources = [node["Resources"] for node in ray.nodes() if node["Alive"]]  # type: ignore[no-untyped-call]
    slots = sum(min(int(one.get("CPU", 0)), int(one.get("memory", 0) / need_bytes)) for one in resources)
    if slots == 0:
        most_gb = max((one.get("memory", 0) for one in resources), default=0) / 2**30
        raise UserError(
            f"cluster.memory_per_task_gb={cluster.memory_per_task_gb:g}: no node has that much; at most {most_gb:.1f}"
        )
    return min(slots, cluster.cpus) if cluster.cpus else slots
