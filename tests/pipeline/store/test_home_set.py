"""A set of homes: its parts, and what planners are evaluated on."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from mrtask.homes.generator.house import generate_house
from mrtask.homes.split import split_homes
from pipeline.store.home_files import HouseFiles, MapFiles
from pipeline.store.home_set import HomeSet
from pipeline.store.records import HomesManifest
from tests.pipeline.test_own_map import CONTAINERS, write_lab


@pytest.fixture
def home_set(tmp_path: Path) -> HomeSet:
    """Six small houses: three to train on, one to stop by, two to evaluate on."""
    path = tmp_path / "houses.jsonl"
    path.write_text("".join(json.dumps(generate_house(seed, "small")) + "\n" for seed in range(6)))
    houses = HouseFiles(files=(path,))
    ids = [home.id for home in houses.read()]
    manifest = HomesManifest(
        source="procthor", files=houses.files, seed=0, code_version="", content_hash="", homes=6, skipped=0, faults=(),
        by_size_class={"small": 6}, containers=60, split=split_homes(ids, 3, 1),
    )  # fmt: skip
    return HomeSet(tmp_path, manifest, houses)


def test_each_part_has_the_homes_that_the_manifest_lists(home_set: HomeSet) -> None:
    parts = home_set.read()
    assert {name: len(homes) for name, homes in parts.items()} == {"train": 3, "validation": 1, "test": 2}
    assert {name: tuple(home.id for home in homes) for name, homes in parts.items()} == home_set.split
    assert {home.id for homes in parts.values() for home in homes} == {home.id for home in home_set.houses.read()}


def test_planners_are_evaluated_on_the_test_homes_or_on_the_maps(home_set: HomeSet, tmp_path: Path) -> None:
    assert home_set.evaluation_homes() == (home_set.houses, home_set.read()["test"])
    write_lab(tmp_path, CONTAINERS)
    maps = MapFiles(maps=(tmp_path / "lab.yaml",), containers=(tmp_path / "containers.yaml",), worlds=2, seed=0)
    assert replace(home_set, maps=maps).evaluation_homes() == (maps, maps.read())


def test_the_manifest_is_read_as_it_was_written(home_set: HomeSet) -> None:
    assert HomesManifest.from_json(home_set.manifest.to_json(), "manifest.json") == home_set.manifest
