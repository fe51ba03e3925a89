"""A robot's knowledge of a home's geometry: free cells, where it reaches each container, and how far everything is.

Distances are kept as one field per container (the path length from every free cell). The distance from *any* cell, such
as where a robot is redirected in mid-path, is therefore a look-up, and the path itself is the field's steepest descent.
Legend for array shapes: C containers, H rows, W columns, L cells of a path.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from shapely.geometry import LineString
from skimage.draw import polygon as cells_inside

from mrtask.arrays import Bools, Floats, Int32s, Ints, UInt8s
from mrtask.homes.home import Home, Point, Polygon
from mrtask.maps.distance_fields import TIE_CELLS, descend, distance_fields, follow, soft_fields
from mrtask.names import counted

DEFAULT_RESOLUTION_M = 0.05
DEFAULT_ROBOT_RADIUS_M = 0.2
REACH_M = 1.0
"""The largest distance from which a container is reached. A robot does not search a bed through a wall or across a
room."""
MAX_CELLS = 16_000_000
CORNER_SEGMENTS = 8
"""Segments per quarter circle when footprints and walls are inflated by the robot's radius."""
DOOR_DEPTH_M = 0.05
"""Doors are carved this far to both sides of the wall's line, to allow for rounding in their positions."""
NO_ROOM = -1
WAYS = ("shortest", "soft")
"""How robots drive: by the shortest ways, or by ways that keep away from walls (`mrtask.maps.distance_fields`)."""


@dataclass(frozen=True, eq=False)
class HomeMap:
    """The map of one home.

    Cell ``(row, col)`` spans y from ``origin_m[1] + row * resolution_m``, and x likewise.
    """

    home_id: str
    resolution_m: float
    origin_m: Point
    """The corner of cell ``(0, 0)``; rows run along y, columns along x."""
    free: Bools
    """[H, W] where the robot's centre may be, in the main connected region only."""
    access: Int32s
    """[C, 2] row and column from which each container is reached; -1, -1 if it cannot be reached."""
    fields_m: NDArray[np.float32]
    """[C, H, W] path length to each container's access cell; inf where a cell is not free or not reachable."""
    steps: UInt8s | None = None
    """[C, H, W] the first step of each soft way (see `follow`), or None for shortest ways."""

    @property
    def reachable(self) -> Bools:
        """Return, for each container [C], whether a robot can get there."""
        return np.asarray(self.access[:, 0] >= 0)

    def out_of_reach(self, home: Home) -> str:
        """Return a sentence that names those of the home's containers that no robot can get to, or an empty text."""
        names = [one.id for one, ok in zip(home.containers, self.reachable, strict=True) if not ok]
        total = counted(len(self.access), "container")
        return f"{len(names)} of {total} cannot be reached by a robot: {', '.join(names)}" if names else ""

    @cached_property
    def travel_m(self) -> Floats:
        """Return the path lengths [C, C] between containers: symmetric, 0 on the diagonal, inf for unreachable ones."""
        count = len(self.access)
        travel_m = np.full((count, count), np.inf)
        known = np.flatnonzero(self.reachable)
        rows, cols = self.access[known].T
        travel_m[np.ix_(known, known)] = self.fields_m[known][:, rows, cols]
        np.fill_diagonal(travel_m, 0.0)
        return np.asarray(np.minimum(travel_m, travel_m.T))

    def distances_m(self, cell: tuple[int, int]) -> Floats:
        """Return the path lengths [C] from a cell to all containers; inf if no way leads there."""
        column: Floats = self.fields_m[:, cell[0], cell[1]].astype(np.float64)
        return column

    def path(self, cell: tuple[int, int], container: int) -> Int32s:
        """Return the cells [L, 2] of the way to a container's access cell, including both ends."""
        if not np.isfinite(self.fields_m[container, cell[0], cell[1]]):
            raise ValueError(f"no way from cell {cell} to container {container}; check `reachable` and `free` first")
        if self.steps is not None:
            return follow(self.steps[container], cell[0], cell[1])
        cells: Int32s = descend(self.fields_m[container], self.resolution_m, cell[0], cell[1])
        return cells

    def cell_center(self, cell: tuple[int, int]) -> Point:
        """Return the middle of a cell in metres."""
        x = self.origin_m[0] + (cell[1] + 0.5) * self.resolution_m
        return (x, self.origin_m[1] + (cell[0] + 0.5) * self.resolution_m)

    def cell_of(self, point: Point) -> tuple[int, int]:
        """Return the cell around a point. It lies outside the grid if the point does."""
        row = int(np.floor((point[1] - self.origin_m[1]) / self.resolution_m))
        return (row, int(np.floor((point[0] - self.origin_m[0]) / self.resolution_m)))


@dataclass(frozen=True)
class _Grid:
    resolution_m: float
    origin_m: Point
    shape: tuple[int, int]

    def indices(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the fractional rows and columns of points ``[N, 2]``; whole numbers are cell centres."""
        cols, rows = (points - np.array(self.origin_m)).T / self.resolution_m - 0.5
        return rows, cols

    def fill(self, target: NDArray[Any], outline: Floats, value: int) -> None:
        """Set the cells whose centres are in the polygon."""
        rows, cols = cells_inside(*self.indices(outline), shape=self.shape)  # type: ignore[no-untyped-call]
        target[rows, cols] = value


def build_map(
    home: Home,
    resolution_m: float = DEFAULT_RESOLUTION_M,
    robot_radius_m: float = DEFAULT_ROBOT_RADIUS_M,
    ways: str = "shortest",
) -> HomeMap:
    """Rasterise a home for a round robot and compute all distance fields.

    A cell is free if its centre is in a room and at least the radius away from walls and furniture. Diagonal steps may
    pass between two blocked cells, because the inflation already accounts for that.
    """
    if not resolution_m > 0 or not robot_radius_m >= 0:
        raise ValueError(
            f"resolution_m > 0 and robot_radius_m >= 0 are needed, not {resolution_m} and {robot_radius_m}"
        )
    if ways not in WAYS:
        raise ValueError(f"ways must be one of {', '.join(WAYS)}, not {ways!r}")
    grid, room_of, open_cells = _rasterise(home, resolution_m, robot_radius_m)
    free = main_region(open_cells)
    room_numbers = {room.id: number for number, room in enumerate(home.rooms)}
    access = np.full((len(home.containers), 2), -1, np.int32)
    for index, container in enumerate(home.containers):
        own_room = room_numbers.get(container.room_id, NO_ROOM)
        access[index] = _access_cell(grid, free, room_of, container.footprint, own_room)
    if ways == "soft":
        return HomeMap(home.id, resolution_m, grid.origin_m, free, access, *soft_fields(free, access, resolution_m))
    fields_m = distance_fields(free, access, resolution_m)
    return HomeMap(home.id, resolution_m, grid.origin_m, free, access, fields_m)


def main_region_share(home: Home, resolution_m: float, robot_radius_m: float) -> float:
    """Return the main region's share of the cells in which a robot fits.

    The share is 0 if it fits in no cell.
    """
    _, _, open_cells = _rasterise(home, resolution_m, robot_radius_m)
    return float(main_region(open_cells).sum() / max(open_cells.sum(), 1))


def _rasterise(home: Home, resolution_m: float, robot_radius_m: float) -> tuple[_Grid, NDArray[np.int16], Bools]:
    """Return the grid, each cell's room, and whether the robot's centre may be there, in any region."""
    grid = _make_grid(home, resolution_m)
    room_of = np.full(grid.shape, NO_ROOM, np.int16)
    for number, room in enumerate(home.rooms):
        grid.fill(room_of, np.array(room.polygon), number)
    open_cells = room_of != NO_ROOM
    for outline in _inflated_obstacles(home, robot_radius_m):
        grid.fill(open_cells, outline, False)
    return grid, room_of, open_cells


def main_region(open_cells: Bools) -> Bools:
    """Return the largest 8-connected region [H, W]; of equally large ones, the first in row order."""
    labels, count = ndimage.label(open_cells, structure=np.ones((3, 3)))
    if count <= 1:
        return open_cells
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray(labels == int(np.argmax(sizes)))


def _make_grid(home: Home, resolution_m: float) -> _Grid:
    points = np.array([point for room in home.rooms for point in room.polygon])
    low, high = points.min(axis=0), points.max(axis=0)
    cols, rows = (np.ceil((high - low) / resolution_m).astype(int) + 2).tolist()
    if rows * cols > MAX_CELLS:
        problem = f"a grid of {rows} x {cols} cells is more than {MAX_CELLS} cells"
        raise ValueError(f"home {home.id}: {problem}; choose a coarser resolution_m")
    return _Grid(resolution_m, (float(low[0] - resolution_m), float(low[1] - resolution_m)), (rows, cols))


def _inflated_obstacles(home: Home, radius_m: float) -> list[Floats]:
    """Return the outlines of footprints and walls, grown by the robot's radius."""
    footprints = [*(c.footprint for c in home.containers), *(o.footprint for o in home.obstacles)]
    solid = np.array([shapely.Polygon(footprint) for footprint in footprints] + _walls(home), dtype=object)
    if radius_m > 0:
        solid = shapely.buffer(solid, radius_m, quad_segs=CORNER_SEGMENTS)
    return [shapely.get_coordinates(shape) for shape in solid if not shape.is_empty]


def _walls(home: Home) -> list[LineString]:
    """Return the straight stretches of the rooms' outlines, without the openings between rooms.

    Outside doors stay shut.
    """
    openings = [
        LineString([door.start, door.end]).buffer(DOOR_DEPTH_M, cap_style="flat")
        for door in home.doors
        if door.rooms[0] != door.rooms[1]
    ]
    sides = [
        LineString([start, end])
        for room in home.rooms
        for start, end in zip(room.polygon, (*room.polygon[1:], room.polygon[0]), strict=True)
        if start != end
    ]
    left = shapely.difference(np.array(sides, dtype=object), shapely.union_all(openings))
    return [part for part in shapely.get_parts(left) if part.length > 0]


def _access_cell(
    grid: _Grid, free: Bools, room_of: NDArray[np.int16], footprint: Polygon, own_room: int
) -> tuple[int, int]:
    """Return the free cell nearest to the footprint, or (-1, -1) if none is within reach.

    A cell in the container's own room takes precedence.
    """
    corners = np.array(footprint)
    rows, cols = grid.indices(corners)
    margin = REACH_M / grid.resolution_m
    top, bottom = max(int(rows.min() - margin), 0), min(int(rows.max() + margin) + 2, grid.shape[0])
    left, right = max(int(cols.min() - margin), 0), min(int(cols.max() + margin) + 2, grid.shape[1])
    window = free[top:bottom, left:right]
    in_own_room = window & (room_of[top:bottom, left:right] == own_room)
    for candidates in (in_own_room, window) if own_room != NO_ROOM else (window,):
        near_rows, near_cols = np.nonzero(candidates)
        if near_rows.size == 0:
            continue
        distance = _distance_to_outline(near_rows + top, near_cols + left, rows, cols)
        # Of equally near cells, take the one in front of the middle of the footprint.
        off_middle = np.hypot(near_rows + top - rows.mean(), near_cols + left - cols.mean())
        best = int(np.argmin(np.where(distance <= distance.min() + TIE_CELLS, off_middle, np.inf)))
        if distance[best] * grid.resolution_m <= REACH_M:
            return int(near_rows[best] + top), int(near_cols[best] + left)
    return -1, -1


def _distance_to_outline(rows: Ints, cols: Ints, outline_rows: Floats, outline_cols: Floats) -> Floats:
    """Return the distance, in cells, from each cell to the polygon's outline.

    Free cells are never inside a footprint.
    """
    best = np.full(rows.shape, np.inf)
    for start_row, start_col, end_row, end_col in zip(
        outline_rows, outline_cols, np.roll(outline_rows, -1), np.roll(outline_cols, -1), strict=True
    ):
        d_row, d_col = end_row - start_row, end_col - start_col
        length_squared = max(d_row * d_row + d_col * d_col, np.finfo(float).tiny)
        along = np.clip(((rows - start_row) * d_row + (cols - start_col) * d_col) / length_squared, 0.0, 1.0)
        gap = (rows - start_row - along * d_row) ** 2 + (cols - start_col - along * d_col) ** 2
        np.minimum(best, gap, out=best)
    return np.asarray(np.sqrt(best))
