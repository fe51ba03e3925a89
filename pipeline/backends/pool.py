"""Runs independent items on Ray's workers; no other module imports Ray.

The number of items in flight is bounded, outcomes come as they finish, and an item that raised, or whose worker or node
died, goes to another worker with the same arguments, so results do not depend on luck. The driver makes all decisions
(retries, time limits, order).

A Ray task costs some milliseconds of CPU time whatever it does, so short items go out in batches that last `BATCH_S`.
"""

import os
import signal
import socket
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from itertools import islice
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar, cast

import lazy_loader

from pipeline.base import console, interrupt
from pipeline.base.config import UserError
from pipeline.base.sections import Cluster

if TYPE_CHECKING:
    import ray
    from ray.exceptions import RayError
else:
    ray = lazy_loader.load("ray")  # takes a second to import, and a run that has nothing to do needs no workers

OBJECT_STORE_BYTES = 512 * 2**20
"""Enough for the few megabytes that all tasks share; Ray would take 30 % of the memory."""
IN_FLIGHT_PER_SLOT = 2
"""One runs, one waits: a worker never idles while the driver is busy."""
BATCH_S = 0.5
"""How long a batch of short items should take: much longer than Ray needs for a task, much shorter than a run."""
LARGEST_BATCH = 100
PACE_WEIGHT = 0.3
"""The weight of the last batch in the moving average of the time for an item."""
HEARTBEAT_S = 1.0
HARD_LIMIT_GRACE_S = 60.0
"""A task that does not react to its time limit (a hang in compiled code) has its worker killed after this much more."""
EXCEPTION_RETRIES = 1
CONNECT_TIMEOUT_S = 5.0
ADDRESSES = "Use cluster.address=local for this machine, auto inside a cluster, or ray://host:10001"

Item = TypeVar("Item")
Value = TypeVar("Value")


@dataclass(frozen=True)
class Failure:
    """Why an item has no value, after all its retries."""

    kind: Literal["error", "timeout", "crash"]
    message: str


@dataclass(frozen=True)
class Outcome(Generic[Item, Value]):
    """A finished item with its value or its failure. ``attempt`` counts from 1."""

    item: Item
    attempt: int
    value: Value | None = None
    failure: Failure | None = None


@dataclass(frozen=True)
class _Try(Generic[Item]):
    """An item on its way to a worker: how often it was sent, how often it raised, how often its worker died."""

    item: Item
    attempt: int = 1
    errors: int = 0
    crashes: int = 0

    def again(self, *, errors: int = 0, crashes: int = 0) -> "_Try[Item]":
        return replace(self, attempt=self.attempt + 1, errors=self.errors + errors, crashes=self.crashes + crashes)


@dataclass(frozen=True)
class _Batch(Generic[Item]):
    """The items that one Ray task runs, one after the other."""

    tries: list[_Try[Item]]
    submitted_s: float = field(default_factory=time.monotonic)
    killed: bool = False


class _Pace:
    """Chooses how many items make a batch, by how long they took so far."""

    def __init__(self) -> None:
        self._mean_s: float | None = None

    def note(self, items: int, seconds: float) -> None:
        """Note a finished batch."""
        each_s = seconds / items
        before_s = each_s if self._mean_s is None else self._mean_s
        self._mean_s = before_s + PACE_WEIGHT * (each_s - before_s)

    @property
    def items(self) -> int:
        """How many items the next batch has."""
        if self._mean_s is None:
            return 1
        return max(1, min(LARGEST_BATCH, int(BATCH_S / max(self._mean_s, BATCH_S / LARGEST_BATCH))))


class TaskTimeoutError(Exception):
    """Raised inside an item's run that has reached its time limit."""


class ItemError(RuntimeError):
    """An item failed whose value is needed."""


class Pool(AbstractContextManager["Pool"]):
    """Workers of one cluster; Ray starts with the first task and stops when the pool is closed."""

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster
        self._slots = 0
        self._alone = True
        self._owns_ray = False

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._owns_ray:
            ray.shutdown()

    def start(self) -> None:
        """Connect now, so that an unusable cluster is reported before there is anything to undo."""
        _ = self.slots

    @property
    def slots(self) -> int:
        """How many items run at once, by cores and memory."""
        if not self._slots:
            if not ray.is_initialized():
                _start(self._cluster)
                self._owns_ray = True
            there = _count_slots(self._cluster)
            self._slots = min(there, self._cluster.cpus or there)
            # Where the cluster has more slots than this run may use, a waiting batch would run on one of the others.
            self._alone = self._slots == there
        return self._slots

    def run(
        self, function: Callable[..., Value], items: Iterable[Item], *shared: Any, timeout_s: float | None = None
    ) -> Iterator[Outcome[Item, Value] | None]:
        """Run ``function(item, *shared)`` for each item and yield outcomes as they finish.

        Yields None about once a second while no outcome comes, so that the caller can do other work. Each worker gets
        the ``shared`` values once. Leaving the loop early stops the items under way.
        """
        most_in_flight = self.slots * (IN_FLIGHT_PER_SLOT if self._alone else 1)
        memory_bytes = int(self._cluster.memory_per_task_gb * 2**30)
        call: Any = ray.remote(num_cpus=1, memory=memory_bytes, max_retries=0)(_call)
        references = [ray.put(value) for value in shared]
        source, again, pace = iter(items), deque[_Try[Item]](), _Pace()
        in_flight: dict[Any, _Batch[Item]] = {}
        try:
            while True:
                interrupt.check()
                while len(in_flight) < most_in_flight and (tries := _next(again, source, pace.items)):
                    sent = call.remote(function, [one.item for one in tries], references, timeout_s)
                    in_flight[sent] = _Batch(tries)
                if not in_flight:
                    return
                ready, _ = ray.wait(list(in_flight), timeout=HEARTBEAT_S)
                if not ready:
                    _kill_hung(in_flight, timeout_s)
                    yield None
                for reference in ready:
                    settled: Outcome[Item, Value] | _Try[Item]
                    for settled in self._settle(in_flight.pop(reference), reference, pace):
                        if isinstance(settled, _Try):
                            again.append(settled)
                        else:
                            yield settled
        finally:
            # Our own Ray ends with the process. It may abort when a task answers that was just cancelled (seen: exit
            # code 1, "Tried to complete task that was not pending").
            if not (self._owns_ray and interrupt.requested()):
                for reference in in_flight:
                    ray.cancel(reference, force=True)

    def values(
        self,
        function: Callable[..., Value],
        items: Sequence[Item],
        *shared: Any,
        unit: str,
        named: Callable[[Item], object] = str,
    ) -> Iterator[tuple[Item, Value]]:
        """Run ``function(item, *shared)`` for each item and yield items with their values as they finish.

        A progress bar counts them in ``unit``; ``named`` says in an error which item it was.

        Raises:
            ItemError: an item failed, after all its retries.
        """
        with console.Progress(len(items), unit) as progress:
            for outcome in self.run(function, items, *shared):
                if outcome is None:
                    progress.update(0)
                    continue
                if outcome.failure is not None:
                    raise ItemError(f"{unit}: {named(outcome.item)} failed: {outcome.failure.message}")
                progress.update()
                yield outcome.item, cast(Value, outcome.value)

    def _settle(self, batch: _Batch[Item], reference: Any, pace: _Pace) -> Iterator[Outcome[Item, Value] | _Try[Item]]:
        """Yield the outcomes of a batch, and the items of it that must run again."""
        try:
            results, seconds = ray.get(reference)
            pace.note(len(results), seconds)
        except ray.exceptions.RayError as error:
            if len(batch.tries) > 1:  # one of them is to blame; run alone, it shows itself
                yield from (one.again() for one in batch.tries)
            else:
                yield self._after_loss(batch, error)
            return
        for one, (value, failure) in zip(batch.tries, results, strict=True):
            if failure is not None and failure.kind == "error" and one.errors < EXCEPTION_RETRIES:
                yield one.again(errors=1)
            else:
                yield Outcome(one.item, one.attempt, value, failure)

    def _after_loss(self, batch: _Batch[Item], error: "RayError") -> Outcome[Item, Value] | _Try[Item]:
        """Return what becomes of an item whose worker returned nothing."""
        [one] = batch.tries
        if isinstance(error, ray.exceptions.RayTaskError):  # its value could not be sent back
            if one.errors < EXCEPTION_RETRIES:
                return one.again(errors=1)
            failure = Failure("error", str(error))
        elif batch.killed:
            failure = Failure("timeout", "did not react to its time limit; its worker was stopped")
        elif one.crashes < self._cluster.retries:
            return one.again(crashes=1)
        else:
            failure = Failure("crash", f"its worker died {one.crashes + 1} times: {error}")
        return Outcome(one.item, one.attempt, None, failure)


def _next(again: deque[_Try[Item]], source: Iterator[Item], most: int) -> list[_Try[Item]]:
    """Return the next batch, empty when nothing is left; an item that runs again runs alone."""
    if again:
        return [again.popleft()]
    return [_Try(item) for item in islice(source, most)]


def _kill_hung(in_flight: dict[Any, _Batch[Item]], timeout_s: float | None) -> None:
    if timeout_s is None:
        return
    for reference, batch in in_flight.items():
        # It may have waited for an earlier batch on its worker.
        limit_s = timeout_s * len(batch.tries) * IN_FLIGHT_PER_SLOT + HARD_LIMIT_GRACE_S
        if not batch.killed and time.monotonic() - batch.submitted_s > limit_s:
            in_flight[reference] = replace(batch, killed=True)
            ray.cancel(reference, force=True)


def _call(
    function: Callable[..., Value], items: list[Any], references: list[Any], timeout_s: float | None
) -> tuple[list[tuple[Value | None, Failure | None]], float]:
    """Run a batch in the worker; return the outcome of each item, and the seconds that all took."""
    shared = [_fetch(reference) for reference in references]
    began_s = time.monotonic()
    results = [_try(function, item, shared, timeout_s) for item in items]
    return results, time.monotonic() - began_s


def _try(
    function: Callable[..., Value], item: Any, shared: list[Any], timeout_s: float | None
) -> tuple[Value | None, Failure | None]:
    """Run one item. Exceptions come back as text: they may not survive pickling, and the driver needs no more."""
    try:
        with _time_limit(timeout_s):
            return function(item, *shared), None
    except TaskTimeoutError:
        return None, Failure("timeout", f"stopped after {timeout_s:g} s")
    except Exception:
        return None, Failure("error", traceback.format_exc())


_fetched: dict[str, Any] = {}


def _fetch(reference: Any) -> Any:
    """Return a shared value, unpickled once per worker and kept until another run's values replace it."""
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
    except Exception as error:  # Ray raises a bare one where its start takes too long
        said = " ".join(str(error).split()).rstrip(".")
        raise UserError(
            f"cluster.address={cluster.address}: Ray cannot be used there: {said}. {ADDRESSES}; "
            "where the cluster asks for a token, set RAY_AUTH_MODE=token; where the start took too long, run it again"
        ) from error


def _check_reachable(address: str) -> None:
    """Check quickly that somebody answers; Ray itself takes minutes to notice."""
    host, _, port = address.removeprefix("ray://").partition("/")[0].rpartition(":")
    try:
        socket.create_connection((host, int(port)), CONNECT_TIMEOUT_S).close()
    except (OSError, ValueError) as error:
        raise UserError(f"cluster.address={address}: nobody answers there ({error}). {ADDRESSES}") from error


def _count_slots(cluster: Cluster) -> int:
    """Return how many items all nodes could run at once."""
    need_bytes = cluster.memory_per_task_gb * 2**30
    resources = [node["Resources"] for node in ray.nodes() if node["Alive"]]  # type: ignore[no-untyped-call]
    slots = sum(min(int(one.get("CPU", 0)), int(one.get("memory", 0) / need_bytes)) for one in resources)
    if slots == 0:
        most_gb = max((one.get("memory", 0) for one in resources), default=0) / 2**30
        raise UserError(
            f"cluster.memory_per_task_gb={cluster.memory_per_task_gb:g}: no node has that much; at most {most_gb:.1f}"
        )
    return slots
