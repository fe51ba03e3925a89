"""A live team behind lines of JSON: every input gets an answer, and no input can stop the team.

Each line is one message (`mrtask.live.messages`). The state is saved after every accepted event and before the answer,
so that what was answered is never lost. While it cannot be saved, everybody is told so, and the team stands still or
goes on, as it was asked to. Whatever fails while a message is handled becomes the answer to that message, and changes
nothing. Every message in and out can be logged for `replay`.
"""

import json
import logging
import time
from collections.abc import Iterable
from pathlib import Path

from pydantic import ValidationError

from mrtask.errors import InputError
from mrtask.homes.home import Point
from mrtask.live import messages as m
from mrtask.live.live_team import LiveTeam
from mrtask.live.log_file import GAP, LogFile, entries
from mrtask.live.orders import task_state, welcome
from mrtask.live.state import LiveSetup
from mrtask.live.state_file import StateFile
from mrtask.live.store import mark, return_to

LOGGER = logging.getLogger(__name__)
MAX_BYTES = 262_144
MAX_DEPTH = 6
MAX_REASON = 300
OWN_CLOCK = "the team's own clock"
"""The client of the events with which a session itself says how late it is."""


class LiveSession:
    """A live team with its state file and its log; it takes one message at a time.

    Args:
        go_on_unsaved: whether robots are sent on while the state cannot be written; else they wait.
    """

    def __init__(
        self, live: LiveTeam, state: Path | None = None, log: Path | None = None, *, go_on_unsaved: bool = False
    ) -> None:
        self.live, self._go_on_unsaved = live, go_on_unsaved
        self._state = StateFile(state) if state is not None else None
        self._log = LogFile(log) if log is not None else None
        self._mark = mark(live)
        self._unsaved = ""
        """Why the state cannot be written."""
        self._received_s = time.monotonic()

    def begin(self) -> list[str]:
        """Return the first lines: `Welcome`, all orders in force, the task's state.

        Raises:
            InputError: the state cannot be written, and the team is not to go on without.
        """
        self.live.begin()
        self._keep()
        if self._stands:
            raise InputError(f"{self._unsaved}; make room, give another file, or let it go on without (unsaved=go_on)")
        lines = _lines([welcome(self.live), *self._present()])
        self._write("begin", lines)
        return lines

    def receive(self, text: str | bytes, client: str = "") -> tuple[list[str], list[str]]:
        """Handle one message.

        Args:
            client: the name that the sender gave in its hello, if any.

        Returns:
            Answers for the sender, and orders and task states for all listeners.
        """
        began_s, self._received_s = time.perf_counter(), time.monotonic()
        try:
            message = parse(text)
        except Unreadable as error:
            answers = _lines([m.Answer(event=error.event, status="rejected", reason=str(error))])
            self._write("refused", answers)
            return answers, []
        events: tuple[m.Message, ...] = ()
        try:
            if isinstance(message, m.Hello):
                return _lines([welcome(self.live), *self._present()]), []
            events, more = (message.events, message.more) if isinstance(message, m.Batch) else ((message,), False)
            stood = self._stands
            replies = self.live.handle(events, more=more, client=client)
            self._keep()
            answers = _lines(self._qualified(reply) for reply in replies if isinstance(reply, m.Answer))
            news = _lines(self._news([reply for reply in replies if not isinstance(reply, m.Answer)], stood))
        except Exception as error:  # whatever it is, the others must be able to go on
            LOGGER.exception("a message could not be handled")
            return_to(self.live, self._mark)
            reason = f"it could not be handled, and changed nothing ({type(error).__name__}: {error})"[:MAX_REASON]
            answers = [_failure(getattr(event, "id", None), reason) for event in events or (None,)]
            news = []
        raw = text if isinstance(text, str) else text.decode("utf-8")
        facts = {"client": client} if client else {}
        facts |= {"unsaved": self._unsaved} if self._unsaved else {}
        self._write("in", [raw.strip()], answers + news, took_s=round(time.perf_counter() - began_s, 6), **facts)
        return answers, news

    def wake(self) -> list[str]:
        """Let the team do what is due by now if nobody says anything; return what all listeners are told.

        Since the last message, the team's time has gone on as the time here has.
        """
        now_s = self.live.team.time_s + time.monotonic() - self._received_s
        if not self.live.ids or now_s < self.live.wake_s:  # before the first event, nobody knows what clock counts
            return []
        clock = m.Clock(type="clock", id=f"{now_s:.3f}", time_s=max(self.live.stamp_s(now_s), 0.0))
        _, news = self.receive(clock.model_dump_json(), OWN_CLOCK)
        return news

    def save_again(self) -> list[str]:
        """Try once more to write a state that could not be written; return what all listeners are told if it worked."""
        if not self._unsaved:
            return []
        stood = self._stands
        self._keep()
        return [] if self._unsaved else _lines(self._present() if stood else [task_state(self.live)])

    @property
    def _stands(self) -> bool:
        """Whether the robots wait for the state to be written."""
        return bool(self._unsaved) and not self._go_on_unsaved

    def _keep(self) -> None:
        self._mark = mark(self.live)
        if self._state is None:
            return
        try:
            self._state.keep(self.live, self._mark)
            self._unsaved = ""
        except OSError as error:
            if not self._unsaved:
                LOGGER.warning("%s: the state cannot be written (%s)", self._state.path, error)
            self._unsaved = f"the state cannot be written to {self._state.path.name} ({error.strerror or error})"

    def _news(self, news: list[m.Message], stood: bool) -> list[m.Message]:
        """Return what all listeners are told instead of this, because the robots wait or do so no more."""
        if self._stands and stood:
            return [self._progress()] if news else []
        if self._stands or stood:
            return self._present()
        return [self._progress() if isinstance(one, m.TaskState) else one for one in news]

    def _present(self) -> list[m.Message]:
        """Return the orders in force and the task's state."""
        if not self._stands:
            return [*self.live.present_orders(), self._progress()]
        live = self.live
        waiting = [m.Order(order=live.orders, robot=live.names[number], action="wait") for number in live.present]
        return [*waiting, self._progress()]

    def _progress(self) -> m.TaskState:
        state = task_state(self.live)
        if not self._unsaved:
            return state
        stands = self._stands and state.status == "running"
        reason = f"{self._unsaved}; {'the team stands still until it can be' if self._stands else 'the team goes on'}"
        told = "; ".join(filter(None, (reason, state.reason)))
        return state.model_copy(update={"status": "stuck" if stands else state.status, "reason": told})

    def _qualified(self, answer: m.Answer) -> m.Answer:
        """Say with an answer that what it accepts is lost if the process ends now."""
        if not self._unsaved or answer.status != "accepted":
            return answer
        reason = "; ".join(filter(None, (answer.reason, f"{self._unsaved}; send it again after a restart")))
        return answer.model_copy(update={"reason": reason})

    def _write(self, kind: str, lines: list[str], out: list[str] | None = None, **facts: object) -> None:
        if self._log is not None:
            self._log.write(kind, lines, out or [], **facts)


def _lines(replies: Iterable[m.Message]) -> list[str]:
    return [reply.model_dump_json() for reply in replies]


def _failure(event: str | None, reason: str) -> str:
    """Return the line of an answer to a message that failed; whatever it holds can be sent."""
    readable = reason.encode("utf-8", "replace").decode("utf-8")
    return m.Answer(event=event, status="rejected", reason=readable).model_dump_json()


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
    missing = ""
    for number, entry in entries(log):
        where = f"{log.name}, line {number}"
        if missing:
            raise InputError(f"{missing}: the log is not whole here, so what follows cannot be decided again")
        if entry is None or entry["kind"] == GAP:
            missing = where
            continue
        if entry["kind"] == "begin":
            if session.begin() != entry["lines"]:
                raise InputError(f"{where}: it begins differently; was the log of another setup?")
        elif entry["kind"] == "in":
            answers, news = session.receive(entry["lines"][0], entry.get("client", ""))
            if answers + news != entry["out"] and "unsaved" not in entry:
                raise InputError(f"{where}: the planner decides differently from the log")
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
    if not isinstance(found, str) or not 0 < len(found) <= m.MAX_NAME:
        return None
    return found if found.encode("utf-8", "replace") == found.encode("utf-8", "surrogatepass") else None
