"""Folders that appear whole or not at all, with a manifest that is read by its type."""

import math
from pathlib import Path

import pytest

from pipeline.base.config import UserError
from pipeline.store.artifacts import MANIFEST, find_manifest, make
from pipeline.store.records import GeneratedHousesManifest, TrainedModelRecord

MADE = GeneratedHousesManifest(seed=1, houses=2, code_version="abc")


def fill(folder: Path) -> GeneratedHousesManifest:
    (folder / "data").write_text("made")
    return MADE


def test_a_folder_is_made_with_its_manifest(tmp_path: Path) -> None:
    folder = tmp_path / "kind" / "name-key"
    assert find_manifest(folder, GeneratedHousesManifest) is None
    assert make(folder, fill) == MADE
    assert find_manifest(folder, GeneratedHousesManifest) == MADE
    assert (folder / "data").read_text() == "made"
    assert list(folder.parent.iterdir()) == [folder]


def test_a_failure_leaves_nothing(tmp_path: Path) -> None:
    def fail(folder: Path) -> GeneratedHousesManifest:
        fill(folder)
        raise RuntimeError("half way")

    with pytest.raises(RuntimeError, match="half way"):
        make(tmp_path / "kind" / "name", fail)
    assert list((tmp_path / "kind").iterdir()) == []


def test_the_first_of_two_makers_wins(tmp_path: Path) -> None:
    def fill_while_another_does(folder: Path) -> GeneratedHousesManifest:
        make(tmp_path / "name", fill)
        (folder / "data").write_text("second")
        return MADE

    make(tmp_path / "name", fill_while_another_does)
    assert (tmp_path / "name" / "data").read_text() == "made"


@pytest.mark.parametrize("content", ["", "not JSON", '{"seed": 1}', MADE.to_json().decode().replace("1,", "99,", 1)])
def test_a_folder_that_this_version_cannot_read_is_made_anew(tmp_path: Path, content: str) -> None:
    folder = tmp_path / "name"
    folder.mkdir()
    (folder / MANIFEST).write_text(content)
    (folder / "stale").touch()
    assert find_manifest(folder, GeneratedHousesManifest) is None
    make(folder, fill)
    assert find_manifest(folder, GeneratedHousesManifest) == MADE
    assert not (folder / "stale").exists()


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"cannot write in .*/file/kind: .*; give another place by datasets_dir="):
        make(tmp_path / "file" / "kind" / "name", fill)


def test_a_models_record_keeps_numbers_that_are_none(tmp_path: Path) -> None:
    record = TrainedModelRecord(
        name="model", model_version="3", kind="mlp", embedding="none", champion=True, training_homes=5, test_homes=0,
        metrics={"log_loss": 0.5, "roc_auc": math.nan}, frequency_metrics={}, beats_frequency=False, note="the first",
        dataset="d", tracking_uri="sqlite:///a.db", run_id="r", key="k",
    )  # fmt: skip
    make(tmp_path / "name", lambda _: record)
    found = find_manifest(tmp_path / "name", TrainedModelRecord)
    assert found is not None and found.metrics["log_loss"] == 0.5 and math.isnan(found.metrics["roc_auc"])
    facts = found.facts()
    assert (facts["version"], facts["kind"], facts["training_homes"]) == ("3", "mlp", 5)
    assert "model_version" not in facts
