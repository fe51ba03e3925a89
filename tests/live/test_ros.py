"""Robots on ROS: what a robot makes of its orders, and a whole task over rosbridge's protocol."""

import threading
import time
from contextlib import contextmanager

import pytest

from pipeline.app.tool import load_options
from pipeline.base.config import CONF_DIR, UserError
from pipeline.live import ros
from tests.live.rosbridge import ABORTED, Rosbridge
from tests.live.serving import ENDS_WITHIN_S, live_process
from tests.live.test_team import two_robots

pytest.importorskip("roslibpy")


class Wheels:
    """Nav2 as far as a test needs it."""

    def __init__(self):
        self.goals, self.cancelled = [], []

    def send(self, goal, ended, passed):
        self.goals.append((goal, ended, passed))
        return f"goal-{len(self.goals)}"

    def cancel(self, goal):
        self.cancelled.append(goal)


class Bench:
    """One robot, with its reports and what it wants to be called for later."""

    def __init__(self, **options):
        self.nav2, self.said, self.due, self.now_s = Wheels(), [], [], 0.0
        given = {"robots": {"r1": "/r1"}, **{key: value for key, value in options.items() if key != "joined"}}
        self.robot = ros.RosRobot(
            "r1",
            load_options(ros.RosOptions, [CONF_DIR / "ros.yaml"], given),
            self.nav2,
            lambda kind, **fields: self.said.append((kind, fields)),
            lambda delay_s, call: self.due.append((delay_s, call)),
            joined=options.get("joined", True),
            clock=lambda: self.now_s,
        )

    def order(self, action, container="sofa", **fields):
        self.robot.obey({"action": action, "container": container, "route": [[1.0, 2.0], [1.0, 4.0]], **fields})


def test_a_navigate_order_is_a_goal_at_the_end_of_the_route():
    bench = Bench()
    bench.order("navigate")
    goal, ended, _ = bench.nav2.goals[0]
    pose = goal["pose"]["pose"]
    assert goal["pose"]["header"]["frame_id"] == "map"
    assert (pose["position"]["x"], pose["position"]["y"]) == (1.0, 4.0)
    assert (pose["orientation"]["z"], pose["orientation"]["w"]) == pytest.approx((0.5**0.5, 0.5**0.5)), "it looks north"
    ended("SUCCEEDED", "")
    assert bench.said == [("arrived", {"robot": "r1", "container": "sofa"})]
    west = ros.pose_goal([[3.0, 0.0], [1.0, 0.0]], "map")["pose"]["pose"]["orientation"]
    assert (west["z"], west["w"]) == pytest.approx((1.0, 0.0))


@pytest.mark.parametrize("status", ["ABORTED", "CANCELED", "UNKNOWN"])
def test_a_goal_that_ends_otherwise_is_a_failure_with_its_reason(status):
    bench = Bench()
    bench.order("navigate")
    bench.nav2.goals[0][1](status, "no valid path")
    failed = {"robot": "r1", "container": "sofa", "reason": f"{status} no valid path"}
    assert bench.said == [("navigation_failed", failed)]


def test_a_new_order_cancels_the_goal_and_its_end_is_not_reported():
    bench = Bench()
    bench.order("navigate")
    bench.order("navigate", "desk")
    assert bench.nav2.cancelled == ["goal-1"]
    bench.nav2.goals[0][1]("CANCELED", "")
    bench.nav2.goals[0][1]("SUCCEEDED", "")
    assert bench.said == []
    bench.order("wait", None)
    assert bench.nav2.cancelled == ["goal-1", "goal-2"]
    bench.nav2.goals[1][1]("SUCCEEDED", "")
    assert bench.said == []


def test_the_same_container_by_another_route_is_the_same_goal():
    bench = Bench()
    bench.order("navigate")
    bench.order("navigate")
    assert (len(bench.nav2.goals), bench.nav2.cancelled) == (1, [])
    bench.nav2.goals[0][1]("SUCCEEDED", "")
    assert [kind for kind, _ in bench.said] == ["arrived"]


def detections(**scores):
    results = [{"hypothesis": {"class_id": name, "score": score}} for name, score in scores.items()]
    return {"detections": [{"results": results}]}


def test_a_search_reports_the_highest_scores_of_its_time():
    bench = Bench(search_time_s=4.0)
    bench.robot.detects(detections(Cup=0.9))
    bench.order("search")
    bench.robot.detects(detections(Mug=0.4, Egg=0.05))
    bench.robot.detects(detections(Mug=0.8, Pen=0.3))
    bench.robot.detects(detections(Mug=0.5, Nothing=float("nan")))
    ((delay_s, call),) = bench.due
    assert delay_s == 4.0
    call()
    bench.robot.detects(detections(Fork=0.9))
    objects = [{"object": "Mug", "confidence": 0.8}, {"object": "Pen", "confidence": 0.3}]
    assert bench.said == [("search_ended", {"robot": "r1", "container": "sofa", "objects": objects})]


def test_what_was_to_be_done_under_another_order_is_not_reported():
    bench = Bench()
    bench.order("search")
    bench.order("interact", object="Mug")
    for _, call in bench.due:
        call()
    done = {"robot": "r1", "container": "sofa", "object": "Mug"}
    assert bench.said == [("interaction_ended", done)]


def test_places_are_reported_now_and_then_and_a_robot_that_is_not_known_joins():
    bench = Bench(joined=False, pose_every_s=1.0)
    for now_s in (0.0, 0.5, 1.0, 1.9, 2.5):
        bench.now_s = now_s
        bench.robot.localised({"pose": {"pose": {"position": {"x": now_s, "y": 7.0, "z": 0.0}}}})
    assert [(kind, fields["x_m"]) for kind, fields in bench.said] == [
        ("robot_joined", 0.0),
        ("pose", 1.0),
        ("pose", 2.5),
    ]


@contextmanager
def bridge(live_port, ros_port):
    """The bridge in a thread; gives the list of its errors, complete after the block."""
    errors = []

    def run():
        try:
            ros.run(
                [
                    f"live=ws://127.0.0.1:{live_port}",
                    f"rosbridge=ws://127.0.0.1:{ros_port}",
                    "robots={r1: /r1, r2: /r2}",
                    "search_time_s=0.1",
                    "interact_time_s=0.02",
                    "pose_every_s=0",
                ]
            )
        except UserError as error:
            errors.append(str(error))

    thread = threading.Thread(target=run)
    thread.start()
    yield errors
    thread.join(ENDS_WITHIN_S)
    assert not thread.is_alive(), "the bridge does not end"


def contents_of(home, home_map):
    return {
        home_map.cell_center(tuple(cell)): container.objects
        for container, cell in zip(home.containers, home_map.access, strict=True)
    }


def test_a_task_is_done_by_robots_behind_rosbridge(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map)
    contents = contents_of(two_room_home, two_room_map)
    with (
        Rosbridge(contents, lame=["r1"]) as server,
        live_process(live) as port,
        bridge(port, server.port) as errors,
    ):
        pass
    assert errors == [] and live.team.accepted
    contents = {container.id: container.objects for container in two_room_home.containers}
    assert all(letter.object in contents[letter.container] for letter in live.team.letters)
    assert {goal["action_type"] for goal in server.goals()} == {"nav2_msgs/action/NavigateToPose"}
    assert {goal["action"].split("/")[1] for goal in server.goals()} == {"r1", "r2"}
    assert all(goal["feedback"] for goal in server.goals())
    assert ABORTED in server.results, "a goal failed, and the task was done even so"
    subscribed = {(one["topic"], one["type"]) for one in server.received if one["op"] == "subscribe"}
    assert ("/r2/detections", "vision_msgs/msg/Detection2DArray") in subscribed
    believed = live.team.belief.posterior[live.team.belief.detected]
    assert believed.tolist() == [0.9] * len(believed), "scores are confidences"


def test_robots_without_rosbridge_are_lost_and_stopped(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map)
    server = Rosbridge({}, drive_s=ENDS_WITHIN_S)
    with live_process(live) as port, bridge(port, server.port) as errors:
        ends_s = time.monotonic() + ENDS_WITHIN_S
        while len(server.goals()) < 2 and time.monotonic() < ends_s:
            time.sleep(0.01)
        server.server.shutdown()
    (error,) = errors
    assert "its robots are reported as lost" in error
    assert live.present == []


def test_a_bridge_to_nowhere_says_so():
    with pytest.raises(UserError, match="nobody answers; is rosbridge_server running"):
        ros.CONNECT_WITHIN_S, before = 0.5, ros.CONNECT_WITHIN_S
        try:
            ros.run(["robots={r1: /r1}", "rosbridge=ws://127.0.0.1:9"])
        finally:
            ros.CONNECT_WITHIN_S = before
