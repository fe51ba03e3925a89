"""A live team behind lines of JSON: every input gets an answer, and no input can stop the team.

Each line is one message (`mrtask.live.messages`). The state is saved after every accepted event and before the answer,
so that what was answered is never lost. Every message in and out can be logged for `replay`.
"""

import json
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

from pydantic import ValidationError

from mrtask.errors import InputError
from mrtask.files import replacing
from mrtask.homes.home import Point
from mrtask.live import messages as m
from mrtask.live.live_team import LiveTeam
from mrtask.live.orders import task_state, welcome
from mrtask.live.state import LiveSetup
from mrtask.live.store import save

MAX_BYTES = 262_144
MAX_DEPTH = 6
MAX_REASON = 300


class LiveSession:
    """A live team with its state file and its log; it takes one message at a time."""

    def __init__(self, live: LiveTeam, state: Path | None = None, log: Path | None = None) -> None:
        self.live, self._state, self._log = live, state, log
        for path in (state, log):
            if path is not None:
                path.parent.mkdir(parents=True, exist_ok=True)

    def begin(self) -> list[str]:
        """Return the first lines: `Welcome`, all orders in force, the task's state."""
        news = self.live.begin()
        self._keep()
        lines = self._lines([welcome(self.live), *self.live.present_orders(), news[-1]])
        self._write("begin", lines)
        return lines

    def receive(self, text: str | bytes) -> tuple[list[str], list[str]]:
        """Handle one message.

        Returns:
            Answers for the sender, and orders and task states for all listeners.
        """
        began_s = time.perf_counter()
        try:
            message = parse(text)
        except Unreadable as error:
            answers = self._lines([m.Answer(event=error.event, status="rejected", reason=str(error))])
            self._write("refused", answers)
            return answers, []
        if isinstance(message, m.Hello):
            return self._lines([welcome(self.live), *self.live.present_orders(), task_state(self.live)]), []
        events, more = (message.events, message.more) if isinstance(message, m.Batch) else ((message,), False)
        replies = self.live.handle(events, more=more)
        self._keep()
        answers = self._lines([reply for reply in replies if isinstance(reply, m.Answer)])
        news = self._lines([reply for reply in replies if not isinstance(reply, m.Answer)])
        raw = text if isinstance(text, str) else text.decode("utf-8")
        self._write("in", [raw.strip()], answers + news, took_s=round(time.perf_counter() - began_s, 6))
        return answers, news

    def _keep(self) -> None:
        if self._state is not None:
            with replacing(self._state) as temporary:
                temporary.write_text(save(self.live), encoding="utf-8")

    def _write(self, kind: str, lines: Sequence[str], out: Sequence[str] = (), **facts: float) -> None:
        if self._log is not None:
            entry = {"kind": kind, "lines": list(lines), "out": list(out), **facts}
            with self._log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")

    @staticmethod
    def _lines(replies: Iterable[m.Message]) -> list[str]:
        return [reply.model_dump_json() for reply in replies]


class Unreadable(Exception):
    """A line that is not a message; ``event`` is its id, if it has a readable one."""

    def __init__(self, reason: str, event: str | None = None) -> None:
        super().__init__(reason[:MAX_REASON])
        self.event = event


def parse(text: str | bytes) -> m.Message:
    """Parse the message in a line.

    Raises:
        Unreadable: the line is too long, too deeply nested, not JSON, or none of the messages.
    """
    raw = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    if len(raw) > MAX_BYTES:
        raise Unreadable(f"a message has at most {MAX_BYTES} bytes")
    if _depth(raw) > MAX_DEPTH:
        raise Unreadable(f"a message is nested at most {MAX_DEPTH} levels deep")
    try:
        message: m.Message = m.INCOMING.validate_json(raw)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise Unreadable(f"{where}: {first['msg']}" if where else first["msg"], _event_id(raw)) from None
    return message


def replay(setup: LiveSetup, robots: dict[str, Point], log: Path) -> LiveTeam:
    """Decide a log's episode again and return its live team: the same one, if the planner has no time limit.

    Raises:
        InputError: the log is damaged, or the planner now decides differently.
    """
    session = LiveSession(LiveTeam(setup, robots))
    for number, line in enumerate(log.read_text(encoding="utf-8").splitlines(), 1):
        entry = json.loads(line)
        if entry["kind"] == "begin":
            if session.begin() != entry["lines"]:
                raise InputError(f"{log.name}, line {number}: it begins differently; was the log of another setup?")
        elif entry["kind"] == "in":
            answers, news = session.receive(entry["lines"][0])
            if answers + news != entry["out"]:
                raise InputError(f"{log.name}, line {number}: the planner decides differently from the log")
    return session.live


def _depth(raw: bytes) -> int:
    """The most brackets open at once, outside of strings."""
    depth = deepest = 0
    in_string = escaped = False
    for byte in raw:
        if in_string:
            in_string = escaped or byte != 0x22
            escaped = byte == 0x5C and not escaped
        elif byte == 0x22:
            in_string, escaped = True, False
        elif byte in b"[{":
            depth += 1
            deepest = max(deepest, depth)
        elif byte in b"]}":
            depth -= 1
    return deepest


def _event_id(raw: bytes) -> str | None:
    try:
        content = json.loads(raw)
    except (ValueError, RecursionError):
        return None
    found = content.get("id") if isinstance(content, dict) else None
    return found if isinstance(found, str) and 0 < len(found) <= m.MAX_NAME else None
