"""Robots on ROS: what a robot makes of its orders, what rosbridge may send, and a whole task over its protocol."""

import queue
import threading
import time
from contextlib import contextmanager
from math import pi

import pytest

from pipeline.app.tool import load_options
from pipeline.base.config import CONF_DIR, UserError
from pipeline.live import ros, rosbridge
from pipeline.live.labels import Labels, read_labels
from pipeline.live.ros_robot import RosOptions, RosRobot, pose_goal
from tests.live.rosbridge import ABORTED, Answers, Rosbridge
from tests.live.serving import ENDS_WITHIN_S, live_process
from tests.live.test_team import two_robots


class Wheels:
    """Nav2 as far as a test needs it."""

    def __init__(self):
        self.goals, self.cancelled = [], []

    def send(self, goal, ended, heard):
        self.goals.append((goal, ended, heard))
        return f"goal-{len(self.goals)}"

    def cancel(self, goal):
        self.cancelled.append(goal)


class Bench:
    """One robot, with its reports and what it wants to be called for later."""

    def __init__(self, **options):
        self.nav2, self.said, self.due, self.now_s, self.told = Wheels(), [], [], 0.0, []
        given = {"robots": {"r1": "/r1"}, **{key: options[key] for key in options if key not in ("joined", "names")}}
        self.labels = Labels(options.get("names", {}), ["Mug", "CellPhone"])
        self.robot = RosRobot(
            "r1",
            load_options(RosOptions, [CONF_DIR / "ros.yaml"], given),
            self.nav2,
            lambda kind, **fields: self.said.append((kind, fields)),
            lambda delay_s, call: self.due.append((delay_s, call)),
            labels=self.labels,
            say=self.told.append,
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
    west = pose_goal([[3.0, 0.0], [1.0, 0.0]], "map")["pose"]["pose"]["orientation"]
    assert (west["z"], west["w"]) == pytest.approx((1.0, 0.0))
    bench.order("navigate", "bed", heading_rad=pi)
    looks = bench.nav2.goals[1][0]["pose"]["pose"]["orientation"]
    assert (looks["z"], looks["w"]) == pytest.approx((1.0, 0.0)), "the order's heading, not the last stretch's"


@pytest.mark.parametrize(("heard", "after_s"), [(False, 20.0), (True, 40.0)])
def test_a_goal_that_never_ends_has_failed_in_time(heard, after_s):
    bench = Bench(answer_within_s=20.0, speed_m_per_s=0.5, overdue_factor=5.0)
    bench.order("navigate")
    if heard:
        bench.nav2.goals[0][2]({"current_pose": {"pose": {"position": {"x": None, "y": 1.0}}}})
    assert sorted(delay_s for delay_s, _ in bench.due) == [20.0, 40.0]
    for _, call in sorted(bench.due, key=lambda one: one[0]):
        call()
    ((kind, fields),) = bench.said
    assert kind == "navigation_failed" and f"{after_s:.0f} s" in fields["reason"]
    assert bench.nav2.cancelled == ["goal-1"]
    bench.nav2.goals[0][1]("SUCCEEDED", "")
    assert len(bench.said) == 1, "an end that comes later is none"


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
    assert bench.told[0] == "r1: a detection without class and score was left out"
    objects = [{"object": "Mug", "confidence": 0.8}, {"object": "Pen", "confidence": 0.3}]
    assert bench.said == [("search_ended", {"robot": "r1", "container": "sofa", "objects": objects})]


def test_detections_as_they_come():
    bench = Bench()
    bench.order("search")
    odd = [None, "x", {}, {"hypothesis": None}, {"hypothesis": {"class_id": "Egg", "score": None}}, {"score": 0.5}]
    odd += [{"hypothesis": {"class_id": True, "score": 0.9}}, {"hypothesis": {"class_id": "", "score": 0.9}}]
    number = {"hypothesis": {"class_id": 47, "score": 0.9}}
    older = {"id": "Mug", "score": 1.7}
    for message in (None, [], {"detections": None}, {"detections": [None, {"results": 3}, {"results": odd}]}):
        bench.robot.detects(message)
    bench.robot.detects({"detections": [{"results": [number, older]}]})
    bench.due[0][1]()
    objects = [{"object": "47", "confidence": 0.9}, {"object": "Mug", "confidence": 1.0}]
    assert bench.said[0][1]["objects"] == objects


def test_a_detector_that_was_never_heard_has_not_searched():
    bench = Bench()
    bench.order("search")
    bench.due[0][1]()
    bench.robot.detects({"detections": []})
    bench.order("search")
    bench.due[1][1]()
    about = {"robot": "r1", "container": "sofa"}
    assert bench.said == [
        ("search_ended", {**about, "status": "FAILED"}),
        ("search_ended", {**about, "objects": []}),
    ]
    assert "its detector was never heard" in bench.told[0]


def test_labels_have_names_and_what_never_matched_is_said(tmp_path):
    path = tmp_path / "labels.yaml"
    path.write_text("47: Mug\nmobile: CellPhone\nshadow: null\n")
    bench = Bench(names=read_labels(path))
    bench.order("search")
    bench.robot.detects(detections(**{"47": 0.9, "shadow": 0.9, "tv remote": 0.8}))
    bench.robot.detects(detections(**{"tv remote": 0.7}))
    bench.due[0][1]()
    assert [one["object"] for one in bench.said[0][1]["objects"]] == ["Mug", "tv remote"]
    said = "never detected: CellPhone; detected, but nothing of the task: 'tv remote' (2); labels= gives names"
    assert bench.told == [said] == [bench.labels.unmatched]
    bench.order("search")
    bench.robot.detects(detections(mobile=0.9))
    assert bench.labels.unmatched == ""


@pytest.mark.parametrize("text", ["[Mug]", "a: [", "Mug", "a: 3", "a: ''"])
def test_a_file_of_labels_is_checked(tmp_path, text):
    path = tmp_path / "labels.yaml"
    path.write_text(text)
    with pytest.raises(UserError, match="labels="):
        read_labels(path)
    with pytest.raises(UserError, match="cannot be read"):
        read_labels(tmp_path / "gone.yaml")


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
    for odd in (None, {}, {"pose": None}, {"pose": {"pose": {"position": {"x": None, "y": 1.0}}}}):
        bench.robot.localised(odd)
    assert bench.told == ["r1: a pose without x and y was left out"] * 4
    assert [(kind, fields["x_m"]) for kind, fields in bench.said] == [
        ("robot_joined", 0.0),
        ("pose", 1.0),
        ("pose", 2.5),
    ]


@contextmanager
def connected(server):
    """A connection to a server of rosbridge's protocol; gives it, what it says, and a function that lets time pass."""
    inbox, said = queue.Queue(), []

    def later(delay_s, call):
        timer = threading.Timer(delay_s, inbox.put, [call])
        timer.daemon = True
        timer.start()

    def until(done):
        while not done():
            call = inbox.get(timeout=ENDS_WITHIN_S)
            assert call is not None, "the connection ended"
            call()

    connection = rosbridge.Rosbridge(f"ws://127.0.0.1:{server.port}", inbox, later, said.append)
    yield connection, said, until
    connection.close()


RESULT = {"op": "action_result", "values": {"error_msg": ""}, "status": 4, "result": True}


@pytest.mark.parametrize(
    ("answers", "status", "reason"),
    [
        ([RESULT], "SUCCEEDED", ""),
        ([{**RESULT, "status": None, "values": {"status": 4}}], "SUCCEEDED", ""),
        ([{**RESULT, "status": 6, "values": {"error_msg": "no way"}}], "ABORTED", "no way"),
        ([{**RESULT, "status": 6, "values": {"error_msg": "no \ud800"}}], "ABORTED", "no ?"),
        ([{**RESULT, "result": False}], "FAILED", "result false"),
        ([{**RESULT, "status": 99}], "FAILED", "status 99"),
        ([{**RESULT, "status": "4"}], "FAILED", "status 4"),
        ([{"op": "action_result", "values": "was rejected", "result": False}], "FAILED", "was rejected"),
        ([{"op": "action_result", "values": "was rejected", "status": 0, "result": False}], "UNKNOWN", "was rejected"),
        ([{"op": "action_result", "values": None, "result": False}], "FAILED", "status None"),
        ([{"op": "action_result"}], "FAILED", "status None"),
        ([{"op": "status", "level": "error", "msg": "no such action"}], "FAILED", "no such action"),
        ([{"op": "status", "level": "error", "msg": "bad module: {id}", "id": None}], "FAILED", "bad module"),
        ([{"op": "status", "level": "warning", "msg": "slow"}, RESULT], "SUCCEEDED", ""),
        (["no JSON", {"op": "fly"}, [1], {**RESULT, "id": "foreign"}, RESULT, RESULT], "SUCCEEDED", ""),
        ([{"op": "action_feedback", "values": None}, {"op": "action_feedback"}, RESULT], "SUCCEEDED", ""),
    ],
)
def test_whatever_rosbridge_answers_ends_the_goal(answers, status, reason):
    ended = []
    with Answers(answers) as server, connected(server) as (connection, said, until):
        connection.send_goal("/r1/go", "a/b", {}, lambda *end: ended.append(end), lambda _: None)
        until(lambda: ended)
    assert ended[0][0] == status and reason in ended[0][1]
    if "no JSON" in answers:
        assert len(said) == 3


def test_a_goal_that_is_not_accepted_yet_is_cancelled_again(monkeypatch):
    monkeypatch.setattr(rosbridge, "CANCEL_AGAIN_S", 0.02)
    ended = []
    with Answers([RESULT], after="cancel_action_goal", times=3) as server, connected(server) as (connection, _, until):
        name = connection.send_goal("/r1/go", "a/b", {}, lambda *end: ended.append(end), lambda _: None)
        connection.cancel(name)
        until(lambda: ended)
        assert [one["id"] for one in server.received if one["op"] == "cancel_action_goal"] == [name] * 3


def test_a_topic_is_subscribed_anew_until_something_is_heard(monkeypatch):
    monkeypatch.setattr(rosbridge, "SUBSCRIBE_AGAIN_S", 0.02)
    heard = []
    message = {"op": "publish", "topic": "/r1/detections", "msg": {"detections": []}}
    with Answers([message], after="subscribe", times=3) as server, connected(server) as (connection, _, until):
        connection.listen("/r1/detections", "a/b", heard.append, 0.25)
        until(lambda: heard)
        time.sleep(0.1)
        asked = [one for one in server.received if one["op"] == "subscribe"]
        assert len(asked) == 3 and {one["throttle_rate"] for one in asked} == {250}
        left = [one["id"] for one in server.received if one["op"] == "unsubscribe"]
        assert left == [one["id"] for one in asked[:2]], "a late publisher may have another quality of service"


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


def test_a_bridge_that_fails_has_told_the_team(two_room_home, two_room_map, monkeypatch):
    live = two_robots(two_room_home, two_room_map)
    monkeypatch.setattr(RosRobot, "obey", lambda *_: 1 / 0)
    with (
        Rosbridge({}) as server,
        live_process(live) as port,
        pytest.raises(ZeroDivisionError),
    ):
        ros.run([f"live=ws://127.0.0.1:{port}", f"rosbridge=ws://127.0.0.1:{server.port}", "robots={r1: /r1}"])
    assert [live.names[number] for number in live.present] == ["r2"]


def test_rejections_are_said_and_a_robot_that_is_not_in_the_team_joins_again():
    class Line:
        def send(self, kind, **_):
            return kind

    told, over = [], []
    reports = ros.Reports(Line(), over.append, told.append)
    bench = Bench(pose_every_s=0.0)
    bench.robot._report = reports.send
    reports.robots["r1"] = bench.robot
    kinds = []
    monitor = reports._client.send
    reports._client.send = lambda kind, **fields: kinds.append(kind) or monitor(kind, **fields)
    for reason in ("robot 'r1' is lost; robot_joined brings it back", "the nearest such place is far", ""):
        bench.robot.is_at(1.0, 2.0)
        answer = {"event": kinds[-1], "status": "rejected" if reason else "accepted", "reason": reason}
        reports.answered(answer)
    bench.robot.is_at(1.0, 2.0)
    assert kinds == ["pose", "robot_joined", "robot_joined", "pose"]
    assert told == [
        "r1: pose was rejected: robot 'r1' is lost; robot_joined brings it back",
        "r1: robot_joined was rejected: the nearest such place is far",
    ]


def test_a_bridge_to_nowhere_says_so():
    with pytest.raises(UserError, match="nobody answers; is rosbridge_server running"):
        ros.run(["robots={r1: /r1}", "rosbridge=ws://127.0.0.1:9"])
    with Rosbridge({}) as server, pytest.raises(UserError, match=r"is python -m pipeline\.live running"):
        ros.run(["robots={r1: /r1}", f"rosbridge=ws://127.0.0.1:{server.port}", "live=ws://127.0.0.1:9"])
