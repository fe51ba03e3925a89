"""One robot on ROS 2: it takes the live team's orders and reports what became of them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import atan2, cos, dist, isfinite, sin
from time import monotonic
from typing import Annotated, Any, Literal, Protocol, TypeGuard

from pydantic import BaseModel, ConfigDict, Field

from pipeline.base.values import LocalPath, spelled
from pipeline.live.labels import Labels

Message = dict[str, Any]
Point = tuple[float, float]

WEBSOCKETS = "ws://HOST:PORT or wss://HOST:PORT"
MAX_REASON = 200
MAX_NAME = 200


class RosOptions(BaseModel):
    """The options of `pipeline.live.ros`; ``conf/ros.yaml`` explains each."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    live: Annotated[str, spelled("wss?://.+", WEBSOCKETS)]
    token: str | None
    rosbridge: Annotated[str, spelled("wss?://.+", WEBSOCKETS)]
    robots: dict[str, str] = Field(min_length=1)
    navigate: str = Field(min_length=1)
    detections: str = Field(min_length=1)
    pose: str = Field(min_length=1)
    detections_type: Literal["vision_msgs/msg/Detection2DArray", "vision_msgs/msg/Detection3DArray"]
    labels: LocalPath | None
    frame: str = Field(min_length=1)
    search_time_s: float = Field(ge=0)
    interact_time_s: float = Field(ge=0)
    min_confidence: float = Field(gt=0, le=1)
    pose_every_s: float = Field(ge=0)
    detections_every_s: float = Field(ge=0)
    answer_within_s: float = Field(gt=0)
    speed_m_per_s: float = Field(gt=0)
    overdue_factor: float = Field(ge=1)


class Nav2(Protocol):
    """One robot's NavigateToPose."""

    def send(self, goal: Message, ended: Callable[[str, str], None], heard: Callable[[Any], None]) -> str:
        """Send a goal and return its id; ``ended(status, reason)`` and ``heard(feedback)`` are called later."""
        ...

    def cancel(self, goal: str) -> None:
        """Cancel a goal."""
        ...


@dataclass(eq=False)
class _Goal:
    container: str
    id: str = ""
    heard: bool = False


class RosRobot:
    """One robot. Everything is called from one thread.

    Args:
        report: sends an event: ``report(kind, robot=..., ...)``.
        later: calls a function after a number of seconds.
        labels: the names of what the detector sees.
        say: tells the user something, once.
        joined: whether the robot is in the live team already; if not, it joins at the first place that it reports.
    """

    def __init__(
        self,
        name: str,
        options: RosOptions,
        nav2: Nav2,
        report: Callable[..., object],
        later: Callable[[float, Callable[[], None]], object],
        *,
        labels: Labels,
        say: Callable[[str], None],
        joined: bool = True,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self.name, self._options, self._nav2 = name, options, nav2
        self._report, self._later, self._clock = report, later, clock
        self._labels, self._say = labels, say
        self._order: Message = {}
        self._goal: _Goal | None = None
        self._seen: dict[str, float] | None = None
        """While it searches: name -> the highest score."""
        self._detector_heard = False
        self._joined, self._said_s = joined, float("-inf")

    def obey(self, order: Message) -> None:
        """Carry out this order from now on."""
        self._order, self._seen = order, None
        action = order["action"]
        if action == "navigate" and self._goal is not None and self._goal.container == order["container"]:
            return
        self.stop()
        if action == "navigate":
            self._navigate(order)
        elif action == "search":
            self._seen = {}
            self._later(self._options.search_time_s, lambda: self._searched(order))
        elif action == "interact":
            self._later(self._options.interact_time_s, lambda: self._interacted(order))

    def stop(self) -> None:
        """Cancel the goal, if any."""
        if self._goal is not None:
            self._nav2.cancel(self._goal.id)
            self._goal = None

    def is_at(self, x_m: float, y_m: float) -> None:
        """Report where the robot is."""
        now_s = self._clock()
        if now_s < self._said_s + self._options.pose_every_s:
            return
        self._said_s = now_s
        kind, self._joined = "pose" if self._joined else "robot_joined", True
        self._report(kind, robot=self.name, x_m=x_m, y_m=y_m)

    def is_out(self) -> None:
        """Take in that the live team does not count the robot in: it joins at the next place that it reports."""
        self._joined = False

    def localised(self, message: Any) -> None:
        """Handle a message of the robot's localisation, from geometry_msgs."""
        if (place := _place(message, "pose", "pose", "position")) is None:
            self._say(f"{self.name}: a pose without x and y was left out")
        else:
            self.is_at(*place)

    def detects(self, message: Any) -> None:
        """Handle a message of the robot's detector, from vision_msgs."""
        self._detector_heard = True
        for label, score in self._results(message):
            if self._seen is None or score < self._options.min_confidence:
                continue
            if (name := self._labels.name(label)) is not None:
                self._seen[name] = max(min(score, 1.0), self._seen.get(name, 0.0))

    def _results(self, message: Any) -> Iterator[tuple[str, float]]:
        """Yield the label and score of each result."""
        for detection in _list(message, "detections"):
            for result in _list(detection, "results"):
                if (found := _label_and_score(result)) is not None:
                    yield found
                else:
                    self._say(f"{self.name}: a detection without class and score was left out")

    def _navigate(self, order: Message) -> None:
        goal = self._goal = _Goal(order["container"])
        options, route = self._options, order["route"]

        def silent() -> None:
            if not goal.heard:
                self._overdue(goal, f"Nav2 gave no feedback in {options.answer_within_s:g} s")

        def heard(feedback: Any) -> None:
            goal.heard = True
            if goal is self._goal and (place := _place(feedback, "current_pose", "pose", "position")) is not None:
                self.is_at(*place)

        length_m = sum(dist(*ends) for ends in pairwise(route))
        longest_s = options.answer_within_s + options.overdue_factor * length_m / options.speed_m_per_s
        pose = pose_goal(route, options.frame, order.get("heading_rad"))
        goal.id = self._nav2.send(pose, lambda status, reason: self._ended(goal, status, reason), heard)
        self._later(options.answer_within_s, silent)
        self._later(longest_s, lambda: self._overdue(goal, f"not there after {longest_s:.0f} s"))

    def _overdue(self, goal: _Goal, reason: str) -> None:
        if goal is self._goal:
            self._nav2.cancel(goal.id)
            self._ended(goal, "OVERDUE", reason)

    def _ended(self, goal: _Goal, status: str, reason: str) -> None:
        if goal is not self._goal:
            return  # cancelled for another order
        self._goal = None
        if status == "SUCCEEDED":
            self._report("arrived", robot=self.name, container=goal.container)
        else:
            said = f"{status} {reason}".strip()[:MAX_REASON]
            self._report("navigation_failed", robot=self.name, container=goal.container, reason=said)

    def _searched(self, order: Message) -> None:
        if order is not self._order or self._seen is None:
            return
        objects = [{"object": name, "confidence": score} for name, score in sorted(self._seen.items())]
        self._seen = None
        about = {"robot": self.name, "container": order["container"]}
        if self._detector_heard:
            self._report("search_ended", **about, objects=objects)
        else:
            self._say(
                f"{self.name}: its detector was never heard, so its searches fail; it must send empty messages too"
            )
            self._report("search_ended", **about, status="FAILED")
        if unmatched := self._labels.unmatched:
            self._say(unmatched)

    def _interacted(self, order: Message) -> None:
        if order is self._order:
            self._report("interaction_ended", robot=self.name, container=order["container"], object=order["object"])


def pose_goal(route: Sequence[Sequence[float]], frame: str, heading_rad: float | None = None) -> Message:
    """Return NavigateToPose's goal: the end of a route, with this heading or along the last stretch."""
    x_m, y_m = route[-1]
    before = route[-2] if len(route) > 1 else route[-1]
    heading = atan2(y_m - before[1], x_m - before[0]) if heading_rad is None else heading_rad
    orientation = {"x": 0.0, "y": 0.0, "z": sin(heading / 2), "w": cos(heading / 2)}
    pose = {"position": {"x": x_m, "y": y_m, "z": 0.0}, "orientation": orientation}
    return {"pose": {"header": {"frame_id": frame}, "pose": pose}, "behavior_tree": ""}


def _label_and_score(result: Any) -> tuple[str, float] | None:
    """Return what a result of a detector says; ``id`` is what older versions of vision_msgs call the label."""
    hypothesis = result.get("hypothesis", result) if isinstance(result, dict) else None
    if not isinstance(hypothesis, dict):
        return None
    label, score = hypothesis.get("class_id", hypothesis.get("id")), hypothesis.get("score")
    named = isinstance(label, str) or type(label) is int
    if not named or not 0 < len(str(label)) <= MAX_NAME or not _is_number(score):
        return None
    return str(label), float(score)


def _list(message: Any, key: str) -> list[Any]:
    found = message.get(key) if isinstance(message, dict) else None
    return found if isinstance(found, list) else []


def _place(message: Any, *keys: str) -> Point | None:
    for key in keys:
        message = message.get(key) if isinstance(message, dict) else None
    if isinstance(message, dict) and _is_number(message.get("x")) and _is_number(message.get("y")):
        return float(message["x"]), float(message["y"])
    return None


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
