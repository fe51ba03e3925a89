"""A team of real robots: events come in as JSON lines, orders go out, by standard input and output or a WebSocket.

    python -m pipeline.live map=lab.yaml containers=containers.yaml task="pillow and remote" team="{r1: [1, 2]}"
    python -m pipeline.live name=apartment1 team="{r1: [5.5, 0.6]}" websocket=8765 state=run/state.json

Messages and their meaning: mrtask/execution/messages.py, as JSON Schema in mrtask/execution/schemas; a client:
pipeline/live_client.py. Killed and started again with the same state file it goes on. Every key: conf/live.yaml.
"""

import asyncio
import contextlib
import ipaddress
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from mrtask.execution.live import LiveSetup, LiveTeam
from mrtask.execution.live_session import MAX_BYTES, LiveSession
from mrtask.execution.live_store import restore
from mrtask.execution.scenario import prior, task_in, with_places
from mrtask.maps.ros_map import read_ros_map
from mrtask.planning.planners import make_planner
from pipeline.app.given import Coordinates, Given, scenario_files
from pipeline.app.tool import load_options, main, overrides

VERBATIM = ("task", "name", "token")
MIN_TOKEN = 16

LocalPath = Annotated[Path, AfterValidator(lambda path: path.expanduser().absolute())]


class GivenTeam(Given):
    """The options of `pipeline.live`; ``conf/live.yaml`` says what each is."""

    team: dict[str, Coordinates] = Field(min_length=1)
    decide_by: str
    state: LocalPath | None
    log: LocalPath | None
    websocket: str | None
    token: str | None

    @field_validator("websocket", mode="before")
    @classmethod
    def _with_host(cls, value: object) -> object:
        return f"127.0.0.1:{value}" if isinstance(value, int) else value

    @model_validator(mode="after")
    def _safe(self) -> Self:
        make_planner(self.decide_by, self.planner_options)
        if self.websocket is not None:
            host, port = self.address
            if not 0 <= port <= 65535:
                raise ValueError(f"websocket={self.websocket}: a port is 0 to 65535")
            if not _is_loopback(host) and len(self.token or "") < MIN_TOKEN:
                raise ValueError(
                    f"websocket={self.websocket} can be reached from other machines: give a token of at least "
                    f"{MIN_TOKEN} characters, or 127.0.0.1"
                )
        return self

    @property
    def planner_options(self) -> Mapping[str, object]:
        """The options of the planner that decides."""
        return self.planner.get(self.decide_by.rsplit(".", 1)[-1], {})

    @property
    def address(self) -> tuple[str, int]:
        """Where the WebSocket listens."""
        host, colon, port = (self.websocket or "").rpartition(":")
        if not colon or not port.isdigit():
            raise ValueError(f"websocket={self.websocket}: give a port or host:port")
        return host.strip("[]"), int(port)


def run(arguments: Sequence[str]) -> None:
    """The tool."""
    given = overrides(arguments, VERBATIM)
    options = load_options(GivenTeam, scenario_files(given, "live.yaml"), given)
    session = LiveSession(_live(options), options.state, options.log)
    asyncio.run(_serve(options, session))


def _live(options: GivenTeam) -> LiveTeam:
    home = read_ros_map(options.map, options.containers)
    task = task_in(home, options.task, options.objects or None, robots=len(options.team))
    home = with_places(home, task.places)
    setup = LiveSetup(
        home=home,
        home_map=options.map_of(home),
        text=options.task,
        task=task,
        likelihood=prior(home, task, options.model()),
        spec=options.spec,
        planner=options.decide_by,
        planner_options=options.planner_options,
        seed=options.seed,
    )
    if options.state is not None and options.state.is_file():
        live = restore(setup, options.state.read_text(encoding="utf-8"))
        print(f"goes on from {options.state}", file=sys.stderr)
        return live
    return LiveTeam(setup, options.team)


class _Hub:
    """One session for all who talk to it: answers go to the sender, orders and the task's state to everybody."""

    def __init__(self, session: LiveSession) -> None:
        self.session = session
        self.listeners: dict[object, asyncio.Queue[str | None]] = {}
        self._one_at_a_time = asyncio.Lock()

    async def receive(self, sender: object, text: str | bytes) -> None:
        async with self._one_at_a_time:
            answers, news = await asyncio.to_thread(self.session.receive, text)
        for line in answers:
            self.listeners[sender].put_nowait(line)
        for queue in self.listeners.values():
            for line in news:
                queue.put_nowait(line)


async def _serve(options: GivenTeam, session: LiveSession) -> None:
    hub, done = _Hub(session), asyncio.Event()
    loop = asyncio.get_running_loop()
    for name in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(name, done.set)
    # Before anybody can talk to the session, since only the hub's lock keeps messages apart.
    for text in session.begin():
        print(text, flush=True)
    async with contextlib.AsyncExitStack() as stack:
        if options.websocket is not None:
            from pipeline.live_socket import serve

            port = await stack.enter_async_context(serve(hub, *options.address, options.token))
            print(f"listening on port {port}", file=sys.stderr, flush=True)
        pipes = asyncio.create_task(_pipes(hub, done, ends=options.websocket is None))
        await done.wait()
        pipes.cancel()


async def _pipes(hub: _Hub, done: asyncio.Event, ends: bool) -> None:
    """Standard input and output; ``ends``: the end of input is the end of all."""
    loop = asyncio.get_running_loop()
    queue: asyncio.Queue[str | None] = asyncio.Queue()
    hub.listeners["pipes"] = queue

    def read() -> None:
        with contextlib.suppress(CancelledError, RuntimeError):  # the loop ended first
            for line in lines_of(sys.stdin.fileno()):
                asyncio.run_coroutine_threadsafe(hub.receive("pipes", line), loop).result()
            loop.call_soon_threadsafe(queue.put_nowait, None)

    threading.Thread(target=read, daemon=True).start()
    try:
        while (text := await queue.get()) is not None:
            print(text, flush=True)
    except BrokenPipeError:
        done.set()
    if ends:
        done.set()


def lines_of(descriptor: int) -> Iterator[bytes]:
    """The lines of a file, pipe or terminal that are not empty; of one that is too long only its beginning."""
    held, too_long = b"", False
    while chunk := os.read(descriptor, 65_536):
        *ended, rest = (held + chunk).split(b"\n")
        for line in ended:
            if line.strip() and not too_long:
                yield line
            too_long = False
        held = rest
        if len(held) > MAX_BYTES:
            if not too_long:
                yield held
            held, too_long = b"", True
    if held.strip() and not too_long:
        yield held


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


if __name__ == "__main__":
    main(run, __doc__ or "")
