"""A set of homes: its parts, and what planners are evaluated on."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from mrtask.homes.catalogue import AssetDatabase
from mrtask.homes.generator.house import generate_house
from mrtask.homes.split import split_homes
from pipeline.base.config import UserError
from pipeline.base.sections import EvaluationHomes
from pipeline.store.home_files import HouseFiles, MapFiles
from pipeline.store.home_set import HomeSet
from pipeline.store.records import HomesManifest
from tests.pipeline.test_own_map import CONTAINERS, write_lab

NOT_GIVEN = EvaluationHomes(files=(), assets=None, skip_faulty=False, order="shuffled")


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
    source, found = home_set.evaluation_homes(NOT_GIVEN)
    assert source == home_set.houses
    assert found == tuple(home for home in home_set.houses.read() if home.id in home_set.split["test"])  # file order
    write_lab(tmp_path, CONTAINERS)
    maps = MapFiles(maps=(tmp_path / "lab.yaml",), containers=(tmp_path / "containers.yaml",), worlds=2, seed=0)
    assert replace(home_set, instead_of_test=maps).evaluation_homes(NOT_GIVEN) == (maps, maps.read())


def test_other_homes_are_evaluated_on_where_they_are_given(home_set: HomeSet, tmp_path: Path) -> None:
    others = tmp_path / "others.jsonl"
    others.write_text(json.dumps(generate_house(7, "small")) + "\n" + json.dumps({"name": "no house"}) + "\n")
    given = EvaluationHomes(files=(others,), assets=None, skip_faulty=True, order="shuffled")
    source, found = home_set.evaluation_homes(given)
    assert source == HouseFiles(files=(others,), skip_faulty=True)
    assert len(found) == len(source.read()) == len(source.faults()) == 1


def test_other_homes_are_read_with_the_sets_assets_unless_they_have_their_own(
    home_set: HomeSet, tmp_path: Path, two_room_house: dict[str, Any], two_room_assets: AssetDatabase
) -> None:
    """The hand-made house names its assets only, so that no type is known without their database."""
    others = tmp_path / "others.jsonl"
    others.write_text(json.dumps(two_room_house) + "\n")
    entries = {
        kind: [
            {"assetId": name, "boundingBox": asset.size_m._asdict()}
            for name, asset in two_room_assets.items()
            if asset.type == kind
        ]
        for kind in {asset.type for asset in two_room_assets.values()}
    }
    for name, scale in (("assets.json", 1.0), ("own.json", 0.5)):
        scaled = {
            kind: [
                entry | {"boundingBox": {axis: side * scale for axis, side in entry["boundingBox"].items()}}
                for entry in listed
            ]
            for kind, listed in entries.items()
        }
        (tmp_path / name).write_text(json.dumps(scaled))
    given = EvaluationHomes(files=(others,), assets=None, skip_faulty=False, order="shuffled")
    with pytest.raises(UserError, match=r"others\.jsonl, line 1"):
        home_set.evaluation_homes(given)
    with_assets = replace(home_set, houses=home_set.houses.model_copy(update={"assets": tmp_path / "assets.json"}))
    source, [home] = with_assets.evaluation_homes(given)
    assert source.paths == (others, tmp_path / "assets.json")
    assert [container.type for container in home.containers] == ["Fridge", "DiningTable", "Bed"]
    own = given.model_copy(update={"assets": tmp_path / "own.json"})
    source, [smaller] = with_assets.evaluation_homes(own)
    assert source.paths == (others, tmp_path / "own.json")
    assert smaller.id != home.id


def test_the_manifest_is_read_as_it_was_written(home_set: HomeSet) -> None:
    assert HomesManifest.from_json(home_set.manifest.to_json(), "manifest.json") == home_set.manifest
