"""The files that one stage writes and another reads: what goes in comes out, and what is not theirs is refused."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from pipeline.base.config import UserError
from pipeline.base.sections import Map
from pipeline.store.folder import Folder
from pipeline.store.home_files import HouseFiles, MapFiles
from pipeline.store.records import (
    Asked,
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
    evaluation={"cost": "makespan", "formula": None},
    evaluated_homes="h",
    planner={"pouct": {"samples": 20, "time_limit_s": math.inf}, "greedy": {}},
    behind={"pouct": "pouct", "greedy": "greedy"},
    likelihood={"pouct": {}, "greedy": {"uniform_mix": 0.5}},
    model_version="3",
    code="c",
    asked=(
        Asked(since="monday", planners=("pouct", "greedy"), size_classes=("small",), robots=(1, 2), trials_per_cell=4),
    ),
)


def asking(planners: tuple[str, ...], robots: tuple[int, ...], trials_per_cell: int) -> RunIdentity:
    """The same run, asked for other episodes."""
    asked = Asked(
        since="tuesday", planners=planners, size_classes=("small",), robots=robots, trials_per_cell=trials_per_cell
    )
    return IDENTITY.model_copy(
        update={
            "asked": (asked,),
            "planner": {name: IDENTITY.planner.get(name, {}) for name in planners},
            "behind": {name: name for name in planners},
            "likelihood": {name: IDENTITY.likelihood.get(name, {}) for name in planners},
        }
    )


def manifest(model: TrainedModelRecord | None = MODEL, **changes: Any) -> EvaluationManifest:
    homes = EvaluatedHomes(
        source="ros_map", files=(Path("/a.yaml"),), skipped=1, read=5, evaluated=4, by_size_class={"small": 4},
        read_from=MapFiles(maps=(Path("/a.yaml"),), containers=(Path("/c.yaml"),), worlds=2, seed=0),
    )  # fmt: skip
    content: dict[str, Any] = {
        "true_likelihoods": "counted",
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
    for change in ({"version": 1}, {"seed": None}, {"colour": "red"}):
        folder.write("run.json", json.dumps(content | change).encode())
        with pytest.raises(UserError, match=r"run\.json cannot be read \(.*overwrite=true to start anew there"):
            RunIdentity.read(folder, "run.json")
        assert RunIdentity.find(folder, "run.json") is None
    folder.write("run.json", b"{")
    with pytest.raises(UserError, match=r"run\.json cannot be read \(the file: "):
        RunIdentity.read(folder, "run.json")


def test_the_hash_in_a_planners_rows_follows_all_that_decides_them_and_nothing_else() -> None:
    updates = (
        {"seed": 4}, {"planner": {"pouct": {"samples": 30}}}, {"behind": {"pouct": "greedy"}}, {"model_version": "4"},
        {"code": "d"}, {"evaluated_homes": "i"},
    )  # fmt: skip
    changed = [IDENTITY.model_copy(update=update).config_hash("pouct") for update in updates]
    assert len({IDENTITY.config_hash("pouct"), IDENTITY.config_hash("greedy"), *changed}) == 8
    other = IDENTITY.model_copy(update={"planner": {**IDENTITY.planner, "greedy": {"later_weight": 1}}})
    assert other.config_hash("pouct") == IDENTITY.config_hash("pouct")
    assert other.config_hash() != IDENTITY.config_hash()
    assert asking(("pouct",), (5,), 9).config_hash("pouct") == IDENTITY.config_hash("pouct")


def test_a_run_grows_by_what_was_not_asked_of_it() -> None:
    assert IDENTITY.joined(asking(("greedy",), (2,), 3)) is IDENTITY
    grown = IDENTITY.joined(asking(("known",), (2, 3), 5))
    assert [one.since for one in grown.asked] == ["monday", "tuesday"]
    assert list(grown.planner) == list(grown.behind) == ["pouct", "greedy", "known"]
    assert len(grown.row_keys()) == 2 * 2 * 4 + 1 * 2 * 5
    assert ("small-3-004", "known") in grown.row_keys() and ("small-3-000", "pouct") not in grown.row_keys()
    assert grown.joined(asking(("known", "greedy"), (2,), 4)) is grown, "asked for in two parts"


def test_only_what_both_runs_have_can_contradict() -> None:
    assert IDENTITY.conflicts(asking(("known", "greedy"), (7,), 2)) == []
    other = asking(("pouct", "known"), (1,), 2)
    changed = other.model_copy(update={"planner": {**other.planner, "pouct": {"samples": 30}}, "seed": 4})
    assert changed.conflicts(IDENTITY) == [
        "planner.pouct.samples: was 30, now 20", "planner.pouct.time_limit_s: was null, now Infinity",
        "seed: was 4, now 3",
    ]  # fmt: skip


def test_the_report_gets_plain_facts() -> None:
    facts = manifest().facts(StageTimes(seconds={"homes": 1.5}))
    assert facts["model"]["version"] == "3" and facts["model"]["metrics"]["log_loss"] == 0.2
    assert facts["homes"]["training"] == 12
    assert (facts["homes"]["containers"], facts["homes"]["reachable_share"]) == (40, 0.75)
    assert facts["stages"] == {"homes": 1.5}
    elsewhere = manifest(None).facts()
    assert elsewhere["model"] == {"name": "likelihood", "version": "3", "champion_version": None}
    assert elsewhere["homes"]["training"] is None and "stages" not in elsewhere


def test_the_homes_of_a_manifest_are_read_again_by_the_same_kind_of_source() -> None:
    houses = HouseFiles(files=(Path("/h.jsonl"),), skip_faulty=True)
    for source in (houses, manifest().homes.read_from):
        homes = manifest().homes.model_copy(update={"read_from": source})
        again = EvaluationManifest.from_json(manifest(homes=homes).to_json(), "")
        assert again.homes.read_from == source
