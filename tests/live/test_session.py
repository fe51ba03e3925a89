"""Lines of JSON in and out of a live team: refusals, schemas, logs, and random streams."""

import json
import time
from importlib.resources import files
from itertools import pairwise

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrtask.errors import InputError
from mrtask.live import state_file
from mrtask.live.log_file import entries
from mrtask.live.messages import schemas
from mrtask.live.session import MAX_BYTES, LiveSession, replay
from mrtask.live.state_file import read_state
from mrtask.live.store import mark, restore, return_to, save
from tests.live.fuzz import OPTIONS, Stream
from tests.live.test_team import two_robots


@pytest.fixture
def session(two_room_home, two_room_map):
    return LiveSession(two_robots(two_room_home, two_room_map))


def told(session, line):
    answers, news = session.receive(line)
    return [json.loads(one) for one in answers], [json.loads(one) for one in news]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("", "JSON"),
        ("{", "JSON"),
        ("[]", "object"),
        ("{}", "discriminator"),
        ('{"type": "fly"}', "'fly'"),
        ('{"type": "arrived", "id": "a", "time_s": 1.0, "robot": "r1"}', "container"),
        ('{"type": "robot_lost", "id": "a", "time_s": -1, "robot": "r1"}', "time_s"),
        ('{"type": "robot_lost", "id": "a", "time_s": NaN, "robot": "r1"}', "time_s"),
        ('{"type": "route_blocked", "id": "a", "time_s": 1}', "give a door, or x_m and y_m"),
        ("[" * 100_000, "nested"),
        ('{"a":' * 7 + "1" + "}" * 7, "nested"),
        ('"' + "[" * 100 + '"', "object"),
        ("x" * (MAX_BYTES + 1), "bytes"),
    ],
)
def test_lines_that_are_no_message_are_refused_with_the_reason(session, line, said):
    session.begin()
    answers, news = told(session, line)
    assert (len(answers), news) == (1, [])
    assert answers[0]["status"] == "rejected" and said in answers[0]["reason"]
    assert answers[0]["event"] == ("a" if '"id": "a"' in line else None)


def test_fields_of_later_versions_are_ignored(session):
    session.begin()
    later = {"type": "object_seen", "id": "a", "time_s": 1.0, "container": "no", "object": "Egg", "height_m": 1.2}
    place = next(iter(session.live.containers))
    batch = {"type": "batch", "events": [{**later, "container": place}], "because": {"of": []}}
    answers, _ = told(session, json.dumps(batch))
    assert [answer["status"] for answer in answers] == ["accepted"]
    welcome, *_ = told(session, '{"type": "hello", "version": 3, "client": "c", "wants": ["video"]}')[0]
    assert welcome["version"] == 2


def test_every_message_has_its_schema_and_keeps_to_it(session):
    folder = files("mrtask.live").joinpath("schemas")
    written = {path.name.removesuffix(".json"): json.loads(path.read_text()) for path in folder.iterdir()}
    assert written == schemas(), "write them anew: python -m pipeline.live.schemas"
    lines = session.begin()
    lines += [*session.receive('{"type": "hello"}')[0], *session.receive("[]")[0]]
    kinds = set()
    for message in map(json.loads, lines):
        jsonschema.validate(message, written[message["type"]])
        kinds.add(message["type"])
    assert kinds == {"welcome", "order", "task", "answer"}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(
            {"type": "pose", "id": "a", "time_s": 1.0, "robot": "r1", "x_m": "1", "y_m": 1}, written["pose"]
        )


@pytest.mark.parametrize("text", ['{"type": "pose", "id": "\\ud800", "time_s": 1}', '{"id": "\\udfff\\ud800"}'])
def test_an_id_that_cannot_be_sent_is_refused_like_any_other_line(session, text):
    session.begin()
    for line in (text, text.encode()):
        answers, _ = told(session, line)
        assert (answers[0]["event"], answers[0]["status"]) == (None, "rejected")


def test_what_fails_while_a_message_is_handled_is_its_answer_and_changes_nothing(session, monkeypatch):
    session.begin()
    live = session.live
    place = live.team.containers[live.team.robots[0].assignment.container]
    common = {"time_s": 2.0, "robot": "r1", "container": place}
    arrived = {"type": "arrived", "id": "a", **common}
    searched = {"type": "search_ended", "id": "b", **common, "objects": []}
    before = save(live)
    batch = json.dumps({"type": "batch", "events": [arrived, searched]})
    with monkeypatch.context() as broken:
        broken.setattr(live.planner, "plan", lambda *_: 1 / 0)
        answers, news = told(session, batch)
    assert [(answer["event"], answer["status"]) for answer in answers] == [("a", "rejected"), ("b", "rejected")]
    assert "changed nothing (ZeroDivisionError" in answers[0]["reason"] and news == []
    assert save(live) == before
    answers, news = told(session, batch)
    assert {answer["status"] for answer in answers} == {"accepted"} and news


def test_a_team_can_return_to_any_moment(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map)
    stream = Stream(live, 11, [door.id for door in two_room_home.doors])
    session = stream.session
    session.begin()
    events = 0
    for _ in range(60):
        line = json.dumps(stream.event())
        moment, before = mark(live), save(live)
        accepted = "accepted" in session.receive(line)[0][0]
        events += accepted
        assert (save(live) == before) is not accepted
        return_to(live, moment)
        assert save(live) == before and live.ids_since(0) == live.ids_until(live.taken)
        session.receive(line)
    assert events > 20


def unwritable(path):
    """Puts a file where the folder of a path was."""
    path.parent.rename(path.parent.with_name("moved"))
    path.parent.write_text("no folder")


def writable_again(path):
    path.parent.unlink()
    path.parent.with_name("moved").rename(path.parent)


def pose(time_s, robot="r1"):
    place = {"robot": robot, "x_m": 1.5, "y_m": 1.5}
    return json.dumps({"type": "pose", "id": f"{robot} {time_s}", "time_s": time_s, **place})


@pytest.mark.parametrize("go_on", [False, True])
def test_a_state_that_cannot_be_written_is_said_and_stops_the_team_or_not(two_room_home, two_room_map, tmp_path, go_on):
    state = tmp_path / "run" / "state.json"
    live = two_robots(two_room_home, two_room_map)
    session = LiveSession(live, state, go_on_unsaved=go_on)
    session.begin()
    unwritable(state)
    (answer,), news = told(session, pose(1.0))
    assert answer["status"] == "accepted" and "send it again after a restart" in answer["reason"]
    assert {one["action"] for one in news if one["type"] == "order"} == (set() if go_on else {"wait"})
    assert news[-1]["status"] == ("running" if go_on else "stuck")
    assert "the state cannot be written to state.json (" in news[-1]["reason"]
    place = live.team.containers[live.team.robots[0].assignment.container]
    searched = {"type": "search_ended", "id": "s", "time_s": 2.0, "robot": "r1", "container": place, "objects": []}
    _, news = told(session, json.dumps(searched))
    assert [one["type"] for one in news] == (["order", "task"] if go_on else ["task"])
    hello, _ = told(session, '{"type": "hello"}')
    assert {one["action"] for one in hello if one["type"] == "order"} == ({"navigate"} if go_on else {"wait"})
    assert session.save_again() == []
    writable_again(state)
    news = [json.loads(line) for line in session.save_again()]
    assert [one["type"] for one in news] == (["task"] if go_on else ["order", "order", "task"])
    assert (news[-1]["status"], news[-1]["reason"]) == ("running", "")
    assert save(read_state(live.setup, state)) == save(live)


def test_a_team_does_not_start_without_its_state_unless_it_may(two_room_home, two_room_map, tmp_path):
    (tmp_path / "file").write_text("")
    state = tmp_path / "file" / "state.json"
    with pytest.raises(InputError, match="the state cannot be written"):
        LiveSession(two_robots(two_room_home, two_room_map), state).begin()
    lines = LiveSession(two_robots(two_room_home, two_room_map), state, go_on_unsaved=True).begin()
    assert "the state cannot be written" in json.loads(lines[-1])["reason"]


@pytest.mark.parametrize("log", ["/dev/full", "a/file/log.jsonl", "a"])
def test_a_log_that_cannot_be_written_stops_nobody(session, tmp_path, log, caplog):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "file").write_text("")
    logged = LiveSession(session.live, log=tmp_path / log)
    logged.begin()
    for time_s in (1.0, 2.0):
        assert told(logged, pose(time_s))[0][0]["status"] == "accepted"
    assert [record.getMessage().count("the log cannot be written") for record in caplog.records] == [1]


def test_a_log_goes_on_after_a_gap_and_after_a_line_that_was_cut_off(session, tmp_path):
    log = tmp_path / "run" / "log.jsonl"
    logged = LiveSession(session.live, log=log)
    logged.begin()
    unwritable(log)
    told(logged, pose(1.0))
    writable_again(log)
    told(logged, pose(2.0))
    whole = log.read_text()
    assert [entry["kind"] for _, entry in entries(log)] == ["begin", "gap", "in"]
    with pytest.raises(InputError, match="line 2: the log is not whole here"):
        replay(session.live.setup, {"r1": (1.5, 1.5), "r2": (2.5, 1.5)}, log)
    log.write_text(whole + '{"kind": "in", "lin')
    assert [number for number, entry in entries(log) if entry is None] == [4]
    told(LiveSession(session.live, log=log), pose(3.0))
    assert log.read_text().startswith(whole) and all(entry for _, entry in entries(log))


def test_a_state_file_cut_off_anywhere_is_the_state_of_an_event_before(two_room_home, two_room_map, tmp_path):
    state = tmp_path / "state.json"
    live = two_robots(two_room_home, two_room_map)
    stream = Stream(live, 5, [door.id for door in two_room_home.doors])
    stream.session = LiveSession(live, state)
    kept = []
    keep = stream.session._state.keep
    stream.session._state.keep = lambda live, now: (keep(live, now), kept.append(save(live)))
    stream.run(40)
    text = state.read_text()
    ends = [number + 1 for number, sign in enumerate(text) if sign == "\n"]
    assert len(ends) > 10 and save(restore(live.setup, text)) == kept[-1]
    for begin, end in pairwise(ends):
        assert save(restore(live.setup, text[:begin])) in kept
        assert save(restore(live.setup, text[: (begin + end) // 2])) == save(restore(live.setup, text[:begin]))


def test_an_event_costs_the_same_however_many_came_before(two_room_home, two_room_map, tmp_path, monkeypatch):
    state = tmp_path / "state.json"
    live = two_robots(two_room_home, two_room_map)
    session = LiveSession(live, state)
    session.begin()
    sizes = [state.stat().st_size]
    for number in range(300):
        assert told(session, pose(float(number)))[0][0]["status"] == "accepted"
        sizes.append(state.stat().st_size)
    written = [after - before for before, after in pairwise(sizes)]
    assert max(written[-50:]) <= max(written[:50]) * 1.2
    monkeypatch.setattr(state_file, "COMPACT_BYTES", 1000)
    told(session, pose(300.0))
    assert len(state.read_text().splitlines()) == 1, "the changes outgrew the rest"
    assert save(read_state(live.setup, state)) == save(live)


def test_a_session_wakes_by_itself_when_nobody_speaks(session, monkeypatch):
    session.begin()
    now_s = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    assert session.wake() == []
    told(session, '{"type": "pose", "id": "a", "time_s": 1.0e9, "robot": "r1", "x_m": 1.5, "y_m": 1.5}')
    now_s += 30.0
    assert session.wake() == [], "not yet"
    now_s += 300.0
    *_, state = map(json.loads, session.wake())
    assert state["silent"] == ["r1", "r2"] and state["time_s"] == pytest.approx(1.0e9 + 330.0)
    assert session.wake() == [], "once is enough"


def test_state_is_kept_before_anything_is_said_and_the_log_replays(two_room_home, two_room_map, tmp_path):
    state, log = tmp_path / "run" / "state.json", tmp_path / "run" / "log.jsonl"
    live = two_robots(two_room_home, two_room_map, "pouct")
    session = LiveSession(live, state, log)
    stream = Stream(live, 1)
    stream.session = session
    stream.run(60)
    assert restore(live.setup, state.read_text()).team.trace() == live.team.trace()
    again = replay(live.setup, {"r1": (1.5, 1.5), "r2": (2.5, 1.5)}, log)
    assert again.team.trace() == live.team.trace() and again.told == live.told
    lines = log.read_text().splitlines()
    entry = json.loads(lines[0])
    entry["lines"][1] = entry["lines"][1].replace("navigate", "wait")
    log.write_text("\n".join([json.dumps(entry), *lines[1:]]) + "\n")
    with pytest.raises(InputError, match="line 1: it begins differently"):
        replay(live.setup, {"r1": (1.5, 1.5), "r2": (2.5, 1.5)}, log)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from(["greedy", "learned_myopic", "nonlearned_myopic"]))
def test_no_stream_of_events_does_harm(two_room_home, two_room_map, seed, planner):
    Stream(two_robots(two_room_home, two_room_map, planner), seed, [door.id for door in two_room_home.doors]).run(30)


def test_a_robot_inside_a_barrier_is_not_sent_where_it_stands(two_room_home, two_room_map):
    # Found by the fuzz, as stream 20888: told to go where it stood, it was free at once, and never interacted.
    live = two_robots(two_room_home, two_room_map, "pouct", "(!Pillow U Egg) & F Pillow", options=OPTIONS)
    Stream(live, 20888, [door.id for door in two_room_home.doors]).run(30)


def test_the_checks_on_streams_notice_a_forgotten_find(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map)
    live.team.learned = lambda container, *_: live.team.belief.searched.__setitem__(container, True) or True
    with pytest.raises(AssertionError, match="forgotten"):
        for seed in range(20):
            Stream(live, seed).run(30)
