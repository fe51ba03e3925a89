"""A floor scanned with ROS: makes a sample map (image, map_server's YAML, list of containers) and plans on it.

`python examples/ros_map.py lab` writes lab/lab.pgm, lab/lab.yaml and lab/containers.yaml, which the pipeline takes by
`homes=ros_map homes.map=lab/lab.yaml homes.containers=lab/containers.yaml`.

With a scan of your own you need none of this but the list of containers.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from mrtask import fit_on_homes, generate_homes, read_map_worlds, run_experiment

RESOLUTION_M = 0.05
FREE, WALL = 254, 0
SIZE_M = (7.2, 4.2)
"""Of the floor with its outer walls, from (-0.1, -0.1) to (7.1, 4.1)."""
ORIGIN_M = (-0.1, -0.1)
CONTAINERS = """\
# positions (the middle) and sizes (width, depth) in the map's metres
rooms: {kitchen: Kitchen, lounge: LivingRoom}     # optional: a room's type; any name will do
containers:
  - {name: fridge, type: Fridge, room: kitchen, position: [0.5, 0.5]}
  - {name: counter, type: CounterTop, room: kitchen, position: [1.2, 3.5], size: [1.6, 0.6]}
  - {name: table, type: DiningTable, room: kitchen, position: [1.5, 2.0], size: [1.0, 0.7]}
  - {name: sofa, type: Sofa, room: lounge, position: [5.0, 3.4], size: [1.8, 0.8]}
  - {name: shelf, type: ShelvingUnit, room: lounge, position: [6.6, 0.4], size: [0.8, 0.4]}
  - {name: desk, type: Desk, room: lounge, position: [4.0, 0.5], size: [1.2, 0.6], yaw_deg: 0}
"""


def write_sample(folder: Path) -> tuple[Path, Path]:
    """A kitchen and a lounge with a wall and a doorway between them; the paths of the map and of its containers."""
    folder.mkdir(parents=True, exist_ok=True)
    cols, rows = (round(length / RESOLUTION_M) for length in SIZE_M)
    scan = np.full((rows, cols), FREE, np.uint8)
    scan[:2], scan[-2:], scan[:, :2], scan[:, -2:] = WALL, WALL, WALL, WALL
    wall, low, high = (round((at_m - ORIGIN_M[0]) / RESOLUTION_M) for at_m in (3.0, 1.5, 2.6))
    scan[:low, wall : wall + 2] = WALL
    scan[high:, wall : wall + 2] = WALL
    Image.fromarray(np.flipud(scan)).save(folder / "lab.pgm")  # images start at the top, maps at the bottom
    (folder / "lab.yaml").write_text(
        f"image: lab.pgm\nresolution: {RESOLUTION_M}\norigin: [{ORIGIN_M[0]}, {ORIGIN_M[1]}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    (folder / "containers.yaml").write_text(CONTAINERS)
    return folder / "lab.yaml", folder / "containers.yaml"


def main(folder: Path) -> None:
    """Writes the sample and runs two planners on it, in worlds whose contents are drawn."""
    paths = write_sample(folder)
    print("wrote", ", ".join(map(str, paths)))
    worlds = read_map_worlds(*paths, worlds=10, seed=0)
    print(f"{worlds[0].area_m2:.0f} m2, {len(worlds[0].containers)} containers, {len(worlds)} worlds")
    episodes = run_experiment(
        worlds, ["nonlearned_myopic", "greedy"], fit_on_homes(generate_homes(12)), robots=[2], trials_per_cell=6
    )
    print(episodes.groupby("planner").cost_s.agg(["count", "mean"]).round(1))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "lab"))
