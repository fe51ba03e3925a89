"""A live process's log as MCAP, read with mcap's own reader."""

import json

import jsonschema
import pytest

from mrtask.live.session import LiveSession
from mrtask.live.store import restore
from pipeline.base.config import UserError
from pipeline.live import recording
from tests.live.fuzz import Stream
from tests.live.test_team import two_robots

pytest.importorskip("mcap")


def test_a_recording_holds_every_message_of_the_log_with_its_schema(two_room_home, two_room_map, tmp_path):
    from mcap.reader import make_reader

    log, state, mcap = tmp_path / "log.jsonl", tmp_path / "state.json", tmp_path / "log.mcap"
    live = two_robots(two_room_home, two_room_map)
    stream = Stream(live, 3)
    stream.session = LiveSession(live, state, log)
    stream.run(80)
    recording.run([str(log), str(mcap)])

    entries = [json.loads(line) for line in log.read_text().splitlines()]
    expected = [json.loads(line) for entry in entries for line in ([] if entry["kind"] == "in" else entry["lines"])]
    expected += [json.loads(line) for entry in entries for line in entry["out"]]
    read = {"in": [], "out": []}
    times = []
    with mcap.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            content = json.loads(message.data)
            jsonschema.validate(content, json.loads(schema.data))
            live_topic, way, kind = channel.topic.removeprefix("/").split("/")
            assert (live_topic, kind, schema.name) == ("live", content["type"], f"mrtask.{kind}")
            read[way].append(content)
            times.append((message.sequence, message.log_time))
    key = lambda message: json.dumps(message, sort_keys=True)  # noqa: E731
    assert sorted(map(key, read["out"])) == sorted(map(key, expected))
    received = {event["id"] for event in read["in"]}
    assert received >= {name for _, name in live.ids}
    assert set(live.ids) == set(restore(live.setup, state.read_text()).ids)
    ordered = [time_ns for _, time_ns in sorted(times)]
    assert ordered == sorted(ordered) and ordered[-1] == pytest.approx(live.team.time_s * 1e9, abs=80e9)


def test_lines_that_are_no_entries_are_left_out_and_said(two_room_home, two_room_map, tmp_path, capsys):
    log, whole, cut = tmp_path / "log.jsonl", tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    stream = Stream(two_robots(two_room_home, two_room_map), 3)
    stream.session = LiveSession(stream.live, log=log)
    stream.run(20)
    expected, unread = recording.write(log, whole)
    assert expected > 20 and unread == []
    with log.open("ab") as file:
        file.write(b'\xff\n{"kind": "in", "lines": ["x"], "out": []}\n{"kind": "in", "lines": ["{')
    lines = len(log.read_bytes().splitlines())
    recording.run([str(log), str(cut)])
    said = capsys.readouterr()
    assert f"{expected} messages" in said.out and f"line {lines - 2}, {lines - 1}, {lines}" in said.err
    assert cut.stat().st_size == whole.stat().st_size


@pytest.mark.parametrize("text", ["", "nonsense\n", "{}\n", '{"kind": "in", "lines": ["x"], "out": []}\n'])
def test_a_file_that_is_no_log_is_refused(tmp_path, text):
    log = tmp_path / "log.jsonl"
    log.write_text(text)
    with pytest.raises(UserError, match="no line of it is an entry of a live process's log"):
        recording.run([str(log), str(tmp_path / "x.mcap")])
    assert not (tmp_path / "x.mcap").exists()


def test_both_files_are_asked_for(tmp_path):
    with pytest.raises(UserError, match="give the log of a live process"):
        recording.run([])
    with pytest.raises(UserError, match="no such file"):
        recording.run([str(tmp_path / "gone"), "x"])
