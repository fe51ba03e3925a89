"""A scanned floor of one's own as the home: from a drawn map to the report by one command."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from mrtask.maps.ros_map import read_ros_map
from tests.pipeline.harness import Cli, Workspace
from tests.pipeline.test_stages import evaluation_manifest

MAP = """image: lab.pgm
resolution: 0.05
origin: [0.0, 0.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
CONTAINERS = """rooms: {kitchen: Kitchen, lounge: LivingRoom}
containers:
  - {name: fridge, type: Fridge, room: kitchen, position: [0.5, 0.5]}
  - {name: counter, type: CounterTop, room: kitchen, position: [1.2, 3.5], size: [1.6, 0.6]}
  - {name: table, type: DiningTable, room: kitchen, position: [1.5, 2.0], size: [1.0, 0.7]}
  - {name: sofa, type: Sofa, room: lounge, position: [5.0, 3.4], size: [1.8, 0.8]}
  - {name: shelf, type: ShelvingUnit, room: lounge, position: [6.6, 0.4], size: [0.8, 0.4]}
  - {name: desk, type: Desk, room: lounge, position: [4.0, 0.5], size: [1.2, 0.6]}
"""
LISTED = CONTAINERS.replace("0.5]}", "0.5], objects: [Egg, Apple, Bread]}", 1).replace(
    "3.4], size: [1.8, 0.8]}", "3.4], size: [1.8, 0.8], objects: [Pillow, RemoteControl]}"
)


def write_lab(folder: Path, containers: str) -> tuple[str, ...]:
    """7 x 4 m with a wall at x = 3 m that has a gap of 1 m."""
    cells = np.full((80, 140), 254, np.uint8)
    cells[[0, -1]], cells[:, [0, -1]] = 0, 0
    cells[:, 60:62] = 0
    cells[30:50, 60:62] = 254
    Image.fromarray(np.flipud(cells)).save(folder / "lab.pgm")
    (folder / "lab.yaml").write_text(MAP)
    (folder / "containers.yaml").write_text(containers)
    return ("homes=ros_map", "homes.map=lab.yaml", "homes.containers=containers.yaml")


def test_one_command_from_map_to_report(workspace: Workspace, cli: Cli) -> None:
    lab = write_lab(workspace.path, CONTAINERS)
    done = cli("reproduce", *workspace.overrides, *lab, "homes.worlds=3", "output_dir=outputs/lab", cwd=workspace.path)
    assert done.code == 0, done.err
    assert "lab.yaml: 26.6 m2 of floor (small), 2 rooms, 6 containers" in done.out and "warning" not in done.out
    assert "3 worlds to evaluate on" in done.out
    assert "no medium and no large map: trials on small only" in done.out
    assert done.out.count("(unchanged, skipped)") == 3, "the model is that of homes=generated"
    frame = pd.read_parquet(workspace.path / "outputs/lab/episodes")
    assert set(frame["status"]) == {"accepted"}
    assert set(frame["home_source"]) == {"lab.yaml"}
    assert set(frame["size_class"]) == {"small"}
    assert len(frame) == 2 * 2 * 2
    assert frame["home_id"].nunique() > 1
    assert "no episode is drawn" not in done.out
    manifest = evaluation_manifest(workspace.path / "outputs/lab")
    assert (manifest.homes.source, manifest.homes.evaluated, manifest.reach.share) == ("ros_map", 3, 1.0)
    again = cli("reproduce", *workspace.overrides, *lab, "homes.worlds=3", "output_dir=outputs/lab", cwd=workspace.path)
    assert again.out.count("(unchanged, skipped)") == 5


def test_listed_objects_are_where_the_list_says(workspace: Workspace, cli: Cli) -> None:
    lab = write_lab(workspace.path, LISTED)
    overrides = [*workspace.overrides, *lab, "evaluation.templates=[and2,seq2]", "output_dir=outputs/listed"]
    done = cli("evaluate", *overrides, cwd=workspace.path)
    assert done.code == 0, done.err
    assert "contents as listed" in done.out
    frame = pd.read_parquet(workspace.path / "outputs/listed/episodes")
    home = read_ros_map(workspace.path / "lab.yaml", workspace.path / "containers.yaml")
    assert set(frame["home_id"]) == {home.id}
    assert {name for names in frame["objects"] for name in names} <= {
        "Egg", "Apple", "Bread", "Pillow", "RemoteControl",
    }  # fmt: skip


def test_the_map_is_drawn_as_it_was_read_and_what_is_doubtful_is_said(workspace: Workspace, cli: Cli) -> None:
    folder = workspace.path / "doubtful"
    folder.mkdir()
    lab = [one.replace("=lab", "=doubtful/lab").replace("=c", "=doubtful/c") for one in write_lab(folder, CONTAINERS)]
    cells = np.flipud(np.array(Image.open(folder / "lab.pgm"))).copy()
    cells[60:79, 120:122], cells[60:62, 120:139] = 0, 0  # a closet in the corner is shut
    cells[5:8, 5:8] = 205
    Image.fromarray(np.flipud(cells)).save(folder / "lab.pgm")
    (folder / "lab.yaml").write_text(MAP.replace("0.196", "0.25"))
    done = cli("homes", *workspace.overrides, *lab, "draw=true", "output_dir=outputs/plan", cwd=workspace.path)
    assert done.code == 0, done.err
    drawn = sorted(path.name for path in (workspace.path / "outputs/plan/homes").iterdir())
    assert len(drawn) == 6
    assert drawn[:4] == ["gallery.png", "gallery.svg", "scan-lab.png", "scan-lab.svg"]
    assert all(name.startswith("small-") for name in drawn[4:])
    for said in (
        "warning: lab.yaml: 9 cells of grey 205",
        "warning: lab.yaml: 0.7 m2 of free floor in 1 region are left",
    ):
        assert said in done.out


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("type: Sofa", "type: Couch", ["containers.yaml, line 6: containers[3].type", "Couch", "Sofa", "list the obj"]),
        ("position: [5.0, 3.4]", "position: [50, 3.4]", ["containers.yaml, line 6: containers[3].position"]),
    ],
)
def test_mistakes_in_the_files_are_told_before_any_work(
    cli: Cli, tmp_path: Path, old: str, new: str, said: list[str]
) -> None:
    done = cli("reproduce", *write_lab(tmp_path, CONTAINERS.replace(old, new)))
    assert done.code == 2
    assert "Traceback" not in done.err
    for part in said:
        assert part in done.err
    assert not (tmp_path / "datasets").exists()


def test_missing_files_are_told(cli: Cli, tmp_path: Path) -> None:
    lab = write_lab(tmp_path, CONTAINERS)
    done = cli("homes", *lab[:2], "homes.containers=gone.yaml")
    assert (done.code, "homes.containers: no such file" in done.err) == (2, True)
