"""Positions, also between cells, and the routes that robots drive: continuous in space, exact in time.

A robot redirected in mid-path is somewhere on the edge between two neighbouring cells. It continues by the end of that
edge that is nearer to its new target.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrtask.homes.home import Point
from mrtask.maps.home_map import HomeMap

Cell = tuple[int, int]


@dataclass(frozen=True)
class Position:
    """A place ``offset_m`` along the edge of ``length_m`` from cell ``back`` to its neighbour ``ahead``."""

    back: Cell
    ahead: Cell
    offset_m: float = 0.0
    length_m: float = 0.0

    @staticmethod
    def at(cell: Cell) -> "Position":
        """Return the centre of a cell."""
        return Position(cell, cell)

    def point(self, home_map: HomeMap) -> Point:
        """Return the position in metres."""
        (x0, y0), (x1, y1) = home_map.cell_center(self.back), home_map.cell_center(self.ahead)
        share = self.offset_m / self.length_m if self.length_m else 0.0
        return (x0 + share * (x1 - x0), y0 + share * (y1 - y0))

    def distances_m(self, home_map: HomeMap) -> NDArray[np.float64]:
        """Return [C] the path lengths to all containers; inf where unreachable."""
        back = home_map.distances_m(self.back) + self.offset_m
        if self.back == self.ahead:
            return back
        return np.minimum(back, home_map.distances_m(self.ahead) + (self.length_m - self.offset_m))


@dataclass(frozen=True, eq=False)
class Route:
    """A drive from a position to a container's access cell: ``cells`` [L], reached after ``reached_m`` [L] metres."""

    start: Position
    cells: tuple[Cell, ...]
    reached_m: NDArray[np.float64]

    @property
    def length_m(self) -> float:
        """Metres from start to end."""
        return float(self.reached_m[-1])

    def position(self, driven_m: float) -> Position:
        """Return where the robot is after ``driven_m`` metres."""
        after = int(np.searchsorted(self.reached_m, driven_m, side="left"))
        if after >= len(self.cells):
            return Position.at(self.cells[-1])
        cell, left_m = self.cells[after], float(self.reached_m[after]) - driven_m
        if left_m == 0.0:
            return Position.at(cell)
        if after > 0:
            edge_m = float(self.reached_m[after] - self.reached_m[after - 1])
            return Position(self.cells[after - 1], cell, edge_m - left_m, edge_m)
        offset_m = self.start.length_m - left_m if cell == self.start.ahead else left_m
        return Position(self.start.back, self.start.ahead, offset_m, self.start.length_m)

    def points(self, home_map: HomeMap, driven_m: float) -> tuple[Point, ...]:
        """Return the turning points of the first ``driven_m`` metres, ends included."""
        passed = [cell for cell, metres in zip(self.cells, self.reached_m, strict=True) if metres < driven_m]
        line = [self.start.point(home_map), *map(home_map.cell_center, passed)]
        line.append(self.position(driven_m).point(home_map))
        return _turning_points(line)

    def points_after(self, home_map: HomeMap, driven_m: float) -> tuple[Point, ...]:
        """Return the turning points of the rest after ``driven_m`` metres, ends included."""
        ahead = [cell for cell, metres in zip(self.cells, self.reached_m, strict=True) if metres > driven_m]
        return _turning_points([self.position(driven_m).point(home_map), *map(home_map.cell_center, ahead)])


def plan_route(home_map: HomeMap, start: Position, container: int) -> Route:
    """Return the shortest route from a position to a reachable container."""
    ends = [(start.offset_m, start.back), (start.length_m - start.offset_m, start.ahead)]
    lead_m, first = min(ends, key=lambda end: end[0] + home_map.distances_m(end[1])[container])
    cells = [(int(row), int(col)) for row, col in home_map.path(first, container)]
    steps_m = np.hypot(*np.diff(np.array(cells), axis=0).T) * home_map.resolution_m
    return Route(start, tuple(cells), lead_m + np.concatenate([[0.0], np.cumsum(steps_m)]))


def _turning_points(line: list[Point], tolerance_m: float = 1e-9) -> tuple[Point, ...]:
    kept = [line[0]]
    for before, here, after in zip(line, line[1:], line[2:], strict=False):
        cross = (here[0] - before[0]) * (after[1] - here[1]) - (here[1] - before[1]) * (after[0] - here[0])
        if abs(cross) > tolerance_m and here != kept[-1]:
            kept.append(here)
    if line[-1] != kept[-1] or len(kept) == 1:
        kept.append(line[-1])
    return tuple(kept)
