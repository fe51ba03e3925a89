"""Exact shortest-path lengths on an 8-connected grid, one field per goal, by Dijkstra's algorithm with buckets.

Steps cost 1 or sqrt(2), so with buckets as wide as the shortest step every cell in the current bucket is final (Dial
1969; Dinitz 1978) and no heap is needed. scikit-image's ``MCP_Geometric`` and scipy's ``csgraph.dijkstra`` give the
same lengths (the tests compare them) but take many times as long; see ``benchmarks/bench_maps.py``.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

DIAGONAL = math.sqrt(2.0)
BUCKETS = 3
"""Used in turn: from one bucket, steps of 1 and sqrt(2) lead into one of the next two."""
TIE_CELLS = 1e-3
"""Lengths that differ by less are equal (the fields are single precision)."""


def distance_fields(free: NDArray[np.bool_], goals: NDArray[np.int32], resolution_m: float) -> NDArray[np.float32]:
    """[C, H, W] metres from every cell to each of ``goals`` [C, 2]; inf where blocked, cut off, or the goal is < 0."""
    rows, cols = free.shape
    padded = np.zeros((rows + 2, cols + 2), np.bool_)
    padded[1:-1, 1:-1] = free
    fields_m = np.empty((len(goals), rows, cols), np.float32)
    _fill_fields(padded, goals.astype(np.int64), resolution_m, fields_m)
    return fields_m


@njit(cache=True)
def _fill_fields(padded, goals, resolution_m, fields_m):  # type: ignore[no-untyped-def]
    """Write the distances from each goal; ``padded`` [H + 2, W + 2] has a blocked rim, so no bounds are checked."""
    width = padded.shape[1]
    is_free = padded.ravel()
    steps = np.array([1, -1, width, -width, width + 1, width - 1, -width + 1, -width - 1])
    length = np.empty(padded.size, np.float64)
    # A cell enters a bucket at most once per neighbour; memory that is never touched costs nothing.
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
                if here < level:  # reached by a shorter way since it was put here
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


@njit(cache=True)
def descend(field_m, resolution_m, row, col):  # type: ignore[no-untyped-def]
    """[L, 2] the cells from ``(row, col)`` down to the field's zero by shortest steps; of equal ones, straight on."""
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
