"""Measure CPU seconds per home on one core (generating, map, travel times; median, 99th percentile) and memory.

    python benchmarks/bench_maps.py [--homes 40] [--files homes.jsonl.gz ... --assets asset-database.json]

Figures are by size class. Without files the homes are generated. "map" is the grid and the access cells, "travel times"
the distance fields from all containers; on the first few homes of a class they are compared with two libraries.
"memory" is what a finished map holds, and the largest home's peak while its map is built.
"""

import argparse
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from skimage.graph import MCP_Geometric

from mrtask.homes.generator.house import generate_house
from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.homes.procthor import parse_house, read_houses
from mrtask.maps.distance_fields import distance_fields
from mrtask.maps.home_map import HomeMap, build_map


def seconds(action: Callable[[], object]) -> float:
    began = time.process_time()
    action()
    return time.process_time() - began


def with_scikit_image(home_map: HomeMap) -> None:
    costs = np.where(home_map.free, 1.0, np.inf)
    for row, col in home_map.access[home_map.reachable].tolist():
        MCP_Geometric(costs).find_costs([(row, col)])


def with_scipy(home_map: HomeMap) -> None:
    number = np.full(home_map.free.shape, -1)
    number[home_map.free] = np.arange(home_map.free.sum())
    starts, ends, lengths = [], [], []
    for d_row, d_col in ((0, 1), (1, 0), (1, 1), (1, -1)):
        rows, cols = number.shape
        here = number[: rows - d_row, max(-d_col, 0) : cols - max(d_col, 0)]
        there = number[d_row:, max(d_col, 0) : cols - max(-d_col, 0)]
        both = (here >= 0) & (there >= 0)
        starts.append(here[both])
        ends.append(there[both])
        lengths.append(np.full(both.sum(), np.hypot(d_row, d_col)))
    graph = coo_matrix(
        (np.concatenate(lengths), (np.concatenate(starts), np.concatenate(ends))), shape=(number.max() + 1,) * 2
    )
    goals = number[tuple(home_map.access[home_map.reachable].T)]
    dijkstra(graph.tocsr(), directed=False, indices=goals)


def row(name: str, times: list[float]) -> None:
    median, high, worst = np.percentile(times, [50, 99, 100])
    print(f"  {name:34} median {median:7.4f} s   99 % {high:7.4f} s   worst {worst:7.4f} s")


def time_maps(members: list[Home]) -> dict[str, list[float]]:
    """Return the seconds of each home's map, by part."""
    times: dict[str, list[float]] = {"map": [], "travel times": [], "map and travel times": []}
    for home in members:
        began = time.process_time()
        home_map = build_map(home)
        both = time.process_time() - began
        fields = seconds(lambda home_map=home_map: distance_fields(home_map.free, home_map.access, 0.05))
        for name, value in zip(times, (both - fields, fields, both), strict=True):
            times[name].append(value)
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--homes", type=int, default=40, help="generated homes per size class")
    parser.add_argument("--files", nargs="*", type=Path, default=[])
    parser.add_argument("--assets", type=Path)
    parser.add_argument("--libraries", type=int, default=3, help="homes per class on which libraries are timed")
    arguments = parser.parse_args()
    generating: dict[str, list[float]] = {name: [] for name in SIZE_CLASSES}
    homes: dict[str, list[Home]] = {name: [] for name in SIZE_CLASSES}
    if arguments.files:
        for home in read_houses(arguments.files, arguments.assets):
            homes[home.size_class].append(home)
    else:
        for name in SIZE_CLASSES:
            generate_house(0, name)
            for number in range(arguments.homes):
                generating[name].append(seconds(lambda name=name, number=number: generate_house(number, name)))
                homes[name].append(parse_house(generate_house(number, name), None, "generated", number))
    build_map(next(home for members in homes.values() for home in members))  # compiles
    for name, members in homes.items():
        if not members:
            continue
        maps = [build_map(home) for home in members[: arguments.libraries]]
        area_m2, containers = (
            float(np.mean(values)) for values in zip(*((h.area_m2, len(h.containers)) for h in members), strict=True)
        )
        print(f"{name}: {len(members)} homes, {area_m2:.0f} m2 and {containers:.1f} containers on average")
        if generating[name]:
            row("generate", generating[name])
        for part, times in time_maps(members).items():
            row(part, times)
        row("travel times with scikit-image", [seconds(lambda m=m: with_scikit_image(m)) for m in maps])
        row("travel times with scipy", [seconds(lambda m=m: with_scipy(m)) for m in maps])
        largest = max(members, key=lambda home: home.area_m2 * len(home.containers))
        tracemalloc.start()
        kept = build_map(largest).fields_m.nbytes
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        print(f"  memory: the largest ({largest.area_m2:.0f} m2) holds {kept / 1e6:.1f} MB, peak {peak / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
