"""Lines of JSON in and out of a live team: refusals, schemas, logs, and random streams."""

import json
from importlib.resources import files

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrtask.errors import InputError
from mrtask.live.messages import schemas
from mrtask.live.session import MAX_BYTES, LiveSession, replay
from mrtask.live.store import restore
from tests.live.fuzz import Stream
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


def test_the_checks_on_streams_notice_a_forgotten_find(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map)
    live.team.learned = lambda container, *_: live.team.belief.searched.__setitem__(container, True) or True
    with pytest.raises(AssertionError, match="forgotten"):
        for seed in range(20):
            Stream(live, seed).run(30)
