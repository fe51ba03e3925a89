"""Compute exact path lengths on an 8-connected grid, one field per goal, by Dijkstra's algorithm with buckets.

Ways of the kind ``shortest`` are the shortest. Ways of the kind ``soft`` have the least cost where cells near walls
cost more, as in the authors' code; the fields still hold their length in metres.

Steps cost 1 or sqrt(2). With buckets as wide as the shortest step, every cell in the current bucket is therefore final
(Dial 1969; Dinitz 1978), and no heap is needed. scikit-image's ``MCP_Geometric`` and scipy's ``csgraph.dijkstra`` give
the same lengths (the tests compare them) but take many times as long; see ``benchmarks/bench_maps.py``.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from mrtask.arrays import Bools, Floats, Int32s, UInt8s
from mrtask.sources import use_kernel_cache

use_kernel_cache()

WALL_MARGIN_M = 0.5
WALL_COST = 5.0
"""The cost of a metre on soft ways right beside a place that a robot cannot enter. It falls to 1 at the margin. (The
authors' ways keep away from walls too; by how much is our choice.)"""
AT_GOAL = 255
"""The mark at the goal, in place of a step's number, in the steps of soft ways."""
DIAGONAL = math.sqrt(2.0)
BUCKETS = 3
"""The buckets are used in turn: from one, steps of 1 and sqrt(2) lead into one of the next two."""
TIE_CELLS = 1e-3
"""Lengths that differ by less than this are equal (the fields have single precision)."""


def distance_fields(free: Bools, goals: Int32s, resolution_m: float) -> NDArray[np.float32]:
    """Return the metres [C, H, W] from every cell to each of ``goals`` [C, 2].

    The value is inf where the cell is blocked or cut off, or the goal is negative.
    """
    rows, cols = free.shape
    padded = np.zeros((rows + 2, cols + 2), np.bool_)
    padded[1:-1, 1:-1] = free
    fields_m = np.empty((len(goals), rows, cols), np.float32)
    _fill_fields(padded, goals.astype(np.int64), resolution_m, fields_m)
    return fields_m


@njit(cache=True)
def _fill_fields(padded, goals, resolution_m, fields_m):  # type: ignore[no-untyped-def]
    """Write the distances from each goal.

    ``padded`` [H + 2, W + 2] has a blocked rim, so that no index needs a check.
    """
    width = padded.shape[1]
    is_free = padded.ravel()
    steps = np.array([1, -1, width, -width, width + 1, width - 1, -width + 1, -width - 1])
    length = np.empty(padded.size, np.float64)
    # A cell enters a bucket at most once per neighbour. Memory that is never touched costs nothing.
    bucket = np.empty((BUCKETS, len(steps) * padded.size), np.int32)
    count = np.zeros(BUCKETS, np.int64)
    for index in range(len(goals)):
        length[:] = np.inf
        if goals[index, 0] >= 0:
            goal = (goals[index, 0] + 1) * width + goals[index, 1] + 1
            length[goal] = 0.0
            bucket[0, 0] = goal
            count[0] = 1
        level = 0
        while count.sum() > 0:
            current = level % BUCKETS
            for entry in range(count[current]):
                cell = bucket[current, entry]
                here = length[cell]
                if here < level:  # since it was put here, a shorter way has reached it
                    continue
                for k in range(len(steps)):
                    other = cell + steps[k]
                    through = here + (1.0 if k < 4 else DIAGONAL)
                    if is_free[other] and through < length[other]:
                        length[other] = through
                        place = int(through) % BUCKETS
                        bucket[place, count[place]] = other
                        count[place] += 1
            count[current] = 0
            level += 1
        for row in range(fields_m.shape[1]):
            for col in range(fields_m.shape[2]):
                fields_m[index, row, col] = length[(row + 1) * width + col + 1] * resolution_m


def soft_fields(free: Bools, goals: Int32s, resolution_m: float) -> tuple[NDArray[np.float32], UInt8s]:
    """Return the metres [C, H, W] along the soft way from every cell to each of ``goals`` [C, 2], and its first step.

    The metres are inf where the cell is blocked or cut off, or the goal is negative. `follow` reads the steps.
    """
    cost = np.full((free.shape[0] + 2, free.shape[1] + 2), np.inf)
    cost[1:-1, 1:-1][free] = soft_cost(free, resolution_m)[free]
    fields_m = np.full((len(goals), *free.shape), np.inf, np.float32)
    steps = np.full(fields_m.shape, AT_GOAL, np.uint8)
    _fill_soft_fields(cost, goals.astype(np.int64), resolution_m, fields_m, steps)
    return fields_m, steps


def soft_cost(free: Bools, resolution_m: float) -> Floats:
    """Return what a metre costs in each cell [H, W], from 1 to `WALL_COST`."""
    clearance_m = ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * resolution_m
    nearness = np.clip(1.0 - (clearance_m - resolution_m) / WALL_MARGIN_M, 0.0, 1.0)
    return np.asarray(1.0 + (WALL_COST - 1.0) * nearness)


@njit(cache=True)
def _fill_soft_fields(cost, goals, resolution_m, fields_m, steps):  # type: ignore[no-untyped-def]
    """Do what `_fill_fields` does, where a step costs the mean of its two cells.

    ``cost`` [H + 2, W + 2] is inf where the cell is blocked.
    """
    width = cost.shape[1]
    cell_cost = cost.ravel()
    moves = np.array([1, -1, width, -width, width + 1, width - 1, -width + 1, -width - 1])
    backwards = np.array([1, 0, 3, 2, 7, 6, 5, 4])
    buckets = int(DIAGONAL * WALL_COST) + 2
    bucket = np.empty((buckets, len(moves) * cost.size), np.int32)
    count = np.zeros(buckets, np.int64)
    total, length = np.empty(cost.size, np.float64), np.empty(cost.size, np.float64)
    step = np.empty(cost.size, np.uint8)
    for index in range(len(goals)):
        if goals[index, 0] < 0:
            continue
        total[:], length[:], step[:] = np.inf, np.inf, AT_GOAL
        goal = (goals[index, 0] + 1) * width + goals[index, 1] + 1
        total[goal], length[goal] = 0.0, 0.0
        bucket[0, 0], count[0] = goal, 1
        level = 0
        while count.sum() > 0:
            current = level % buckets
            for entry in range(count[current]):
                cell = bucket[current, entry]
                if total[cell] < level:
                    continue
                for k in range(len(moves)):
                    other = cell + moves[k]
                    way = 1.0 if k < 4 else DIAGONAL
                    through = total[cell] + way * 0.5 * (cell_cost[cell] + cell_cost[other])
                    if through < total[other]:
                        total[other], length[other], step[other] = through, length[cell] + way, backwards[k]
                        place = int(through) % buckets
                        bucket[place, count[place]] = other
                        count[place] += 1
            count[current] = 0
            level += 1
        for row in range(fields_m.shape[1]):
            for col in range(fields_m.shape[2]):
                cell = (row + 1) * width + col + 1
                fields_m[index, row, col], steps[index, row, col] = length[cell] * resolution_m, step[cell]


def follow(steps: UInt8s, row: int, col: int) -> Int32s:
    """Return the cells [L, 2] of the soft way from ``(row, col)`` to the goal of ``steps`` [H, W]."""
    moves = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
    path = [(row, col)]
    while (number := int(steps[row, col])) != AT_GOAL:
        row, col = row + moves[number][0], col + moves[number][1]
        path.append((row, col))
    return np.array(path, np.int32)


@njit(cache=True)
def descend(field_m, resolution_m, row, col):  # type: ignore[no-untyped-def]
    """Return the cells [L, 2] from ``(row, col)`` down to the field's zero by shortest steps.

    Of equally short steps, the one straight on is taken.
    """
    rows, cols = field_m.shape
    path = [(row, col)]
    last_row_step, last_col_step = 0, 0
    while field_m[row, col] > 0.0:
        best_m, best_row_step, best_col_step = np.inf, 0, 0
        for row_step in range(-1, 2):
            for col_step in range(-1, 2):
                next_row, next_col = row + row_step, col + col_step
                if not (0 <= next_row < rows and 0 <= next_col < cols) or (row_step == 0 and col_step == 0):
                    continue
                cost = DIAGONAL if row_step != 0 and col_step != 0 else 1.0
                length_m = field_m[next_row, next_col] + cost * resolution_m
                if row_step == last_row_step and col_step == last_col_step:
                    length_m -= TIE_CELLS * resolution_m
                if length_m < best_m:
                    best_m, best_row_step, best_col_step = length_m, row_step, col_step
        row, col = row + best_row_step, col + best_col_step
        last_row_step, last_col_step = best_row_step, best_col_step
        path.append((row, col))
    return np.array(path, np.int32)
