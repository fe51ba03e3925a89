"""Maps on which some ways are blocked, by a shut door or by a place that no robot gets past."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from mrtask.homes.home import Point
from mrtask.maps.distance_fields import distance_fields, soft_fields
from mrtask.maps.home_map import HomeMap


@dataclass(frozen=True)
class Barrier:
    """Robots' centres cannot be within ``radius_m`` of the line from ``start`` to ``end``."""

    start: Point
    end: Point
    radius_m: float


def barred_map(home_map: HomeMap, barriers: Sequence[Barrier]) -> HomeMap:
    """Return the map without the cells in the barriers; a container whose access cell is blocked cannot be reached.

    Unlike a home's own map, the result may have several regions. If the barriers block everything, the map stays as it
    is: a robot has to be somewhere.
    """
    free = home_map.free.copy()
    rows, cols = np.nonzero(free)
    xs = home_map.origin_m[0] + (cols + 0.5) * home_map.resolution_m
    ys = home_map.origin_m[1] + (rows + 0.5) * home_map.resolution_m
    cells = shapely.points(xs, ys)
    for barrier in barriers:
        near = shapely.dwithin(cells, shapely.LineString([barrier.start, barrier.end]), barrier.radius_m)
        free[rows[near], cols[near]] = False
    if not free.any():
        return home_map
    access = home_map.access.copy()
    reached = access[:, 0] >= 0
    reached[reached] = free[tuple(access[reached].T)]
    access[~reached] = -1
    if home_map.steps is not None:
        fields_m, steps = soft_fields(free, access, home_map.resolution_m)
        return replace(home_map, free=free, access=access, fields_m=fields_m, steps=steps)
    return replace(home_map, free=free, access=access, fields_m=distance_fields(free, access, home_map.resolution_m))
