"""A connection to rosbridge_server, in its JSON protocol (https://github.com/RobotWebTools/rosbridge_suite).

It takes rosbridge as it is: whatever cannot be read is left out and said once, an answer in another shape than usual
ends its goal as failed, and what may get lost is sent again. A goal that is not accepted yet cannot be cancelled, so a
cancel is repeated until the goal has ended. A subscription takes its quality of service from the publishers that are
there, and with a late one of another quality it hears nothing; so it is made anew until something was heard.
"""

import json
import threading
import uuid
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from queue import Queue
from typing import Any

from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.sync.client import connect

from pipeline.base.config import UserError

Message = dict[str, Any]
Call = Callable[[], None]
Ended = Callable[[str, str], None]
Heard = Callable[[Any], None]

CONNECT_WITHIN_S = 10.0
CANCEL_AGAIN_S = 1.0
MAX_CANCELS = 60
SUBSCRIBE_AGAIN_S = 5.0
MS_PER_S = 1000
GOAL_STATUS = {0: "UNKNOWN", 1: "ACCEPTED", 2: "EXECUTING", 3: "CANCELING", 4: "SUCCEEDED", 5: "CANCELED", 6: "ABORTED"}
"""action_msgs/msg/GoalStatus."""
FAILED = "FAILED"
"""The status of a goal whose end rosbridge reports in another way."""


@dataclass(frozen=True)
class _Goal:
    action: str
    ended: Ended
    heard: Heard


@dataclass
class _Topic:
    kind: str
    throttle_s: float
    take: Callable[[Any], None]
    subscription: str = ""
    heard: bool = False


class Rosbridge:
    """A connection to rosbridge; everything but reading happens in the calls that it puts into ``inbox``.

    Args:
        inbox: the calls to make, in one thread; None when the connection has ended.
        later: calls a function after a number of seconds, in the same thread.
        say: tells the user something, once.

    Raises:
        UserError: nobody answers.
    """

    def __init__(
        self,
        address: str,
        inbox: "Queue[Call | None]",
        later: Callable[[float, Call], object],
        say: Callable[[str], None],
    ) -> None:
        self._inbox, self._later, self._say = inbox, later, say
        self._goals: dict[str, _Goal] = {}
        self._topics: dict[str, _Topic] = {}
        self._open = ExitStack()
        self.broken = False
        """Whether the connection ended by itself."""
        try:
            self._connection = self._open.enter_context(
                connect(address, open_timeout=CONNECT_WITHIN_S, close_timeout=CONNECT_WITHIN_S, max_size=None)
            )
        except (OSError, WebSocketException) as error:
            raise UserError(f"rosbridge={address}: nobody answers; is rosbridge_server running? ({error})") from None
        threading.Thread(target=self._read, daemon=True).start()

    def close(self) -> None:
        """End the connection."""
        self._open.close()

    def send_goal(self, action: str, kind: str, goal: Message, ended: Ended, heard: Heard) -> str:
        """Send a goal and return its id.

        Args:
            ended: called with the status and the reason when the goal has ended, however rosbridge says so.
            heard: called with each feedback.
        """
        name = f"{action}:{uuid.uuid4().hex}"
        self._goals[name] = _Goal(action, ended, heard)
        self._send(op="send_action_goal", id=name, action=action, action_type=kind, args=goal, feedback=True)
        return name

    def cancel(self, name: str, times: int = 0) -> None:
        """Cancel a goal, again and again until it has ended."""
        if (goal := self._goals.get(name)) is None or times >= MAX_CANCELS:
            self._goals.pop(name, None)
            return
        self._send(op="cancel_action_goal", id=name, action=goal.action)
        self._later(CANCEL_AGAIN_S, partial(self.cancel, name, times + 1))

    def listen(self, topic: str, kind: str, take: Callable[[Any], None], throttle_s: float) -> None:
        """Call ``take`` with the messages of a topic, at most one in ``throttle_s``."""
        self._topics[topic] = _Topic(kind, throttle_s, take)
        self._subscribe(topic)

    def _subscribe(self, name: str) -> None:
        topic = self._topics[name]
        if topic.heard or self.broken:
            return
        if topic.subscription:
            self._send(op="unsubscribe", id=topic.subscription, topic=name)
        topic.subscription = f"subscribe:{name}:{uuid.uuid4().hex}"
        throttle_ms = round(topic.throttle_s * MS_PER_S)
        self._send(op="subscribe", id=topic.subscription, topic=name, type=topic.kind, throttle_rate=throttle_ms)
        self._later(SUBSCRIBE_AGAIN_S, partial(self._subscribe, name))

    def _send(self, **message: Any) -> None:
        try:
            self._connection.send(json.dumps(message))
        except ConnectionClosed:
            self._broke()

    def _broke(self) -> None:
        self.broken = True
        self._inbox.put(None)

    def _read(self) -> None:
        try:
            for text in self._connection:
                self._inbox.put(partial(self._take, text))
        except ConnectionClosed:
            pass  # like an orderly end: the robots cannot be reached
        self._inbox.put(self._broke)

    def _take(self, text: str | bytes) -> None:
        message = _read(text)
        take = {
            "publish": self._published,
            "action_feedback": self._fed_back,
            "action_result": self._result,
            "status": self._status,
        }.get(str(message.get("op")) if isinstance(message, dict) else "")
        if take is None:
            self._say(f"rosbridge sent what is no message for us: {text[:100]!r}")
        else:
            take(message)

    def _published(self, message: Message) -> None:
        if (topic := self._topics.get(message.get("topic", ""))) is not None:
            topic.heard = True
            topic.take(message.get("msg"))

    def _fed_back(self, message: Message) -> None:
        if (goal := self._goals.get(str(message.get("id")))) is not None:
            goal.heard(message.get("values"))

    def _result(self, message: Message) -> None:
        if (goal := self._goals.pop(str(message.get("id")), None)) is not None:
            goal.ended(*_outcome(message))

    def _status(self, message: Message) -> None:
        """Take in a complaint of rosbridge; it names the goal that it is about by an id of its own or in its text."""
        if message.get("level") not in ("error", "warning"):
            return
        text = str(message.get("msg"))
        self._say(f"rosbridge says: {text}")
        named = [name for name in self._goals if name == message.get("id") or name in text]
        for name in named if message["level"] == "error" else ():
            self._goals.pop(name).ended(FAILED, text)


def _read(text: str | bytes) -> Any:
    """Return a message's content, or None; lone surrogates, which nobody could be told of, become question marks."""
    try:
        content = json.loads(text)
        return json.loads(json.dumps(content, ensure_ascii=False).encode("utf-8", "replace"))
    except (ValueError, RecursionError):
        return None


def _outcome(message: Message) -> tuple[str, str]:
    """Return the status and the reason in a goal's result; anything but a plain success is none."""
    values = message.get("values")
    status = message.get("status")
    if status is None and isinstance(values, dict):
        status = values.get("status")
    reason = str(values.get("error_msg") or "") if isinstance(values, dict) else str(values or "")
    known = GOAL_STATUS.get(status) if type(status) is int else None
    if known is None:
        return FAILED, f"{reason} (status {status})".strip()
    if known == "SUCCEEDED" and message.get("result") is False:
        return FAILED, reason or "status SUCCEEDED, but result false"
    return known, reason
