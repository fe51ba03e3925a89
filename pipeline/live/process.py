"""Run a team of real robots: events come in as JSON lines and orders go out, over pipes or a WebSocket.

    python -m pipeline.live map=lab.yaml containers=containers.yaml task="pillow and remote" team="{r1: [1, 2]}"
    python -m pipeline.live name=apartment1 team="{r1: [5.8, 1.0]}" websocket=8765 state=run/state.json

Messages and their meaning: mrtask/live/messages.py, as JSON Schema in mrtask/live/schemas; a client:
pipeline/live/client.py. Killed and restarted with the same state file, it goes on. Every key: conf/live.yaml.
"""

import asyncio
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import replace
from functools import partial
from io import TextIOWrapper

from mrtask.execution.scenario import prior, task_in, with_places
from mrtask.execution.team_checks import check_doable, check_types
from mrtask.execution.team_spec import Team
from mrtask.homes.home import Home
from mrtask.live.live_team import LiveTeam
from mrtask.live.session import MAX_BYTES, LiveSession
from mrtask.live.state import LiveSetup
from mrtask.live.state_file import read_state
from mrtask.maps.ros_map import scan_floor
from mrtask.tasks.words import ReadTask
from pipeline.app.map_task import scenario_files
from pipeline.app.tool import load_options, overrides
from pipeline.live.options import TeamOptions

VERBATIM = ("task", "name", "token")
SAVE_AGAIN_S = 5.0
WAKE_EVERY_S = 0.5


def run(arguments: Sequence[str]) -> None:
    """Run the tool."""
    options = read_options(arguments)
    unsaved = options.unsaved == "go_on"
    session = LiveSession(_live(options), options.state, options.log, go_on_unsaved=unsaved)
    asyncio.run(_serve(options, session))


def read_options(arguments: Sequence[str]) -> TeamOptions:
    """Read the options from a command line; raise `UserError` with every mistake."""
    given = overrides(arguments, VERBATIM)
    return load_options(TeamOptions, scenario_files(given, "live.yaml"), given)


def _live(options: TeamOptions) -> LiveTeam:
    scan = scan_floor(options.map, options.containers)
    print("\n".join(scan.told), file=sys.stderr)
    home = scan.home
    task = task_in(home, options.task, options.objects or None, robots=len(options.team))
    home = with_places(home, task.places)
    _check_team(options, home, task)
    home_map = options.map_of(home)
    if out_of_reach := home_map.out_of_reach(home):
        print(f"warning: {out_of_reach}", file=sys.stderr)
    setup = LiveSetup(
        home=home,
        home_map=home_map,
        text=options.task,
        task=task,
        likelihood=prior(home, task, options.model()),
        spec=options.spec,
        specs=options.specs,
        make_map=partial(options.map_of, home),
        planner=options.decide_by,
        planner_options=options.planner_options,
        seed=options.seed,
        lost_after_s=options.lost_after_s,
    )
    if options.state is not None and options.state.exists():
        live = read_state(setup, options.state)
        print(f"goes on from {options.state}", file=sys.stderr)
        return live
    return LiveTeam(setup, options.starts)


def _check_team(options: TeamOptions, home: Home, task: ReadTask) -> None:
    """Refuse container types that the home does not have, and a team that cannot do the task."""
    specs = [options.specs.get(name, replace(options.spec, name=name)) for name in options.team]
    check_doable(Team(tuple(specs), "live"), task.formula, task.propositions)
    # Objects may have any names, so that no type that a robot handles is unknown.
    check_types(Team(tuple(replace(spec, handles=None) for spec in specs), "live"), [home])


class SessionHub:
    """One session for all listeners: answers go to the sender, orders and the task's state to everybody."""

    def __init__(self, session: LiveSession) -> None:
        self.session = session
        self.listeners: dict[object, asyncio.Queue[str | None]] = {}
        self._one_at_a_time = asyncio.Lock()

    async def receive(self, sender: object, text: str | bytes, client: str = "") -> None:
        async with self._one_at_a_time:
            answers, news = await asyncio.to_thread(self.session.receive, text, client)
        self._tell(sender, answers)
        self._tell_all(news)

    async def wake(self, every_s: float) -> None:
        """Let the team look at the time now and then, for ever, where nobody says anything."""
        while True:
            await asyncio.sleep(every_s)
            async with self._one_at_a_time:
                self._tell_all(await asyncio.to_thread(self.session.wake))

    async def save_again(self, every_s: float) -> None:
        """Try now and then, for ever, to write a state that could not be written."""
        while True:
            await asyncio.sleep(every_s)
            async with self._one_at_a_time:
                self._tell_all(await asyncio.to_thread(self.session.save_again))

    def _tell_all(self, news: Sequence[str]) -> None:
        for listener in list(self.listeners):
            self._tell(listener, news)

    def _tell(self, listener: object, lines: Sequence[str]) -> None:
        """Drop a listener that is too far behind, so that the others do not suffer."""
        if (queue := self.listeners.get(listener)) is None:
            return
        try:
            for line in lines:
                queue.put_nowait(line)
        except asyncio.QueueFull:
            del self.listeners[listener]
            while not queue.empty():
                queue.get_nowait()
            queue.put_nowait(None)


async def _serve(options: TeamOptions, session: LiveSession) -> None:
    hub, done = SessionHub(session), asyncio.Event()
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(encoding="utf-8")  # JSON's, whatever the terminal's is
    loop = asyncio.get_running_loop()
    for name in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(name, done.set)
    # Before anybody can talk to the session: only the hub's lock keeps messages apart.
    for text in session.begin():
        print(text, flush=True)
    async with contextlib.AsyncExitStack() as stack:
        if options.websocket is not None:
            from pipeline.live.websocket import serve

            port = await stack.enter_async_context(serve(hub, *options.address, options.token))
            print(f"listening on port {port}", file=sys.stderr, flush=True)
        tasks = [
            asyncio.create_task(_pipes(hub, done, ends=options.websocket is None)),
            asyncio.create_task(hub.save_again(SAVE_AGAIN_S)),
        ]
        if options.own_clock:
            tasks.append(asyncio.create_task(hub.wake(WAKE_EVERY_S)))
        await done.wait()
        for task in tasks:
            task.cancel()


async def _pipes(hub: SessionHub, done: asyncio.Event, ends: bool) -> None:
    """Serve standard input and output; ``ends``: the end of the input ends the process."""
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
    except OSError as error:
        print(f"standard output cannot be written ({error})", file=sys.stderr)
        done.set()
    if ends:
        done.set()


def lines_of(descriptor: int) -> Iterator[bytes]:
    """Yield the lines of a file, pipe or terminal that are not empty; of a line that is too long, only the start."""
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
