"""Slow twins of the map kernels, straight from the definitions."""

import heapq
import math

import numpy as np


def dijkstra(free, goal):
    """Path lengths in cells from every cell to the goal, with a heap."""
    length = np.full(free.shape, np.inf)
    length[goal] = 0.0
    heap = [(0.0, goal)]
    while heap:
        here, (row, col) = heapq.heappop(heap)
        if here > length[row, col]:
            continue
        for d_row in (-1, 0, 1):
            for d_col in (-1, 0, 1):
                other = (row + d_row, col + d_col)
                inside = 0 <= other[0] < free.shape[0] and 0 <= other[1] < free.shape[1]
                if inside and free[other] and here + math.hypot(d_row, d_col) < length[other]:
                    length[other] = here + math.hypot(d_row, d_col)
                    heapq.heappush(heap, (length[other], other))
    return length


def path_length_m(cells, resolution_m):
    """Summed length of a path of neighbouring cells."""
    steps = np.diff(np.asarray(cells), axis=0)
    assert np.abs(steps).max(initial=0) <= 1
    return float(np.hypot(*steps.T).sum() * resolution_m)
