"""Runs independent items on Ray's workers; no other module imports Ray but `pipeline.backends.nodes`.

The number of items in flight is bounded, outcomes come as they finish, and an item that raised, or whose worker or node
died, goes to another worker with the same arguments, so results do not depend on luck. The driver makes all decisions
(retries, time limits, order).

Before a worker runs anything, it compares the code that it would run with the driver's; a node with other code is left
out. What does that comparison is sent along as it stands, so that a node with an older build cannot answer by its own.

A Ray task costs some milliseconds of CPU time whatever it does, so short items go out in batches that last `BATCH_S`.
"""

import os
import secrets
import shutil
import signal
import socket
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar, cast

import lazy_loader

from mrtask.names import counted
from pipeline.backends.nodes import HeadLost, Nodes, host_and_port
from pipeline.base import console, interrupt
from pipeline.base.config import UserError
from pipeline.base.sections import Cluster
from pipeline.store.version import worker_code

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
LOCAL = "local"
"""The address that stands for this machine's cores."""
COMPARING = worker_code.__module__
"""The module whose ``differences_in_code`` workers call."""
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
    node: str | None = None
    """The name of the machine that ran it; None where its worker died."""


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
class _Reply:
    """What a worker's answer holds."""

    node_id: str
    node: str
    differences: list[str]
    """In which parts its code is not the driver's; if there are any, nothing was run."""
    results: list[tuple[Any, Failure | None]]
    seconds: float


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
        self._nodes: Nodes | None = None
        self._owns_ray = False
        self._session: Path | None = None
        self._runs = 0
        self._lock = threading.RLock()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._owns_ray:
            ray.shutdown()
        if self._session is not None:
            shutil.rmtree(self._session, ignore_errors=True)

    def start(self) -> None:
        """Connect now, so that an unusable cluster is reported before there is anything to undo."""
        self._joined()

    @property
    def slots(self) -> int:
        """How many items run at once, by cores and memory; it changes as nodes come and go."""
        there = self._joined().slots
        return min(there, self._cluster.cpus or there)

    @property
    def workers(self) -> str:
        """The same as text: ``8 workers``."""
        return counted(self.slots, "worker")

    @property
    def occupied(self) -> int:
        """How many of the slots others use at the moment."""
        return max(0, self.slots - self._joined().free_cores)

    def _joined(self) -> Nodes:
        with self._lock:  # cells of a sweep may run in several threads
            if self._nodes is None:
                if self._cluster.address == LOCAL:
                    _keep_to_this_machine()
                if not ray.is_initialized():
                    self._session = _start(self._cluster)
                    self._owns_ray = True
                self._nodes = Nodes(self._cluster)
            return self._nodes

    @property
    def _most_in_flight(self) -> int:
        """How many batches a run sends at once: more than run, so that no worker idles and clusters that can grow do.

        Where the cluster has more slots than this run may use, a waiting batch would run on one of the others. Runs in
        several threads share the slots.
        """
        alone = self.slots == self._joined().slots
        return max(1, self.slots * (IN_FLIGHT_PER_SLOT if alone else 1) // max(1, self._runs))

    def run(
        self,
        function: Callable[..., Value],
        items: Iterable[Item],
        *shared: Any,
        timeout_s: float | None = None,
        modules: Iterable[str] = (),
    ) -> Iterator[Outcome[Item, Value] | None]:
        """Run ``function(item, *shared)`` for each item and yield outcomes as they finish.

        Yields None about once a second while no outcome comes, so that the caller can do other work. Each worker gets
        the ``shared`` values once. Leaving the loop early stops the items under way. ``modules`` are those of the
        user's own that the function imports by name; their code must be the driver's too.

        Raises:
            HeadLost: the cluster's head is gone.
            UserError: no node can be used, or none runs the driver's code.
        """
        nodes = self._joined()
        # What a program defines in itself is sent along as it stands.
        checked = tuple(dict.fromkeys(name for name in (function.__module__, __name__, *modules) if name != "__main__"))
        expected = worker_code(checked)
        memory_bytes = int(self._cluster.memory_per_task_gb * 2**30)
        dumps: Callable[[object], bytes] = ray.cloudpickle.dumps
        call: Any = ray.remote(num_cpus=1, memory=memory_bytes, max_retries=0)(_guarded())
        references = [ray.put(value) for value in shared]
        source, again, pace = iter(items), deque[list[_Try[Item]]](), _Pace()
        in_flight: dict[Any, _Batch[Item]] = {}
        head_answers = True
        with self._lock:
            self._runs += 1
        try:
            while True:
                interrupt.check()
                head_answers = nodes.recount()
                if not head_answers:
                    time.sleep(HEARTBEAT_S)
                    yield None
                    continue
                anywhere = call.options(label_selector=nodes.selector) if nodes.selector else call
                while len(in_flight) < self._most_in_flight and (tries := _next(again, source, pace.items)):
                    work = dumps((function, [one.item for one in tries], timeout_s))
                    in_flight[anywhere.remote(expected, checked, work, references)] = _Batch(tries)
                if not in_flight:
                    return
                ready, _ = ray.wait(list(in_flight), timeout=HEARTBEAT_S)
                if not ready:
                    _kill_hung(in_flight, timeout_s)
                    yield None
                settled: Outcome[Item, Value] | list[_Try[Item]]
                for reference in ready:
                    for settled in self._settle(in_flight.pop(reference), reference, pace):
                        if isinstance(settled, list):
                            again.append(settled)
                        else:
                            yield settled
        except HeadLost:
            head_answers = False
            raise
        finally:
            with self._lock:
                self._runs -= 1
            # Our own Ray ends with the process. It may abort when a task answers that was just cancelled (seen: exit
            # code 1, "Tried to complete task that was not pending").
            if head_answers and not (self._owns_ray and interrupt.requested()):
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
                    progress.update(0, self.workers)
                    continue
                if outcome.failure is not None:
                    raise ItemError(f"{unit}: {named(outcome.item)} failed: {outcome.failure.message}")
                progress.update(note=self.workers)
                yield outcome.item, cast(Value, outcome.value)

    def _settle(
        self, batch: _Batch[Item], reference: Any, pace: _Pace
    ) -> Iterator[Outcome[Item, Value] | list[_Try[Item]]]:
        """Yield the outcomes of a batch, and those of its items that must run again, by the batch."""
        nodes = self._joined()
        try:
            reply = _Reply(*ray.get(reference))
        except ray.exceptions.RayError as error:
            if not isinstance(error, ray.exceptions.RayTaskError):
                if not nodes.head_answers():
                    yield batch.tries
                    return
                if not batch.killed:
                    nodes.note_death(error)
            if len(batch.tries) > 1:  # one of them is to blame; run alone, it shows itself
                yield from ([one.again()] for one in batch.tries)
            else:
                yield self._after_loss(batch, error)
            return
        if reply.differences:
            nodes.leave_out(reply.node_id, reply.node, reply.differences)
            yield batch.tries
            return
        pace.note(len(reply.results), reply.seconds)
        for one, (value, failure) in zip(batch.tries, reply.results, strict=True):
            if failure is not None and failure.kind == "error" and one.errors < EXCEPTION_RETRIES:
                yield [one.again(errors=1)]
            else:
                yield Outcome(one.item, one.attempt, value, failure, reply.node)

    def _after_loss(self, batch: _Batch[Item], error: "RayError") -> Outcome[Item, Value] | list[_Try[Item]]:
        """Return what becomes of an item whose worker returned nothing."""
        [one] = batch.tries
        if isinstance(error, ray.exceptions.RayTaskError):  # its value could not be sent back
            if one.errors < EXCEPTION_RETRIES:
                return [one.again(errors=1)]
            failure = Failure("error", str(error))
        elif batch.killed:
            failure = Failure("timeout", "did not react to its time limit; its worker was stopped")
        elif one.crashes < self._cluster.retries:
            return [one.again(crashes=1)]
        else:
            failure = Failure("crash", f"its worker died {one.crashes + 1} times: {error}")
        return Outcome(one.item, one.attempt, None, failure)


def _next(again: deque[list[_Try[Item]]], source: Iterator[Item], most: int) -> list[_Try[Item]]:
    """Return the next batch, empty when nothing is left."""
    if again:
        return again.popleft()
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


def _guarded() -> Callable[..., tuple[Any, ...]]:
    """Return what a worker runs: the comparison of its code with the driver's, then the batch.

    A function inside a function is pickled as it stands, so this also runs where mrtask is older, or is not installed.
    The batch is unpickled only after the comparison.
    """
    running, comparing = __name__, COMPARING

    def call(
        expected: dict[str, str], checked: tuple[str, ...], work: bytes, references: list[Any]
    ) -> tuple[str, str, list[str], list[Any], float]:
        import importlib
        import socket

        import ray
        import ray.cloudpickle

        node_id, node = ray.get_runtime_context().get_node_id(), socket.gethostname()
        try:
            differences = importlib.import_module(comparing).differences_in_code(expected, checked)
        except (ImportError, AttributeError, OSError) as error:
            differences = [f"another version of mrtask, or none ({error})"]
        if differences:
            return node_id, node, differences, [], 0.0
        function, items, timeout_s = ray.cloudpickle.loads(work)
        results, seconds = importlib.import_module(running).run_batch(function, items, references, timeout_s)
        return node_id, node, [], results, seconds

    return call


def run_batch(
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


def _start(cluster: Cluster) -> Path | None:
    """Start or join Ray; return the folder of logs that Ray makes for a session on this machine alone."""
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
    if cluster.address == LOCAL:
        cpus = cluster.cpus or len(os.sched_getaffinity(0))
        options |= {"num_cpus": cpus, "include_dashboard": False, "object_store_memory": OBJECT_STORE_BYTES}
    elif cluster.address != "auto":
        _check_reachable(cluster.address)
    _keep_token_private()
    try:
        context: Any = ray.init(address=cluster.address, **options)
    except Exception as error:  # Ray raises a bare one where its start takes too long
        said = " ".join(str(error).split()).rstrip(".")
        raise UserError(
            f"cluster.address={cluster.address}: Ray cannot be used there: {said}. {ADDRESSES}; "
            "where the cluster asks for a token, set RAY_AUTH_MODE=token; where the start took too long, run it again"
        ) from error
    interrupt.rearm()  # Ray sets a handler of its own
    return Path(context.address_info["session_dir"]) if cluster.address == LOCAL else None


def _keep_to_this_machine() -> None:
    """Have Ray listen on the loopback alone, and answer only those who know a token of this run's.

    Ray reads the variable when it is imported: where a program has imported it before, it listens on all addresses.
    """
    os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")  # it has the same effect on Linux
    if not os.environ.get("RAY_AUTH_MODE"):  # unset, Ray asks for a token where it finds one
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))


def _keep_token_private() -> None:
    """Take everybody else's right to read the cluster's token; Ray writes it for all to read."""
    token = Path(os.environ.get("RAY_AUTH_TOKEN_PATH") or Path.home() / ".ray" / "auth_token")
    if token.is_file() and token.stat().st_uid == os.getuid() and token.stat().st_mode & 0o077:
        token.chmod(0o600)


def _check_reachable(address: str) -> None:
    """Check quickly that somebody answers; Ray itself takes minutes to notice."""
    try:
        socket.create_connection(host_and_port(address), CONNECT_TIMEOUT_S).close()
    except (OSError, ValueError) as error:
        raise UserError(f"cluster.address={address}: nobody answers there ({error}). {ADDRESSES}") from error
