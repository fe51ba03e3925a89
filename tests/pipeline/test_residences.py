"""Residences, and sites of one's own homes, as the homes that planners are evaluated on."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest

from mrtask.homes.generator.house import generate_house, write_houses
from mrtask.homes.generator.site import id_in_flat
from mrtask.homes.home import Home
from mrtask.homes.procthor import parse_house, read_houses
from mrtask.maps.home_map import map_bytes
from pipeline.base.specs import MapOptions
from pipeline.episodes import worker
from pipeline.inputs.homes import RESIDENCES_FILE
from tests.pipeline.configured import configured
from tests.pipeline.harness import Cli, Workspace
from tests.pipeline.test_stages import evaluation_manifest

ONE = ("homes=residence", "homes.residences=1", "homes.containers=50")
FEW = ("evaluation.trials_per_cell=1", "evaluation.robots=[2]")


def test_planners_run_in_a_residence_of_a_class_of_its_own(workspace: Workspace, cli: Cli) -> None:
    overrides = [*workspace.overrides, *ONE, *FEW, "output_dir=outputs/residence"]
    missing = cli("homes", *overrides, "dry_run=true", cwd=workspace.path)
    assert "would make or read residence homes" in missing.out
    done = cli("evaluate", *overrides, cwd=workspace.path)
    assert done.code == 0, done.err
    assert "1 residence of 50 containers" in done.out
    frame = pd.read_parquet(workspace.path / "outputs/residence/episodes")
    assert set(frame["size_class"]) == {"residence"} and set(frame["status"]) == {"accepted"}
    homes = evaluation_manifest(workspace.path / "outputs/residence").homes
    assert (homes.source, homes.by_size_class["residence"]) == ("residence", 1)


def test_ones_own_homes_are_joined_to_one_site(cli: Cli, tmp_path: Path) -> None:
    houses = [generate_house(seed, "small") for seed in (1, 2)]
    write_houses(tmp_path / "a.jsonl.gz", houses[:1])
    write_houses(tmp_path / "b.jsonl.gz", houses[1:])
    few = ("homes.train=3", "homes.validation=1", "homes.test=2")
    done = cli("homes", "homes=residence", "homes.join=[a.jsonl.gz,b.jsonl.gz]", *few)
    assert done.code == 0, done.err
    assert "a site of the homes in a.jsonl.gz, b.jsonl.gz" in done.out
    [folder] = (tmp_path / "datasets/residences").iterdir()
    [site] = read_houses([folder / RESIDENCES_FILE])
    homes = [parse_house(house, None, "own", 0) for house in houses]
    ids = [id_in_flat(one.id, number) for number, home in enumerate(homes, start=1) for one in home.containers]
    assert [one.id for one in site.containers] == ids
    missing = cli("homes", "homes=residence", "homes.join=[gone.jsonl]", *few)
    assert missing.code == 2 and "homes.join: no such file" in missing.err


def test_a_residence_leaves_no_size_class_to_choose() -> None:
    assert configured("homes=residence").evaluation_spec().options.size_classes == ("residence",)
    other = configured("homes=residence", "evaluation.homes.files=[a.jsonl]", "evaluation.size_classes=[small]")
    assert other.evaluation_spec().options.size_classes == ("small",)
    assert configured().evaluation_spec().options.size_classes == ("small", "medium", "large")


def test_workers_keep_fewer_maps_where_they_are_large(
    two_room_home: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    context: Any = SimpleNamespace(homes=(two_room_home,), maps=MapOptions(configured().map, tmp_path))
    one = map_bytes(two_room_home, context.maps.grid.resolution_m)
    for room_for, kept in ((2**31, worker.MAPS_KEPT), (3 * one, 3), (1, 1)):
        monkeypatch.setattr(worker, "MAPS_KEPT_BYTES", room_for)
        assert worker.Bench(context).map_of.cache_parameters()["maxsize"] == kept
