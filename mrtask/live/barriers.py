"""Maps on which some ways are blocked, by a shut door or by a place that no robot gets past."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mrtask.homes.home import Door, Home, Point
from mrtask.maps.distance_fields import distance_fields, soft_fields
from mrtask.maps.home_map import HomeMap

DOORWAY_GAP_M = 0.3
"""Stretches of one doorway are at most this far apart: a robot does not fit between them."""


@dataclass(frozen=True)
class Barrier:
    """Robots' centres cannot be within ``radius_m`` of the lines from ``start`` to ``end`` and those in ``also``."""

    start: Point
    end: Point
    radius_m: float
    also: tuple[tuple[Point, Point], ...] = ()

    def holds(self, points: NDArray[Any]) -> NDArray[np.bool_]:
        """Return whether shapely's ``points`` [N] lie in the barrier."""
        lines = shapely.MultiLineString([(self.start, self.end), *self.also])
        return np.asarray(shapely.dwithin(points, lines, self.radius_m))


def doorways(home: Home) -> dict[str, tuple[Door, ...]]:
    """Return the home's doors by name: stretches between the same rooms that touch are one doorway.

    A doorway of one stretch keeps its id. Others are named by their rooms, and numbered where these share several.
    """
    groups: list[list[Door]] = []
    for door in home.doors:
        near = [group for group in groups if any(_touch(door, one) for one in group)]
        groups = [group for group in groups if group not in near] + [[door, *(one for group in near for one in group)]]
    named: dict[str, tuple[Door, ...]] = {}
    for group in groups:
        first = group[0].id if len(group) == 1 else "|".join(group[0].rooms)
        name = next(name for name in chain([first], (f"{first}|{n}" for n in count(2))) if name not in named)
        named[name] = tuple(group)
    return named


def _touch(one: Door, other: Door) -> bool:
    lines = (shapely.LineString([door.start, door.end]) for door in (one, other))
    return set(one.rooms) == set(other.rooms) and bool(shapely.dwithin(*lines, DOORWAY_GAP_M))


def barred_map(home_map: HomeMap, barriers: Sequence[Barrier]) -> HomeMap:
    """Return the map without the cells in the barriers; a container whose access cell is blocked cannot be reached.

    Unlike a home's own map, the result may have several regions, or none.
    """
    free = home_map.free.copy()
    rows, cols = np.nonzero(free)
    xs = home_map.origin_m[0] + (cols + 0.5) * home_map.resolution_m
    ys = home_map.origin_m[1] + (rows + 0.5) * home_map.resolution_m
    cells = shapely.points(xs, ys)
    for barrier in barriers:
        near = barrier.holds(cells)
        free[rows[near], cols[near]] = False
    access = home_map.access.copy()
    reached = access[:, 0] >= 0
    reached[reached] = free[tuple(access[reached].T)]
    access[~reached] = -1
    if home_map.steps is not None:
        fields_m, steps = soft_fields(free, access, home_map.resolution_m)
        return replace(home_map, free=free, access=access, fields_m=fields_m, steps=steps)
    return replace(home_map, free=free, access=access, fields_m=distance_fields(free, access, home_map.resolution_m))
