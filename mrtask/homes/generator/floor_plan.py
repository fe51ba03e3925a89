"""Generate floor plans on a coarse grid: a footprint with cut corners, in which rooms grow towards their area shares.

Source: Lopes et al., *A Constrained Growth Method for Procedural Floor Plan Generation*, GAME-ON 2010, as in ProcTHOR
(Deitke et al. 2022, appendix B): rooms grow as rectangles, then in L-shapes, then fill the remaining cells. Several
plans are drawn and the best is taken. If no plan is sound, the footprint is cut into strips, which always works.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

import networkx as nx
import numpy as np
import shapely
from scipy import ndimage

from mrtask.arrays import Bools, Floats, Ints
from mrtask.homes.catalogue import load_catalogue
from mrtask.homes.home import Point, Polygon, size_class_of

PLANS_DRAWN = 6
CORNER_CUTS = 30
LARGEST_CUT = 2 / 3
"""The largest share of the footprint's height and width that a cut may take."""
SEEDS_WEIGHED = 3
"""The number of cells drawn for each room. It grows from the one furthest from the earlier rooms."""
OUTSIDE, EMPTY = -2, -1
COORDINATE_DECIMALS = 3

Grid = Ints


@dataclass(frozen=True)
class Wall:
    """A straight wall between two rooms, or between a room and the outside (``rooms[1] == OUTSIDE``)."""

    rooms: tuple[int, int]
    start: Point
    end: Point

    @property
    def length_m(self) -> float:
        """Return the metres from start to end."""
        return math.dist(self.start, self.end)


@dataclass(frozen=True)
class FloorPlan:
    """Room outlines in metres, in the order of the requested shares; neighbours share their walls exactly."""

    rooms: tuple[Polygon, ...]
    walls: tuple[Wall, ...]


def make_floor_plan(shares: Sequence[float], area_m2: float, rng: np.random.Generator) -> FloorPlan:
    """Divide a footprint of ``area_m2`` among rooms by their shares of the area (any positive numbers)."""
    weights = np.array(shares, dtype=np.float64)
    weights /= weights.sum()
    footprint = _footprint(len(weights), area_m2, rng)
    best: tuple[float, Grid] | None = None
    for _ in range(PLANS_DRAWN):
        grid = _grow(footprint, weights, rng)
        if (fault := _fault(grid, weights)) is not None and (best is None or fault < best[0]):
            best = (fault, grid)
    grid = best[1] if best is not None else _strips(weights)
    side_m = math.sqrt(area_m2 / int((grid >= 0).sum()))
    rooms = tuple(_outline(grid, room, side_m) for room in range(len(weights)))
    return FloorPlan(rooms, tuple(_walls(grid, side_m)))


def _footprint(rooms: int, area_m2: float, rng: np.random.Generator) -> Grid:
    """Return a grid of `EMPTY` cells, with `OUTSIDE` where rectangles were cut from its corners."""
    facts = load_catalogue().homes["footprints"][size_class_of(area_m2)]
    side_m, fill, aspect = (_draw(facts[name], rng) for name in ("cell_m", "fill", "aspect"))
    boxed = max(area_m2 / side_m**2, 2 * rooms) / fill
    size = _box(boxed, aspect)
    height, width = size if rng.random() < 0.5 else size[::-1]
    wanted = max(round(fill * height * width), rooms)
    grid = np.full((height, width), EMPTY, np.int64)
    for _ in range(CORNER_CUTS):
        spare = int((grid == EMPTY).sum()) - wanted
        if spare <= 0:
            break
        rows = int(rng.integers(1, max(int(height * LARGEST_CUT), 1) + 1))
        cols = int(rng.integers(1, max(int(width * LARGEST_CUT), 1) + 1))
        if rows * cols > spare:
            continue
        cut = grid.copy()
        row_side = slice(0, rows) if rng.random() < 0.5 else slice(height - rows, height)
        col_side = slice(0, cols) if rng.random() < 0.5 else slice(width - cols, width)
        cut[row_side, col_side] = OUTSIDE
        if _is_simple(cut == EMPTY):
            grid = cut
    return grid


def _box(cells: float, aspect: float) -> tuple[int, int]:
    """Return the short and the long side, in whole cells, nearest to a number of cells and an aspect ratio."""
    shorts = range(1, math.isqrt(math.ceil(cells)) + 2)
    sizes = [(short, long) for short in shorts for long in range(max(short, 2), math.ceil(cells / short) + 1)]
    return min(
        sizes, key=lambda size: abs(math.log(math.prod(size) / cells)) + abs(math.log(size[1] / size[0] / aspect))
    )


def _draw(quantiles: Sequence[float], rng: np.random.Generator) -> float:
    """Draw a number from a distribution given by its evenly spaced quantiles."""
    return float(np.interp(rng.random(), np.linspace(0, 1, len(quantiles)), quantiles))


def _grow(grid: Grid, weights: Floats, rng: np.random.Generator) -> Grid:
    """Let rooms take turns, the one furthest below its share first, until no cell is empty."""
    grid = grid.copy()
    target = weights * (grid == EMPTY).sum()
    for room, (row, col) in enumerate(_seeds(grid, len(weights), rng)):
        grid[row, col] = room
    for may_exceed, whole_side in ((False, True), (False, False), (True, False)):
        growing = list(range(len(weights)))
        while growing:
            sizes = np.array([(grid == room).sum() for room in growing])
            pick = int(np.argmin(sizes / target[growing]))
            room = growing[pick]
            strip = _best_strip(grid, room, whole_side, rng)
            if strip is None or (not may_exceed and sizes[pick] + len(strip[0]) > math.ceil(target[room])):
                growing.pop(pick)
            else:
                grid[strip] = room
    return grid


def _seeds(grid: Grid, count: int, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Return one cell for each room to grow from, far from each other."""
    cells = rng.permutation(np.argwhere(grid == EMPTY))
    seeds: list[tuple[int, int]] = []
    for room in range(count):
        drawn = cells[room : room + SEEDS_WEIGHED]
        apart = [min((math.dist(cell, seed) for seed in seeds), default=0.0) for cell in drawn]
        best = room + int(np.argmax(apart))
        cells[[room, best]] = cells[[best, room]]
        seeds.append((int(cells[room, 0]), int(cells[room, 1])))
    return seeds


def _best_strip(grid: Grid, room: int, whole_side: bool, rng: np.random.Generator) -> tuple[Ints, Ints] | None:
    """Return the longest run of empty cells along one side of the room.

    The run covers the whole side or, for L-shapes, a part of it.
    """
    mine = grid == room
    options: list[tuple[float, tuple[Ints, Ints]]] = []
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        edge = np.zeros_like(mine)
        if axis == 0:
            edge[max(step, 0) : len(mine) + min(step, 0)] = mine[max(-step, 0) : len(mine) + min(-step, 0)]
        else:
            edge[:, max(step, 0) : mine.shape[1] + min(step, 0)] = mine[
                :, max(-step, 0) : mine.shape[1] + min(-step, 0)
            ]
        edge &= ~mine
        lines = edge if axis == 0 else edge.T
        empty = (grid == EMPTY) if axis == 0 else (grid == EMPTY).T
        own_length = int(mine.any(axis=0 if axis == 0 else 1).sum())
        for line in np.flatnonzero(lines.any(axis=1)):
            for run in _runs(lines[line] & empty[line]):
                if whole_side and len(run) != own_length:
                    continue
                fixed = np.full(len(run), line)
                options.append((len(run) + 0.5 * rng.random(), (fixed, run) if axis == 0 else (run, fixed)))
    return max(options, key=lambda option: option[0])[1] if options else None


def _runs(flags: Bools) -> list[Ints]:
    places = np.flatnonzero(flags)
    return [] if len(places) == 0 else np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)


def _fault(grid: Grid, weights: Floats) -> float | None:
    """Return how far the plan is from the shares.

    Return None if a room is not a simple polygon or the rooms are not connected.
    """
    if (grid == EMPTY).any():
        return None
    total = (grid >= 0).sum()
    fault = 0.0
    for room, weight in enumerate(weights):
        mine = grid == room
        if not _is_simple(mine):
            return None
        fault += abs(mine.sum() / total - weight) / weight
    graph = nx.Graph(neighbours(grid))
    return fault if len(weights) == 1 or (len(graph) == len(weights) and nx.is_connected(graph)) else None


def neighbours(grid: Grid) -> list[tuple[int, int]]:
    """Return the pairs of rooms that share a wall."""
    pairs = [(grid[:-1], grid[1:]), (grid[:, :-1], grid[:, 1:])]
    flat = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in pairs])
    flat = flat[(flat >= 0).all(axis=1) & (flat[:, 0] != flat[:, 1])]
    return [(int(a), int(b)) for a, b in np.unique(np.sort(flat, axis=1), axis=0)]


def _is_simple(mask: Bools) -> bool:
    """Return whether the cells form one polygon without holes and without points where it touches itself."""
    around = np.pad(mask, 1)
    nw, ne, sw, se = around[:-1, :-1], around[:-1, 1:], around[1:, :-1], around[1:, 1:]
    touches = ((nw & se & ~ne & ~sw) | (ne & sw & ~nw & ~se)).any()
    return not touches and ndimage.label(around)[1] == 1 and ndimage.label(~around)[1] == 1


def _outline(grid: Grid, room: int, side_m: float) -> Polygon:
    """Return the room's corners, clockwise with x to the right and y up, as in ProcTHOR."""
    rows, cols = np.nonzero(grid == room)
    shape = shapely.normalize(shapely.union_all(shapely.box(cols, rows, cols + 1, rows + 1)).simplify(0))
    return tuple(_point(x, y, side_m) for x, y in shapely.get_coordinates(shape)[:-1])


def _point(col: float, row: float, side_m: float) -> Point:
    return (round(float(col) * side_m, COORDINATE_DECIMALS), round(float(row) * side_m, COORDINATE_DECIMALS))


def _walls(grid: Grid, side_m: float) -> Iterator[Wall]:
    """Yield all walls; each is as long as the same two sides meet in a straight line."""
    for upright, cells in ((False, grid), (True, grid.T)):
        padded = np.pad(np.where(cells == EMPTY, OUTSIDE, cells), 1, constant_values=OUTSIDE)
        for line, (before, after) in enumerate(pairwise(padded[:, 1:-1])):
            place = 0
            for sides, run in groupby(zip(before.tolist(), after.tolist(), strict=True)):
                start, place = place, place + len(list(run))
                first, second = max(sides), min(sides)
                if first != second:
                    ends = [(line, at) if upright else (at, line) for at in (start, place)]
                    yield Wall((first, second), *(_point(col, row, side_m) for col, row in ends))


def _strips(weights: Floats) -> Grid:
    """Make each room a strip across the footprint, as wide as its share."""
    cells = np.maximum(np.round(weights * 4 * len(weights)).astype(int), 1)
    return np.tile(np.repeat(np.arange(len(weights)), cells), (max(int(cells.sum()) // 2, 2), 1))
