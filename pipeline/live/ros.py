"""Connect ROS 2 robots to a live team over rosbridge: orders become Nav2 goals, results and detections become events.

    python -m pipeline.live.ros robots="{r1: /r1, r2: /r2}" live=ws://127.0.0.1:8765 rosbridge=ws://127.0.0.1:9090

`navigate` is a goal of Nav2's NavigateToPose (which finds its own way to the end of the order's route): SUCCEEDED is
`arrived`, any other end `navigation_failed`, as is no end in time, and an order that takes the place of another one
cancels its goal. To search is to stand still for search_time_s and listen to the robot's detections, whose highest
scores go along as confidences; to interact is to stand still for interact_time_s. Where a connection ends, all goals
are cancelled. Every key: conf/ros.yaml.

Not yet run on a robot: tested against a server of rosbridge's protocol only (tests/live/test_ros.py).
"""

import queue
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from websockets.exceptions import ConnectionClosed, WebSocketException

from pipeline.app.tool import load_options, main, overrides
from pipeline.base.config import CONF_DIR, UserError
from pipeline.live.client import Message, SocketClient
from pipeline.live.labels import Labels, read_labels
from pipeline.live.ros_robot import Nav2, RosOptions, RosRobot
from pipeline.live.rosbridge import Rosbridge

NAVIGATE_TYPE = "nav2_msgs/action/NavigateToPose"
POSE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
ANSWER_WITHIN_S = 10.0
VERBATIM = ("token",)

Inbox = queue.Queue[Callable[[], None] | None]


class _Action:
    """A robot's action; see `Nav2`."""

    def __init__(self, bridge: Rosbridge, name: str) -> None:
        self._bridge, self._name = bridge, name

    def send(self, goal: Message, ended: Callable[[str, str], None], heard: Callable[[Any], None]) -> str:
        return self._bridge.send_goal(self._name, NAVIGATE_TYPE, goal, ended, heard)

    def cancel(self, goal: str) -> None:
        self._bridge.cancel(goal)


class Reports:
    """Events to the live team, and what became of them.

    Args:
        over: called when the live team cannot be reached any more.
        say: tells the user something, once.
    """

    def __init__(self, client: SocketClient, over: Callable[[], None], say: Callable[[str], None]) -> None:
        self._client, self._over, self._say = client, over, say
        self._sent: dict[str, tuple[str, str]] = {}
        self.robots: dict[str, RosRobot] = {}

    def send(self, kind: str, *, robot: str, **fields: Any) -> None:
        """Send an event of a robot."""
        try:
            self._sent[self._client.send(kind, robot=robot, **fields)] = (kind, robot)
        except ConnectionClosed:
            self._over()

    def answered(self, answer: Message) -> None:
        """Take in an answer: what was rejected is said, and a robot that is not in the team joins again."""
        kind, name = self._sent.pop(answer["event"], ("an event", ""))
        if answer["status"] != "rejected":
            return
        self._say(f"{name}: {kind} was rejected: {answer['reason']}")
        if name in self.robots and (kind == "robot_joined" or (kind == "pose" and "robot_joined" in answer["reason"])):
            self.robots[name].is_out()


def read_options(arguments: Sequence[str]) -> RosOptions:
    """Read the options from a command line; raise `UserError` with every mistake."""
    return load_options(RosOptions, [CONF_DIR / "ros.yaml"], overrides(arguments, VERBATIM))


def run(arguments: Sequence[str]) -> None:
    """Run the tool."""
    options = read_options(arguments)
    names = read_labels(options.labels)
    inbox: Inbox = queue.Queue()
    say = _sayer()

    def later(delay_s: float, call: Callable[[], None]) -> None:
        timer = threading.Timer(delay_s, inbox.put, [call])
        timer.daemon = True
        timer.start()

    bridge = Rosbridge(options.rosbridge, inbox, later, say)
    client, welcome = _connect(options)
    reports = Reports(client, lambda: inbox.put(None), say)
    labels = Labels(names, welcome["objects"])
    for name, namespace in options.robots.items():
        nav2: Nav2 = _Action(bridge, f"{namespace}/{options.navigate}")
        joined = name in welcome["robots"]
        robot = RosRobot(name, options, nav2, reports.send, later, labels=labels, say=say, joined=joined)
        reports.robots[name] = robot
        detections, pose = f"{namespace}/{options.detections}", f"{namespace}/{options.pose}"
        bridge.listen(detections, options.detections_type, robot.detects, options.detections_every_s)
        bridge.listen(pose, POSE_TYPE, robot.localised, options.pose_every_s)
    threading.Thread(target=_listen, args=(client, reports, inbox, say), daemon=True).start()
    try:
        while (call := inbox.get()) is not None:
            call()
    finally:
        for robot in reports.robots.values():
            robot.stop()
            if client.task.get("status") != "done":
                reports.send("robot_lost", robot=robot.name)
        client.close()
        bridge.close()
    if labels.unmatched:
        say(labels.unmatched)
    if bridge.broken:
        raise UserError(f"rosbridge={options.rosbridge}: the connection ended; its robots are reported as lost")
    if client.task.get("status") != "done":
        raise UserError(f"live={options.live}: the connection ended before the task was done; start again to go on")
    print("the task is done", file=sys.stderr)


def _sayer() -> Callable[[str], None]:
    """Return a function that prints each text once."""
    said: set[str] = set()

    def say(text: str) -> None:
        if text not in said:
            said.add(text)
            print(text, file=sys.stderr, flush=True)

    return say


def _connect(options: RosOptions) -> tuple[SocketClient, Message]:
    """Return the connection to the live team, and its welcome."""
    asked = f"live={options.live}"
    try:
        client = SocketClient(options.live, options.token)
        welcome = client.messages.get(timeout=ANSWER_WITHIN_S)
    except queue.Empty:
        raise UserError(f"{asked}: no welcome in {ANSWER_WITHIN_S:g} s; is this the live process?") from None
    except (OSError, WebSocketException) as error:
        raise UserError(f"{asked}: {error}; is python -m pipeline.live running, with websocket=?") from error
    if welcome is None or welcome["type"] != "welcome":
        raise UserError(f"{asked}: the live process refused the connection; give its token=")
    return client, welcome


def _listen(client: SocketClient, reports: Reports, inbox: Inbox, say: Callable[[str], None]) -> None:
    """Put what the live team says into the inbox, until the task is done or the connection ends."""
    while (message := client.messages.get()) is not None:
        if message["type"] == "order" and message["robot"] in reports.robots:
            inbox.put(partial(reports.robots[message["robot"]].obey, message))
        elif message["type"] == "answer":
            inbox.put(partial(reports.answered, message))
        elif message["type"] == "task" and message["status"] == "done":
            break
        elif message["type"] == "task" and message["reason"]:
            inbox.put(partial(say, f"the team is {message['status']}: {message['reason']}"))
    inbox.put(None)


if __name__ == "__main__":
    main(run, __doc__ or "")
