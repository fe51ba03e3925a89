"""Homes of any source, refurnished by the votes of people."""

import hashlib
import json
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pandas as pd
import pytest

from mrtask.homes.download import HOUSEKEEP, SPLITS_FILE, VOTES_FILE, RemoteFile
from mrtask.homes.generator.house import generate_house
from mrtask.homes.votes import VotesError
from pipeline.base.config import UserError
from pipeline.base.sections import Contents
from pipeline.store import voted_contents as module
from pipeline.store.home_files import HouseFiles, MapFiles
from pipeline.store.voted_contents import voted_contents
from tests.homes.made_up_votes import Evil, content, write, write_splits
from tests.pipeline import harness
from tests.pipeline.harness import Cli
from tests.pipeline.test_own_map import CONTAINERS, write_lab
from tests.pipeline.test_stages import homes_manifest

SMALL = ("homes.train=3", "homes.validation=1", "homes.test=2")
HUMAN = ("homes.contents=housekeep", "contents.file=votes.npy", "contents.sha256=null")
DEFAULT = Contents(
    file=None, sha256=None, objects="all", splits=None, table=None, misplaced=0.1, seed=0, embedding="bundled-minilm"
)


def own(folder: Path, **options: object) -> Contents:
    """Made-up votes with their splits."""
    files = {"file": write(folder / "votes.npy"), "splits": write_splits(folder / "splits.yaml")}
    return DEFAULT.model_copy(update=files | options)


@pytest.fixture
def houses(tmp_path: Path) -> HouseFiles:
    """Four small houses with the contents that they come with."""
    path = tmp_path / "houses.jsonl"
    path.write_text("".join(json.dumps(generate_house(seed, "small")) + "\n" for seed in range(4)))
    return HouseFiles(files=(path,))


def test_homes_keep_order_and_layout_and_hold_what_people_put_there(houses: HouseFiles, tmp_path: Path) -> None:
    contents = voted_contents(own(tmp_path), tmp_path)
    refurnished = houses.model_copy(update={"contents": contents})
    before, after = houses.read(), refurnished.read()
    assert [home.layout_id for home in before] == [home.layout_id for home in after]
    assert not {home.id for home in before} & {home.id for home in after}
    held = {name for home in after for container in home.containers for name in container.objects}
    assert held == {"Mug", "RemoteControl", "Pillow", "ToothBrush", "CatToy", "SpareKey"}
    assert refurnished.as_they_come() == houses and refurnished.faults() == ()
    assert contents.splits is None, "the splits are needed only for one of them"
    for_test = voted_contents(own(tmp_path, objects="test"), tmp_path)
    fewer = houses.model_copy(update={"contents": for_test}).read()
    assert {name for home in fewer for container in home.containers for name in container.objects} == {
        "CatToy", "SpareKey",
    }  # fmt: skip


def test_a_homes_contents_depend_on_itself_and_the_seed_alone(houses: HouseFiles, tmp_path: Path) -> None:
    contents = voted_contents(own(tmp_path), tmp_path)
    homes = houses.read()
    together = contents.furnish(homes)
    assert [contents.furnish([home])[0] for home in homes] == list(together)
    other = contents.model_copy(update={"seed": 1}).furnish(homes)
    assert all(one.id != two.id for one, two in zip(together, other, strict=True))


def test_worlds_of_a_map_are_refurnished_too(tmp_path: Path) -> None:
    write_lab(tmp_path, CONTAINERS)
    maps = MapFiles(maps=(tmp_path / "lab.yaml",), containers=(tmp_path / "containers.yaml",), worlds=3, seed=0)
    contents = voted_contents(own(tmp_path), tmp_path)
    worlds = maps.model_copy(update={"contents": contents}).read()
    assert [world.layout_id for world in worlds] == [world.layout_id for world in maps.read()]
    held = {name for world in worlds for container in world.containers for name in container.objects}
    assert held <= set(contents.votes().objects) and len(held) > 3


def test_the_split_is_that_of_the_homes_as_they_come(cli: Cli, tmp_path: Path) -> None:
    write(tmp_path / "votes.npy")
    plain = cli("homes", *SMALL)
    human = cli("homes", *SMALL, *HUMAN)
    assert plain.code == human.code == 0, human.err
    assert "these have no votes and stay empty: GarbageCan" in human.out
    assert "(unchanged, skipped)" in cli("homes", *SMALL, *HUMAN).out
    assert "(unchanged, skipped)" not in cli("homes", *SMALL, *HUMAN, "contents.misplaced=0.5").out
    manifests = [homes_manifest(folder) for folder in (tmp_path / "datasets/homes").iterdir()]
    assert len(manifests) == 3
    houses = HouseFiles(files=manifests[0].files)
    layouts = {home.id: home.layout_id for home in houses.read()}
    as_they_come = next(manifest for manifest in manifests if set(manifest.split.test) <= set(layouts))
    for options in (own(tmp_path), own(tmp_path, misplaced=0.5)):
        contents = voted_contents(options, tmp_path)
        refurnished = houses.model_copy(update={"contents": contents})
        new_layouts = {home.id: home.layout_id for home in refurnished.read()}
        manifest = next(manifest for manifest in manifests if set(manifest.split.test) <= set(new_layouts))
        for part in ("train", "validation", "test"):
            expected = {layouts[home_id] for home_id in getattr(as_they_come.split, part)}
            assert {new_layouts[home_id] for home_id in getattr(manifest.split, part)} == expected


@pytest.mark.usefixtures("_houses_are_there")
def test_planners_are_evaluated_in_homes_with_peoples_contents(cli: Cli, tmp_path: Path) -> None:
    """In a folder of its own: another model in the shared workspace would become its champion."""
    write(tmp_path / "votes.npy")
    done = cli("reproduce", *harness.SMALL, *HUMAN, "output_dir=outputs/human")
    assert done.code == 0, done.err
    episodes = pd.read_parquet(tmp_path / "outputs/human/episodes")
    assert set(episodes["status"]) == {"accepted"}
    asked = {name for names in episodes["objects"] for name in names}
    assert asked <= {"Mug", "RemoteControl", "Pillow", "ToothBrush", "CatToy", "SpareKey"} and len(asked) > 3


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ThreadingHTTPServer:
    """The made-up files behind the addresses of the real ones."""
    folder = tmp_path / "served"
    folder.mkdir()
    write(folder / VOTES_FILE)
    write_splits(folder / SPLITS_FILE)
    handler = partial(SimpleHTTPRequestHandler, directory=str(folder))
    monkeypatch.setattr(SimpleHTTPRequestHandler, "log_message", lambda *_: None)
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.server_port}/"
    sha256 = hashlib.sha256((folder / VOTES_FILE).read_bytes()).hexdigest()
    monkeypatch.setitem(HOUSEKEEP, VOTES_FILE, RemoteFile(url + VOTES_FILE, 1, sha256))  # type: ignore[arg-type]
    monkeypatch.setitem(HOUSEKEEP, SPLITS_FILE, RemoteFile(url + SPLITS_FILE, 1, None))  # type: ignore[arg-type]
    return server


def test_the_votes_are_downloaded_once_and_then_used_offline(served: ThreadingHTTPServer, tmp_path: Path) -> None:
    first = voted_contents(DEFAULT, tmp_path / "datasets")
    assert first.file == tmp_path / "datasets/housekeep" / VOTES_FILE
    served.shutdown()
    served.server_close()
    assert voted_contents(DEFAULT, tmp_path / "datasets") == first
    with pytest.raises(UserError, match=r"where people put things: data.npy: .* cannot be reached .*contents.file="):
        voted_contents(DEFAULT, tmp_path / "elsewhere")
    with pytest.raises(UserError, match=r"splits.yaml: .* or named by contents.splits="):
        voted_contents(DEFAULT.model_copy(update={"objects": "test"}), tmp_path / "datasets")


def test_other_files_than_the_published_are_refused(
    served: ThreadingHTTPServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(VotesError, match=r"splits.yaml: its names have the sha256 .*, expected .*: these are other"):
        voted_contents(DEFAULT.model_copy(update={"objects": "test"}), tmp_path / "datasets")
    monkeypatch.setattr(module, "HOUSEKEEP", {VOTES_FILE: RemoteFile(HOUSEKEEP[VOTES_FILE].url, 1, "0" * 64)})
    with pytest.raises(UserError, match=r"data.npy: the file from http.* does not have the sha256 0000"):
        voted_contents(DEFAULT, tmp_path / "again")
    served.shutdown()
    served.server_close()


def test_models_are_measured_on_objects_that_they_never_saw(cli: Cli, tmp_path: Path) -> None:
    write(tmp_path / "votes.npy")
    write_splits(tmp_path / "splits.yaml")
    files = ("contents.file=votes.npy", "contents.sha256=null", "contents.splits=splits.yaml")
    done = cli("housekeep", *SMALL, *files, "housekeep.models=[frequency]", "housekeep.trained_on=[human,homes,both]")
    assert done.code == 0, done.err
    assert "2 objects that no model has seen" in done.out and "RoBERTa, contrastive 0.808" in done.out
    table = pd.read_csv(tmp_path / "outputs/paper/housekeep.csv")
    assert list(table["trained_on"]) == ["human", "homes", "both"]
    assert table["map"].between(0, 1).all()
    refused = cli("housekeep", *files, "homes.contents=housekeep")
    assert refused.code == 2 and "models may not see the test objects in homes" in refused.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("contents.file=gone.npy",), "no such file of votes"),
        ((), "has the sha256"),
        (("contents.sha256=null", "contents.objects=validation"), "contents.objects=validation: allowed: 'all', "),
        (("contents.sha256=null", "contents.misplaced=2"), "contents.misplaced=2: must be at most 1"),
        (("contents.sha256=null", "contents.table=gone.toml"), "gone.toml is not a table of receptacles"),
        (("contents.sha256=null", "contents.objects=val", "contents.splits=gone.yaml"), "no such file of splits"),
        (
            ("contents.sha256=null", "contents.objects=val", "contents.splits=none.yaml"),
            "the split 'val' has no objects",
        ),
        (("contents.sha256=null", "contents.file=evil.npy"), "asks for posix.mkdir; only numpy's arrays are allowed"),
        (("contents.sha256=null", "contents.file=nowhere.npy"), "nobody knows a right place for the object 'mug'"),
    ],
)
def test_mistakes_are_told_in_one_line(options: tuple[str, ...], message: str, cli: Cli, tmp_path: Path) -> None:
    write(tmp_path / "votes.npy")
    write_splits(tmp_path / "none.yaml", {"train": ["mug"], "val": [], "test": ["cat toy"]})
    write(tmp_path / "evil.npy", content() | {"more": Evil(tmp_path / "ran")})
    ranks = content()["ranks"]
    ranks[:, 0] = 0
    write(tmp_path / "nowhere.npy", content() | {"ranks": ranks})
    done = cli("homes", *SMALL, "homes.contents=housekeep", "contents.file=votes.npy", *options)
    assert done.code == 2
    assert message in done.err and "Traceback" not in done.err
    assert not (tmp_path / "ran").exists(), "nothing of a pickle is run"
    assert not list((tmp_path / "datasets").glob("generated/*")), "nothing is made before it is refused"
