"""Which homes are made again, and when."""

from pathlib import Path

import pytest

from mrtask.sources import hash_module
from pipeline.inputs import homes
from pipeline.store import artifacts
from tests.pipeline.harness import Cli
from tests.pipeline.test_stages import homes_manifest

SMALL = ("homes.train=3", "homes.validation=1", "homes.test=2")


def edit(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if a line of the module had changed."""
    monkeypatch.setattr(homes, "hash_module", lambda name: hash_module(name) + ("edited" if name == module else ""))


def made(folder: Path) -> dict[str, int]:
    """The folders below with the time of their making."""
    return {path.name: (path / artifacts.MANIFEST).stat().st_mtime_ns for path in folder.iterdir()}


def test_other_code_of_the_generator_makes_other_homes(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cli("homes", *SMALL).code == 0
    before = made(tmp_path / "datasets/generated")
    assert "(unchanged, skipped)" in cli("homes", *SMALL).out
    assert made(tmp_path / "datasets/generated") == before
    edit("mrtask.homes.generator.house", monkeypatch)
    assert cli("homes", *SMALL).code == 0
    assert len(made(tmp_path / "datasets/generated")) == 2


@pytest.mark.parametrize("module", ["mrtask.homes.procthor", "mrtask.homes.split"])
def test_other_code_of_reader_or_split_makes_another_set_of_the_same_houses(
    module: str, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cli("homes", *SMALL).code == 0
    before = made(tmp_path / "datasets/generated")
    edit(module, monkeypatch)
    again = cli("homes", *SMALL)
    assert again.code == 0 and "(unchanged, skipped)" not in again.out
    assert made(tmp_path / "datasets/generated") == before
    first, second = (homes_manifest(folder) for folder in (tmp_path / "datasets/homes").iterdir())
    assert first == second


def test_another_split_is_one_of_the_same_houses(cli: Cli, tmp_path: Path) -> None:
    assert cli("homes", *SMALL).code == 0
    assert cli("homes", "homes.train=2", "homes.validation=2", "homes.test=2").code == 0
    assert len(made(tmp_path / "datasets/generated")) == 1
    first, second = (homes_manifest(folder) for folder in (tmp_path / "datasets/homes").iterdir())
    assert first.content_hash == second.content_hash and first.split != second.split


def test_houses_that_were_removed_are_generated_again(cli: Cli, tmp_path: Path) -> None:
    assert cli("homes", *SMALL).code == 0
    [folder] = (tmp_path / "datasets/generated").iterdir()
    content = (folder / homes.GENERATED_FILE).read_bytes()
    (folder / artifacts.MANIFEST).unlink()
    (folder / homes.GENERATED_FILE).unlink()
    assert "(unchanged, skipped)" in cli("homes", *SMALL).out
    assert (folder / homes.GENERATED_FILE).read_bytes() == content


def test_a_place_that_cannot_be_written_is_told_in_one_line(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    refused = cli("homes", *SMALL, "datasets_dir=file/datasets")
    assert refused.code == 2
    assert "cannot write in" in refused.err and "give another place by datasets_dir=" in refused.err
