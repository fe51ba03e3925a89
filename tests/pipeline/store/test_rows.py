"""The episodes dataset under interruptions: whatever breaks at whatever step, no finished row is lost or doubled."""

import errno
import json
import os
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from mrtask.analysis.results.episodes import REQUIRED_COLUMNS
from pipeline.base.config import UserError
from pipeline.store import folder as storage
from pipeline.store import rows as results
from pipeline.store.episode_row import LATER_COLUMNS, SCHEMA, EpisodeRow
from pipeline.store.folder import Folder, locked
from pipeline.store.rows import EpisodeWriter, differences, read_episodes, read_table, read_traces


class Crash(BaseException):
    """The process ends here."""


def row(number: int, planner: str = "greedy", status: str = "accepted") -> EpisodeRow:
    return EpisodeRow(
        trial_id=f"small-1-{number:03d}",
        size_class="small",
        robots=1,
        objects=("Mug", "Bowl"),
        planner=planner,
        status=status,
        cost_s=float(number) if status == "accepted" else None,
        model_version="1",
        config_hash="",
        code_version="",
        trace=f"[{number}]",
    )


def keys(folder: Folder) -> Counter[tuple[str, str]]:
    table = read_table(folder, ["trial_id", "planner"])
    return Counter(zip(table["trial_id"].to_pylist(), table["planner"].to_pylist(), strict=True))


@pytest.fixture(params=["local", "memory"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Folder:
    return Folder(str(tmp_path / "run")) if request.param == "local" else Folder(f"memory://{tmp_path.name}/run")


def test_rows_come_back_with_the_fixed_schema(folder: Folder) -> None:
    writer = EpisodeWriter(folder)
    for number in range(3):
        writer.add(row(number))
    writer.add(row(3, status="failed"))
    writer.close()
    frame = read_episodes(folder)
    assert list(frame.columns) == [name for name in SCHEMA.names if name != "trace"]
    assert list(read_traces(folder, {"small-1-001", "other"}).loc[0]) == ["small-1-001", "greedy", "[1]"]
    assert list(frame["trial_id"]) == sorted(frame["trial_id"])
    assert frame["cost_s"].isna().tolist() == [False, False, False, True]
    assert list(frame["objects"].iloc[0]) == ["Mug", "Bowl"]
    assert len([name for name in folder.names() if name.endswith(".parquet")]) == 1


def test_the_columns_are_those_of_every_published_run() -> None:
    assert [f"{field.name}: {field.type}" for field in SCHEMA] == [
        "trial_id: string", "home_id: string", "home_source: string", "size_class: string", "robots: int32",
        "team: string",
        "template: string", "formula: string", "objects: list<item: string>", "planner: string", "status: string",
        "cost_s: double", "cost_cells: double", "decisions: int32", "planning_s: double", "samples: int64",
        "seed: int64", "model_version: string", "config_hash: string", "code_version: string", "error: string",
        "start_x_m: double", "start_y_m: double", "attempt: int32", "wall_s: double", "peak_memory_mb: double",
        "trace: string", "node: string",
    ]  # fmt: skip
    assert set(REQUIRED_COLUMNS) <= set(SCHEMA.names)


def test_a_part_is_readable_by_plain_pyarrow(tmp_path: Path) -> None:
    writer = EpisodeWriter(Folder(str(tmp_path)))
    writer.add(row(0))
    writer.close()
    assert pq.read_table(tmp_path).num_rows == 1


def test_a_finished_row_is_on_disk_within_the_flush_interval(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(results.time, "monotonic", lambda: clock[0])
    writer = EpisodeWriter(folder)
    writer.add(row(0))
    assert not keys(folder)
    clock[0] += results.FLUSH_EVERY_S
    writer.tick()
    writer.settle()
    assert sum(keys(folder).values()) == 1


def test_many_small_parts_are_merged_while_running(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "MERGE_PARTS", 4)
    monkeypatch.setattr(results, "FLUSH_EVERY_S", 0.0)
    monkeypatch.setattr(results, "FULL_PART_ROWS", 6)
    writer = EpisodeWriter(folder)
    for number in range(30):
        writer.add(row(number))
        writer.settle()
        assert len(folder.names()) <= 4 + number / 6
    writer.close()
    assert keys(folder) == Counter({(f"small-1-{number:03d}", "greedy"): 1 for number in range(30)})


@pytest.mark.parametrize("operation", ["write", "remove", "rename"])
def test_a_crash_at_any_step_loses_and_doubles_nothing(
    operation: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results, "MERGE_PARTS", 3)
    monkeypatch.setattr(results, "FLUSH_EVERY_S", 0.0)
    original = getattr(Folder, operation)
    crashes = 0
    for step in range(12):
        folder, calls, written = Folder(str(tmp_path / f"{step}")), [0], 0

        def broken(self: Folder, *arguments: Any, calls: list[int] = calls, step: int = step) -> None:
            calls[0] += 1
            if calls[0] == step + 1:
                raise Crash
            original(self, *arguments)

        monkeypatch.setattr(Folder, operation, broken)
        try:
            writer = EpisodeWriter(folder)
            for number in range(10):
                writer.add(row(number))
                written = number + 1
            writer.close()
        except Crash:
            crashes += 1
        monkeypatch.setattr(Folder, operation, original)
        # What add() has returned for is on disk, except what a readable dataset shows only after recovery.
        writer = EpisodeWriter(folder)
        finished = writer.finished()
        assert {f"small-1-{number:03d}" for number in range(written)} <= {trial for trial, _ in finished}
        for number in range(10):
            if (f"small-1-{number:03d}", "greedy") not in finished:
                writer.add(row(number))
        writer.close()
        assert keys(folder) == Counter({(f"small-1-{number:03d}", "greedy"): 1 for number in range(10)})
    assert crashes > 1


def test_a_full_disk_is_one_clear_error_and_the_rows_so_far_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Folder(str(tmp_path / "run"))
    monkeypatch.setattr(results, "FLUSH_EVERY_S", 0.0)
    writer = EpisodeWriter(folder)
    writer.add(row(0))

    def full(self: Path, content: bytes) -> int:
        with self.open("wb") as file:
            file.write(content[: len(content) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(UserError, match=r"No space left on device.*make room.*same command again"):
        writer.add(row(1))
    monkeypatch.undo()
    assert list(keys(folder)) == [("small-1-000", "greedy")]
    assert [name for name in folder.names() if not name.startswith("part-")] == []


def test_rows_of_chosen_statuses_are_dropped_to_run_again(folder: Folder) -> None:
    writer = EpisodeWriter(folder)
    for number, status in enumerate(["accepted", "error", "timeout", "failed"]):
        writer.add(row(number, status=status))
    writer.close()
    kept = EpisodeWriter(folder, rerun=["error", "timeout"]).finished()
    assert sorted(trial for trial, _ in kept) == ["small-1-000", "small-1-003"]
    assert EpisodeWriter(folder).finished() == kept


def test_a_damaged_part_is_named(tmp_path: Path) -> None:
    folder = Folder(str(tmp_path))
    folder.write("part-0.parquet", b"no parquet")
    with pytest.raises(UserError, match=r"part-0.parquet is damaged.*remove it and run again"):
        EpisodeWriter(folder)


def test_rows_of_another_version_are_refused(tmp_path: Path) -> None:
    pq.write_table(pa.table({"trial_id": ["small-1-000"], "robots": [1]}), tmp_path / "part-0.parquet")
    with pytest.raises(UserError, match=r"other columns than this version writes; .*overwrite=true"):
        read_episodes(Folder(str(tmp_path)))


@pytest.mark.parametrize("column", sorted(LATER_COLUMNS))
def test_rows_from_before_a_column_was_added_can_be_read(column: str, tmp_path: Path) -> None:
    writer = EpisodeWriter(Folder(str(tmp_path)))
    writer.add(row(0))
    writer.close()
    [part] = tmp_path.glob("part-*.parquet")
    pq.write_table(pq.read_table(part).drop_columns([column]), part)
    assert read_episodes(Folder(str(tmp_path)))[column].isna().tolist() == [True]


class Store:
    """A store that takes nothing while it is down."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.down = False
        original = MemoryFileSystem.pipe_file

        def pipe_file(filesystem: MemoryFileSystem, path: str, value: bytes, **options: Any) -> None:
            if self.down:
                raise ConnectionError("nobody answers")
            original(filesystem, path, value, **options)

        monkeypatch.setattr(MemoryFileSystem, "pipe_file", pipe_file)
        monkeypatch.setattr(results, "FLUSH_EVERY_S", 0.0)
        monkeypatch.setattr(storage, "RETRY_EVERY_S", 0.01)


def test_a_store_that_refuses_for_a_while_loses_nothing_and_holds_nobody_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    store, folder = Store(monkeypatch), Folder(f"memory://{tmp_path.name}/refusing")
    with locked(folder, tmp_path):
        writer = EpisodeWriter(folder, unsent=tmp_path / "unsent")
        store.down = True
        for number in range(20):  # returns at once, again and again, while nothing can be written
            writer.add(row(number))
        assert not keys(folder)
        text, until_s = "", time.monotonic() + 60
        while "tries again" not in text:  # the thread that writes has tried once
            assert time.monotonic() < until_s
            time.sleep(0.01)
            text += capsys.readouterr().out
        store.down = False
        writer.close()
    assert keys(folder) == Counter({(f"small-1-{number:03d}", "greedy"): 1 for number in range(20)})
    said = (text + capsys.readouterr().out).splitlines()
    assert [line.count("tries again for up to 10 min") for line in said] == [1, 0] and "answers again" in said[1]
    assert not (tmp_path / "unsent").exists()


def test_rows_that_a_store_never_took_are_sent_by_the_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    store, folder = Store(monkeypatch), Folder(f"memory://{tmp_path.name}/dead")
    unsent = tmp_path / "unsent"
    with locked(folder, tmp_path):
        writer = EpisodeWriter(folder, unsent=unsent)
        writer.add(row(0))
        writer.settle()
        monkeypatch.setattr(storage, "PATIENCE_S", 0.05)
        store.down = True
        writer.add(row(1))
        with pytest.raises(UserError, match=r"nobody answers; 1 row that it lacks went to .*unsent.*same command"):
            writer.settle()
        writer.close()  # has nothing left to do, and does not try for as long again
        store.down = False
        [taken] = [name for name in folder.names() if name.startswith("part-")]
        # This one was taken, though the store's answer was lost.
        Folder(str(unsent)).write("part-1.parquet", folder.read(taken) or b"")
    capsys.readouterr()
    assert EpisodeWriter(folder, unsent=unsent).finished() == {(f"small-1-{n:03d}", "greedy") for n in range(2)}
    assert keys(folder).most_common(1)[0][1] == 1
    assert "1 row sent that the store had not taken" in capsys.readouterr().out
    assert list(unsent.iterdir()) == []


def test_an_interrupted_run_writes_its_rows_in_the_time_that_a_scheduler_leaves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    store, folder = Store(monkeypatch), Folder(f"memory://{tmp_path.name}/slow")
    monkeypatch.setattr(results, "FLUSH_EVERY_S", 60.0)
    with locked(folder, tmp_path):
        writer = EpisodeWriter(folder, unsent=tmp_path / "unsent")
        writer.add(row(0))
        writer.flush_soon()
        assert sum(keys(folder).values()) == 1
        store.down = True
        monkeypatch.setattr(results, "GRACE_S", 0.1)
        writer.add(row(1))
        writer.flush_soon()
        store.down = False
    assert "1 row that it lacks went to" in capsys.readouterr().out
    assert sum(keys(Folder(str(tmp_path / "unsent"))).values()) == 1


def test_no_episodes_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no episodes in .*; run python -m pipeline.evaluate"):
        read_episodes(Folder(str(tmp_path)))


def test_two_runs_cannot_hold_one_folder(folder: Folder, tmp_path: Path) -> None:
    with (
        locked(folder, tmp_path / "cache"),
        pytest.raises(UserError, match=f"in use by another run .process {os.getpid()} "),
        locked(folder, tmp_path / "cache"),
    ):
        pass
    with locked(folder, tmp_path / "cache"):
        pass


def test_a_folder_that_cannot_be_written_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    below = Folder(str(tmp_path / "file" / "run"))
    with pytest.raises(UserError, match=r"cannot write in output_dir=.*; give another by output_dir"):
        locked(below, tmp_path).__enter__()
    with pytest.raises(UserError, match="cannot write"):
        below.write("a", b"")


def test_an_unknown_kind_of_url_is_a_clear_error() -> None:
    with pytest.raises(UserError, match="output_dir=nowhere://x"):
        Folder("nowhere://x").names()


def test_differences_name_key_old_and_new_value() -> None:
    old = {"seed": 0, "planner": {"pouct": {"samples": 10}}, "gone": 1}
    new = {"seed": 0, "planner": {"pouct": {"samples": 20}}, "added": [1]}
    assert list(differences(old, new)) == [
        "added: was null, now [1]",
        "gone: was 1, now null",
        "planner.pouct.samples: was 10, now 20",
    ]
    assert not list(differences(json.loads(json.dumps(old)), old))
