"""Sources of homes: what they read, what they refuse, and that a record of one reads the same homes again."""

import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from mrtask.homes.generator.house import generate_house
from mrtask.homes.home import Home
from mrtask.homes.procthor import HouseError
from pipeline.base.config import UserError
from pipeline.store.home_files import (
    HomeFiles,
    HouseFiles,
    MapFiles,
    check_files,
    count_by_size_class,
    distinct_layouts,
    say_faults,
)
from tests.pipeline.test_own_map import CONTAINERS, LISTED, write_lab

FILES: TypeAdapter[HomeFiles] = TypeAdapter(HomeFiles)


@pytest.fixture(scope="module")
def houses() -> list[dict[str, Any]]:
    """Three small houses."""
    return [generate_house(seed, "small") for seed in range(3)]


def write(path: Path, houses: list[dict[str, Any]]) -> Path:
    path.write_text("".join(json.dumps(house) + "\n" for house in houses))
    return path


def lab(folder: Path, containers: str, worlds: int = 3) -> MapFiles:
    write_lab(folder, containers)
    return MapFiles(maps=(folder / "lab.yaml",), containers=(folder / "containers.yaml",), worlds=worlds, seed=0)


def test_each_distinct_house_is_read_once_in_order(tmp_path: Path, houses: list[dict[str, Any]]) -> None:
    first = HouseFiles(files=(write(tmp_path / "first.jsonl", houses[:2]),))
    second = write(tmp_path / "second.jsonl", [houses[2], houses[0]])
    both = HouseFiles(files=(*first.files, second))
    assert len(both.read()) == 3
    assert [home.id for home in both.read()][:2] == [home.id for home in first.read()]
    assert both.faults() == ()
    assert both.paths == both.files


def test_faulty_houses_are_an_error_unless_they_are_skipped(
    tmp_path: Path, houses: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "some.jsonl", [houses[0], {"name": "no house"}, houses[1]])
    with pytest.raises(UserError, match=r"some\.jsonl, line 2.*\nhomes\.skip_faulty=true"):
        HouseFiles(files=(path,)).read()
    lenient = HouseFiles(files=(path,), skip_faulty=True)
    assert len(lenient.read()) == 2
    say_faults(lenient)
    assert "faulty homes left out: 1; the first: some.jsonl, line 2" in capsys.readouterr().out
    none = HouseFiles(files=(write(tmp_path / "none.jsonl", [{"name": "no house"}] * 2),), skip_faulty=True)
    with pytest.raises(UserError, match=r"all 2 are faulty; the first: none\.jsonl, line 1"):
        none.read()
    with pytest.raises(HouseError, match=r"gone\.jsonl: no such file"):
        HouseFiles(files=(tmp_path / "gone.jsonl",), skip_faulty=True).read()


def test_without_faults_nothing_is_said(
    tmp_path: Path, houses: list[dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    say_faults(HouseFiles(files=(write(tmp_path / "good.jsonl", houses),)))
    assert capsys.readouterr().out == ""


def test_the_asset_database_is_read_and_listed(shared_homes: Path) -> None:
    file, assets = shared_homes / "procthor-2to3room.jsonl.gz", shared_homes / "asset-database.json"
    source = HouseFiles(files=(file,), assets=assets, skip_faulty=True)
    assert source.paths == (file, assets)
    assert len(source.read()) > 0


def test_a_map_gives_worlds_that_differ_in_their_contents(tmp_path: Path) -> None:
    source = lab(tmp_path, CONTAINERS)
    assert len(source.read()) == 3
    assert len(distinct_layouts(source.read())) == 1
    assert source.faults() == ()
    assert {path.name for path in source.paths} == {"lab.yaml", "containers.yaml"}


def test_a_map_whose_objects_are_listed_gives_one_home(tmp_path: Path) -> None:
    assert len(lab(tmp_path, LISTED).read()) == 1


@pytest.mark.parametrize("kind", ["houses", "maps"])
def test_a_recorded_source_reads_the_same_homes(kind: str, tmp_path: Path, houses: list[dict[str, Any]]) -> None:
    source: HomeFiles
    if kind == "houses":
        source = HouseFiles(files=(write(tmp_path / "a.jsonl", houses),), skip_faulty=True)
    else:
        source = lab(tmp_path, CONTAINERS)
    recorded = FILES.dump_json(source)
    assert json.loads(recorded)["kind"] == kind
    again = FILES.validate_json(recorded)
    assert again == source
    assert again.read() == source.read()


def test_a_record_of_no_known_kind_is_refused() -> None:
    with pytest.raises(ValidationError, match="'houses', 'maps'"):
        FILES.validate_python({"kind": "blueprints", "files": []})


def test_missing_files_are_refused_by_the_key_that_names_them(tmp_path: Path) -> None:
    (tmp_path / "there").touch()
    check_files("homes.files", [tmp_path / "there", None])
    with pytest.raises(UserError, match=r"^homes\.assets: no such file: .*/gone$"):
        check_files("homes.assets", [tmp_path / "gone"])
    with pytest.raises(UserError, match="no such file"):
        check_files("homes.files", [tmp_path])


def test_homes_are_counted_from_small_to_large(generated_homes: list[Home]) -> None:
    assert list(count_by_size_class(generated_homes[3:]).items()) == [("small", 0), ("medium", 3), ("large", 3)]
