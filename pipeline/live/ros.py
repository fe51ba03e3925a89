"""Connect ROS 2 robots to a live team over rosbridge: orders become Nav2 goals, results and detections become events.

    python -m pipeline.live.ros robots="{r1: /r1, r2: /r2}" live=ws://127.0.0.1:8765 rosbridge=ws://127.0.0.1:9090

`navigate` is a goal of Nav2's NavigateToPose (which finds its own way to the end of the order's route): SUCCEEDED is
`arrived`, any other end `navigation_failed`, and an order that takes the place of another one cancels its goal. To
search is to stand still for search_time_s and listen to the robot's detections, whose highest scores go along as
confidences; to interact is to stand still for interact_time_s. Where a connection ends, all goals are cancelled. Every
key: conf/ros.yaml. Needs roslibpy: pip install 'mrtask[ros]'.

Not yet run on a robot: tested against a server of rosbridge's protocol only (tests/live/test_ros.py).
"""

import queue
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import atan2, cos, sin
from time import monotonic
from typing import Annotated, Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field

from pipeline.app.tool import load_options, main, overrides
from pipeline.base.config import CONF_DIR, UserError
from pipeline.base.values import spelled
from pipeline.live.client import Message, SocketClient

NAVIGATE_TYPE = "nav2_msgs/action/NavigateToPose"
POSE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
CONNECT_WITHIN_S = 10.0
WEBSOCKETS = "ws://HOST:PORT or wss://HOST:PORT"
VERBATIM = ("token",)


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
    frame: str = Field(min_length=1)
    search_time_s: float = Field(ge=0)
    interact_time_s: float = Field(ge=0)
    min_confidence: float = Field(gt=0, le=1)
    pose_every_s: float = Field(ge=0)


class Nav2(Protocol):
    """One robot's NavigateToPose."""

    def send(self, goal: Message, ended: Callable[[str, str], None], passed: Callable[[float, float], None]) -> str:
        """Send a goal and return its id; ``ended(status, reason)`` and ``passed(x_m, y_m)`` are called later."""
        ...

    def cancel(self, goal: str) -> None:
        """Cancel a goal."""
        ...


@dataclass(eq=False)
class _Goal:
    container: str
    id: str = ""


class RosRobot:
    """One robot: it takes orders and reports their outcome. Everything is called from one thread.

    Args:
        report: sends an event: ``report(kind, robot=..., ...)``.
        later: calls a function after a number of seconds.
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
        joined: bool = True,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self.name, self._options, self._nav2 = name, options, nav2
        self._report, self._later, self._clock = report, later, clock
        self._order: Message = {}
        self._goal: _Goal | None = None
        self._seen: dict[str, float] | None = None
        """While it searches: class -> the highest score."""
        self._joined, self._said_s = joined, float("-inf")

    def obey(self, order: Message) -> None:
        """Carry out this order from now on."""
        self._order, self._seen = order, None
        action = order["action"]
        if action == "navigate" and self._goal is not None and self._goal.container == order["container"]:
            return
        self.stop()
        if action == "navigate":
            goal = self._goal = _Goal(order["container"])
            goal.id = self._nav2.send(
                pose_goal(order["route"], self._options.frame),
                lambda status, reason: self._ended(goal, status, reason),
                self.is_at,
            )
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
        self._report("pose" if self._joined else "robot_joined", robot=self.name, x_m=x_m, y_m=y_m)
        self._joined = True

    def localised(self, message: Message) -> None:
        """Handle a message of the robot's localisation, from geometry_msgs."""
        place = message["pose"]["pose"]["position"]
        self.is_at(float(place["x"]), float(place["y"]))

    def detects(self, message: Message) -> None:
        """Handle a message of the robot's detector, from vision_msgs."""
        if self._seen is None:
            return
        for detection in message["detections"]:
            for result in detection["results"]:
                kind, score = result["hypothesis"]["class_id"], min(float(result["hypothesis"]["score"]), 1.0)
                if score >= self._options.min_confidence:
                    self._seen[kind] = max(score, self._seen.get(kind, 0.0))

    def _ended(self, goal: _Goal, status: str, reason: str) -> None:
        if goal is not self._goal:
            return  # cancelled for another order
        self._goal = None
        if status == "SUCCEEDED":
            self._report("arrived", robot=self.name, container=goal.container)
        else:
            said = f"{status} {reason}".strip()[:200]
            self._report("navigation_failed", robot=self.name, container=goal.container, reason=said)

    def _searched(self, order: Message) -> None:
        if order is self._order and self._seen is not None:
            objects = [{"object": kind, "confidence": score} for kind, score in sorted(self._seen.items())]
            self._seen = None
            self._report("search_ended", robot=self.name, container=order["container"], objects=objects)

    def _interacted(self, order: Message) -> None:
        if order is self._order:
            self._report("interaction_ended", robot=self.name, container=order["container"], object=order["object"])


def pose_goal(route: Sequence[Sequence[float]], frame: str) -> Message:
    """Return NavigateToPose's goal: the end of a route, facing along its last stretch."""
    x_m, y_m = route[-1]
    before = route[-2] if len(route) > 1 else route[-1]
    heading = atan2(y_m - before[1], x_m - before[0])
    orientation = {"x": 0.0, "y": 0.0, "z": sin(heading / 2), "w": cos(heading / 2)}
    pose = {"position": {"x": x_m, "y": y_m, "z": 0.0}, "orientation": orientation}
    return {"pose": {"header": {"frame_id": frame}, "pose": pose}, "behavior_tree": ""}


class _Rosbridge:
    """The connection to ROS; incoming messages go into ``inbox`` as calls to make."""

    def __init__(self, address: str, inbox: "queue.Queue[Callable[[], None] | None]") -> None:
        try:
            import roslibpy
        except ImportError as error:
            raise UserError("ROS needs roslibpy: pip install 'mrtask[ros]'") from error
        self._lib, self._inbox = roslibpy, inbox
        self.ros = roslibpy.Ros(address, transport="asyncio")
        self.ros.factory.set_max_retries(0)
        self._closed = threading.Event()
        self.ros.on("close", lambda _: self._closed.set())
        try:
            self.ros.run(timeout=CONNECT_WITHIN_S)
        except roslibpy.core.RosTimeoutError as error:
            raise UserError(f"rosbridge={address}: nobody answers; is rosbridge_server running?") from error

    def close(self) -> None:
        """End the connection."""
        self.ros.close()
        self._closed.wait(CONNECT_WITHIN_S)

    def nav2(self, action: str) -> Nav2:
        """Return a robot's action."""
        return _Action(self._lib, self.ros, action, self._inbox)

    def listen(self, topic: str, kind: str, take: Callable[[Message], None]) -> None:
        """Call ``take`` with every message of a topic."""
        self._lib.Topic(self.ros, topic, kind).subscribe(lambda message: self._inbox.put(partial(take, message)))


class _Action:
    def __init__(self, lib: Any, ros: Any, action: str, inbox: "queue.Queue[Callable[[], None] | None]") -> None:
        self._lib, self._inbox = lib, inbox
        self._client = lib.ActionClient(ros, action, NAVIGATE_TYPE)

    def send(self, goal: Message, ended: Callable[[str, str], None], passed: Callable[[float, float], None]) -> str:
        """See `Nav2`."""

        def on_end(result: Any) -> None:
            values = result["values"]
            reason = str(values.get("error_msg", "")) if isinstance(values, dict) else str(values)
            self._inbox.put(partial(ended, result["status"].name, reason))

        def on_feedback(feedback: Any) -> None:
            place = feedback["current_pose"]["pose"]["position"]
            self._inbox.put(partial(passed, float(place["x"]), float(place["y"])))

        return str(self._client.send_goal(self._lib.Goal(goal), on_end, on_feedback, on_end))

    def cancel(self, goal: str) -> None:
        """See `Nav2`."""
        self._client.cancel_goal(goal)


def read_options(arguments: Sequence[str]) -> RosOptions:
    """Read the options from a command line; raise `UserError` with every mistake."""
    return load_options(RosOptions, [CONF_DIR / "ros.yaml"], overrides(arguments, VERBATIM))


def run(arguments: Sequence[str]) -> None:
    """Run the tool."""
    options = read_options(arguments)
    inbox: queue.Queue[Callable[[], None] | None] = queue.Queue()
    bridge = _Rosbridge(options.rosbridge, inbox)
    client = _connect(options)
    welcome = client.messages.get(timeout=CONNECT_WITHIN_S) or {}
    robots = {}

    def later(delay_s: float, call: Callable[[], None]) -> None:
        timer = threading.Timer(delay_s, inbox.put, [call])
        timer.daemon = True
        timer.start()

    for name, namespace in options.robots.items():
        robot = robots[name] = RosRobot(
            name,
            options,
            bridge.nav2(f"{namespace}/{options.navigate}"),
            client.send,
            later,
            joined=name in welcome.get("robots", ()),
        )
        bridge.listen(f"{namespace}/{options.detections}", options.detections_type, robot.detects)
        bridge.listen(f"{namespace}/{options.pose}", POSE_TYPE, robot.localised)
    broken = threading.Event()

    def lost(_: object) -> None:
        broken.set()
        inbox.put(None)

    bridge.ros.on("close", lost)
    threading.Thread(target=_take_orders, args=(client, robots, inbox), daemon=True).start()
    try:
        while (call := inbox.get()) is not None:
            call()
    finally:
        for robot in robots.values():
            robot.stop()
            if broken.is_set():
                client.send("robot_lost", robot=robot.name)
        client.close()
        bridge.ros.off("close", lost)
        bridge.close()
    if broken.is_set():
        raise UserError(f"rosbridge={options.rosbridge}: the connection ended; its robots are reported as lost")
    if client.task.get("status") != "done":
        raise UserError(f"live={options.live}: the connection ended before the task was done; start again to go on")
    print("the task is done", file=sys.stderr)


def _connect(options: RosOptions) -> SocketClient:
    try:
        return SocketClient(options.live, options.token)
    except OSError as error:
        raise UserError(
            f"live={options.live}: {error}; is python -m pipeline.live running, with websocket=?"
        ) from error


def _take_orders(
    client: SocketClient, robots: dict[str, RosRobot], inbox: "queue.Queue[Callable[[], None] | None]"
) -> None:
    for order in client.orders():
        if (robot := robots.get(order["robot"])) is not None:
            inbox.put(partial(robot.obey, order))
    inbox.put(None)


if __name__ == "__main__":
    main(run, __doc__ or "")
