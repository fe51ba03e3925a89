"""The files that one stage writes and another reads: what goes in comes out, and what is not theirs is refused."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from pipeline.base.config import Map, UserError
from pipeline.store.folder import Folder
from pipeline.store.home_files import HouseFiles, MapFiles
from pipeline.store.records import (
    EvaluatedHomes,
    EvaluationManifest,
    Machine,
    Reach,
    Record,
    ReportKey,
    RunIdentity,
    StageTimes,
    TrainedModelRecord,
)

MODEL = TrainedModelRecord(
    name="likelihood", model_version="3", kind="mlp", embedding="bundled", champion=True, training_homes=12,
    test_homes=9, metrics={"log_loss": 0.2, "roc_auc": math.nan}, frequency_metrics={"log_loss": 0.3},
    beats_frequency=True, note="promoted", dataset="d", tracking_uri="sqlite:///m.db", run_id="r", key="k",
)  # fmt: skip
IDENTITY = RunIdentity(
    seed=3,
    map=Map(resolution_m=0.05, robot_radius_m=0.2, ways="shortest"),
    homes={"source": "generated", "train": 12},
    evaluation={"robots": [1, 2], "formula": None},
    evaluated_homes="h",
    planner={"pouct": {"samples": 20, "time_limit_s": math.inf}, "greedy": {}},
    model_version="3",
    code="c",
)


def manifest(model: TrainedModelRecord | None = MODEL, **changes: Any) -> EvaluationManifest:
    homes = EvaluatedHomes(
        source="ros_map", files=(Path("/a.yaml"),), skipped=1, read=5, evaluated=4, by_size_class={"small": 4},
        read_from=MapFiles(maps=(Path("/a.yaml"),), containers=(Path("/c.yaml"),), worlds=2, seed=0),
    )  # fmt: skip
    content: dict[str, Any] = {
        "experiment": "smoke", "seed": 3, "output_dir": "/run", "planners": ("greedy",), "planner_options": {},
        "expected_episodes": 8, "config": {"seed": 3}, "model_version": "3", "config_hash": "c", "code_version": "v",
        "model": model, "model_name": "likelihood", "homes": homes, "reach": Reach(containers=40, reachable=30),
        "machine": Machine.here(2), "peak_memory_mb": None, "started": "now", "wall_s": 1.5, "run_id": "r", "sweep": "",
    }  # fmt: skip
    return EvaluationManifest(**content | changes)


@pytest.mark.parametrize(
    "record", [IDENTITY, manifest(), manifest(None), StageTimes(seconds={"homes": 1.5}), ReportKey(key="k")], ids=repr
)
def test_a_record_is_read_as_it_was_written(record: Record, tmp_path: Path) -> None:
    folder = Folder(str(tmp_path))
    assert type(record).read(folder, "a.json") is None
    record.write(folder, "a.json")
    # By text, since NaN is not equal to itself.
    assert repr(type(record).read(folder, "a.json")) == repr(record)


def test_files_of_another_version_or_with_other_keys_are_refused_with_what_to_do(tmp_path: Path) -> None:
    content = json.loads(IDENTITY.to_json())
    folder = Folder(str(tmp_path))
    for change in ({"version": 2}, {"seed": None}, {"colour": "red"}):
        folder.write("run.json", json.dumps(content | change).encode())
        with pytest.raises(UserError, match=r"run\.json cannot be read \(.*overwrite=true to start anew there"):
            RunIdentity.read(folder, "run.json")
        assert RunIdentity.find(folder, "run.json") is None
    folder.write("run.json", b"{")
    with pytest.raises(UserError, match=r"run\.json cannot be read \(the file: "):
        RunIdentity.read(folder, "run.json")


def test_the_hash_in_the_rows_follows_everything_but_the_records_version() -> None:
    changed = [
        IDENTITY.model_copy(update=update)
        for update in ({"seed": 4}, {"planner": {}}, {"model_version": "4"}, {"code": "d"}, {"evaluated_homes": "i"})
    ]
    assert len({IDENTITY.config_hash, *(one.config_hash for one in changed)}) == 6
    assert IDENTITY.model_copy(update={"version": 2}).config_hash == IDENTITY.config_hash


def test_the_report_gets_plain_facts() -> None:
    facts = manifest().facts(StageTimes(seconds={"homes": 1.5}))
    assert facts["model"]["version"] == "3" and facts["model"]["metrics"]["log_loss"] == 0.2
    assert facts["homes"]["training"] == 12
    assert (facts["homes"]["containers"], facts["homes"]["reachable_share"]) == (40, 0.75)
    assert facts["stages"] == {"homes": 1.5}
    elsewhere = manifest(None).facts()
    assert elsewhere["model"] == {"name": "likelihood", "version": "3"}
    assert elsewhere["homes"]["training"] is None and "stages" not in elsewhere


def test_the_homes_of_a_manifest_are_read_again_by_the_same_kind_of_source() -> None:
    houses = HouseFiles(files=(Path("/h.jsonl"),), skip_faulty=True)
    for source in (houses, manifest().homes.read_from):
        homes = manifest().homes.model_copy(update={"read_from": source})
        again = EvaluationManifest.from_json(manifest(homes=homes).to_json(), "")
        assert again.homes.read_from == source
