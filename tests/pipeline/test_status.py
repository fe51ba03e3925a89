"""`mrtask status` on runs in every state, and `mrtask champion`."""

import time
from pathlib import Path

import pytest

from mrtask.errors import InputError
from pipeline import champion, status
from pipeline.backends import registry, runs
from pipeline.store.folder import Folder
from pipeline.store.records import RunProgress
from tests.pipeline.harness import Workspace


def lines(folder: Path, capsys: pytest.CaptureFixture[str]) -> list[str]:
    capsys.readouterr()
    status.main([str(folder)])
    return capsys.readouterr().out.splitlines()


def change(folder: Path, **values: object) -> None:
    record = RunProgress.read(Folder(str(folder)), "progress.json")
    assert record is not None
    record.model_copy(update=values).write(Folder(str(folder)), "progress.json")


def test_a_finished_run(copied_output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, whole, *planners, note = lines(copied_output, capsys)
    assert ": finished " in first and first.endswith(" ago")
    assert whole == "  24 of 24 episodes"
    assert [line.split() for line in planners] == [
        ["nonlearned_myopic", *["12", "of", "12"]],
        ["pouct", *["12", "of", "12"]],
    ]
    assert "than nonlearned_myopic" in note


def test_a_run_under_way_and_a_killed_one(copied_output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    now = time.time()
    under_way = {"state": "running", "updated": now, "started": now - 60, "began_with": 0, "done": 6, "workers": 3}
    change(copied_output, **under_way, last_error="small-1-000 by pouct: ValueError: no")
    first, whole, *_, last = lines(copied_output, capsys)
    assert ": running, heard of " in first
    assert "0.1/s, 3 min 00 s left (until " in whole and whole.endswith("3 workers")
    assert last == "  last error: small-1-000 by pouct: ValueError: no"
    change(copied_output, updated=now - status.SILENT_S - 1)
    first, whole, *_ = lines(copied_output, capsys)
    assert "it was killed" in first and "the same command continues it" in first
    assert "left" not in whole
    change(copied_output, state="failed", message="the head is gone\nand more")
    assert lines(copied_output, capsys)[0].endswith(" ago: the head is gone")


def test_no_run_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no run has begun in"):
        status.main([str(tmp_path / "nothing")])
    with pytest.raises(InputError, match="give one folder"):
        status.main([])


def test_the_champion_is_listed_and_set(workspace: Workspace, capsys: pytest.CaptureFixture[str]) -> None:
    uri = f"tracking.uri=sqlite:///{workspace.path}/outputs/mlflow.db"
    store = runs.open_tracking(uri.partition("=")[2], "mrtask")
    champion.main([uri])
    versions = registry.versions(store)
    said = capsys.readouterr().out
    assert "1 champion frequency" in said and "log_loss" in said and "promoted: the first model" in said
    champion.main([versions[-1].number, uri])
    assert f"version {versions[-1].number} is champion now" in capsys.readouterr().out
    champion.main(["1", uri])
    assert [one.number for one in registry.versions(store) if one.champion] == ["1"]
    with pytest.raises(InputError, match="no usable model"):
        champion.main(["999", uri])
    with pytest.raises(InputError, match="give one version"):
        champion.main(["one", uri])
