"""Put furniture into one room: against walls, in corners or free-standing, so that the free floor stays connected.

The furniture is drawn from the catalogue by room type and area class. For each piece, a fixed number of places is
drawn; a piece that fits none of them is left out, as in ProcTHOR. A coarse raster with a robot larger than the real one
ensures that every door and container stays within reach.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from skimage.draw import polygon as cells_inside

from mrtask.arrays import Floats, Ints
from mrtask.homes.catalogue import CONTAINER_TYPES, Catalogue, Size, is_larger
from mrtask.homes.home import Point, Polygon

RASTER_M = 0.05
CLEARANCE_M = 0.23
"""More than the robot's 0.2 m, so that whatever is passable here is also passable on the map's finer grid."""
ACCESS_M = 0.45
"""The distance from every container's footprint within which some floor stays passable."""
POCKET_SHARE, POCKET_PROB = 0.2, 0.3
"""Most pieces stand where the passable floor stays connected. Some pieces, and those that fit nowhere else, may cut off
pockets of up to this share of it."""
WALL_GAP_M = 0.02
ITEM_GAP_M = 0.08
CHAIR_GAP_M = 0.01
DOOR_DEPTH_M, DOOR_SIDE_M = 0.75, 0.3
"""The size of the floor in front of a door and beside it that stays empty."""
ASSETS_TRIED = 10
PLACES_DRAWN = 80
PLACES_CHECKED = 10
"""The number of fitting places for which it is checked what they would cut off."""
ORDER_NOISE = 0.4
CHAIR_TURN_DEG = 30.0
SEAT_OVERLAP = (0.15, 0.35)
"""How far a chair is pushed under its table, as a share of the chair's depth."""
TURNED_FREELY = frozenset({"FloorLamp", "HousePlant"})
DECIMALS = 4

Cells = tuple[Ints, Ints]
Segment = tuple[Point, Point]


@dataclass(frozen=True)
class Piece:
    """A placed piece of furniture; ``rotation_deg`` follows Unity (clockwise seen from above, 0 faces +y)."""

    type: str
    asset_id: str
    size_m: Size
    center: Point
    rotation_deg: float


@dataclass(frozen=True)
class _Places:
    """The candidate places of one piece: centres [N, 2] and rotations [N] in degrees."""

    centers: Floats
    rotations_deg: Floats

    def shapes(self, size_m: Size) -> NDArray[np.object_]:
        """Return the footprints [N] of a box of this size."""
        turn = np.radians(self.rotations_deg)[:, None]
        half_x, half_z = size_m.x / 2, size_m.z / 2
        a, b = np.array([-half_x, half_x, half_x, -half_x]), np.array([-half_z, -half_z, half_z, half_z])
        offsets = np.stack([a * np.cos(turn) + b * np.sin(turn), -a * np.sin(turn) + b * np.cos(turn)], axis=2)
        return np.asarray(shapely.polygons(self.centers[:, None, :] + offsets))


class _Floor:
    """A room's floor while the room is being furnished."""

    def __init__(self, outline: Polygon, doors: Iterable[Segment]) -> None:
        self.shape = shapely.Polygon(outline)
        self.outline = outline
        low_x, low_y, high_x, high_y = self.shape.bounds
        self._origin = np.array([low_x, low_y])
        rows, cols = math.ceil((high_y - low_y) / RASTER_M), math.ceil((high_x - low_x) / RASTER_M)
        self._passable = np.zeros((rows, cols), np.bool_)
        self._passable[self._cells(self.shape)] = True
        door_lines = [shapely.LineString(door) for door in doors]
        walls = self.shape.exterior.difference(shapely.union_all([line.buffer(RASTER_M) for line in door_lines]))
        for wall in shapely.get_parts(walls):
            for start, end in zip(wall.coords, wall.coords[1:], strict=False):
                self._passable[self._cells(shapely.LineString([start, end]).buffer(CLEARANCE_M))] = False
        self._zones = [_widen(line, DOOR_SIDE_M).buffer(DOOR_DEPTH_M, cap_style="flat") for line in door_lines]
        # Each door, and the surroundings of each container, must keep a cell of the main region.
        self._must_reach = [cells for zone in self._zones if len((cells := self._cells(zone))[0])]
        self._placed: list[shapely.Polygon] = []
        self._cut_off = 0

    def _cells(self, shape: shapely.Polygon) -> Cells:
        cols, rows = ((shapely.get_coordinates(shape) - self._origin) / RASTER_M - 0.5).T
        cells: Cells = cells_inside(rows, cols, shape=self._passable.shape)  # type: ignore[no-untyped-call]
        return cells

    def fitting(self, shapes: NDArray[np.object_], table: shapely.Polygon | None = None) -> Ints:
        """Return the indices of the shapes that lie in the room, away from doors and furniture.

        Chairs may be under ``table``.
        """
        fits = shapely.covers(self.shape, shapes)
        for zone in self._zones:
            fits &= ~shapely.intersects(zone, shapes)
        for other in self._placed:
            if other is not table:
                fits &= ~shapely.dwithin(other, shapes, CHAIR_GAP_M if table is not None else ITEM_GAP_M)
        return np.flatnonzero(fits)

    def add(self, shape: shapely.Polygon, is_container: bool, pocket_share: float) -> bool:
        """Place the shape unless it would cut off too much, and return whether it was placed.

        It may not cut off a door, a container, or more floor than both this share and the floor that was cut off
        before.
        """
        passable = self._passable.copy()
        passable[self._cells(shape.buffer(CLEARANCE_M, quad_segs=2))] = False
        rim = self._cells(shape.buffer(ACCESS_M, quad_segs=2))
        must_reach = [*self._must_reach, rim] if is_container else self._must_reach
        labels, count = ndimage.label(passable)
        if count == 0:
            return False
        sizes = np.bincount(labels.ravel())[1:]
        main = int(np.argmax(sizes)) + 1
        cut_off = int(sizes.sum() - sizes[main - 1])
        if cut_off > max(pocket_share * sizes.sum(), self._cut_off):
            return False
        if not all((labels[cells] == main).any() for cells in must_reach):
            return False
        self._passable, self._must_reach, self._cut_off = passable, must_reach, cut_off
        self._placed.append(shape)
        return True


def _widen(line: shapely.LineString, by_m: float) -> shapely.LineString:
    """Return the segment, longer by ``by_m`` at both ends."""
    start, end = shapely.get_coordinates(line)
    step = (end - start) / line.length * by_m
    return shapely.LineString([start - step, end + step])


def furnish_room(
    room_type: str, outline: Polygon, doors: Iterable[Segment], catalogue: Catalogue, rng: np.random.Generator
) -> list[Piece]:
    """Furnish a room whose outline runs clockwise; ``doors`` are the openings in its walls."""
    facts = catalogue.rooms[room_type]
    floor = _Floor(outline, doors)
    area_class = int(np.searchsorted(facts["area_classes_m2"], floor.shape.area, side="right"))
    larger = is_larger(floor.shape.area, facts["area_classes_m2"])
    wanted = [
        kind for kind, per_class in facts["furniture"].items() for _ in range(_draw_count(per_class[area_class], rng))
    ]
    bulk = [math.prod(catalogue.types[kind]["size_m"][::2]) for kind in wanted]
    order = np.argsort(-np.array(bulk) * np.exp(ORDER_NOISE * rng.standard_normal(len(wanted))), kind="stable")
    pieces: list[Piece] = []
    for kind in (wanted[index] for index in order):
        where = rng.random()
        may_cut_off = rng.random() < POCKET_PROB
        for attempt in range(ASSETS_TRIED):
            asset_id, size_m = _draw_asset(catalogue, kind, rng)
            if attempt >= ASSETS_TRIED / 2:
                where, may_cut_off = rng.random(), True
            in_corner, back_at_wall = (catalogue.types[kind][name][larger] for name in ("in_corner", "back_at_wall"))
            corner, wall = where < in_corner, where < back_at_wall
            places = _draw_places(floor, kind, size_m, wall, corner, rng)
            if (placed := _place(floor, kind, asset_id, size_m, places, may_cut_off)) is not None:
                break
        else:
            continue
        pieces.append(placed[0])
        if kind in facts["chairs_at"]:
            chairs = _draw_count(facts["chairs_at"][kind][area_class], rng)
            pieces += _place_chairs(floor, catalogue, *placed, chairs, may_cut_off, rng)
    return pieces


def _draw_count(shares: Sequence[float], rng: np.random.Generator) -> int:
    return int(np.searchsorted(np.cumsum(shares), rng.random() * sum(shares), side="right"))


def _draw_asset(catalogue: Catalogue, kind: str, rng: np.random.Generator) -> tuple[str, Size]:
    names = list(catalogue.types[kind]["assets"])
    asset_id = names[int(rng.integers(len(names)))]
    return asset_id, catalogue.assets[asset_id].size_m


def _draw_places(floor: _Floor, kind: str, size_m: Size, wall: bool, corner: bool, rng: np.random.Generator) -> _Places:
    """Draw places in corners, along walls or on the open floor. Pieces have their backs to the wall."""
    corners = np.array(floor.outline)
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*sides.T)
    along = sides / lengths[:, None]
    inward = np.stack([along[:, 1], -along[:, 0]], axis=1)
    room_along = np.maximum(lengths - size_m.x - 2 * WALL_GAP_M, 0.0)
    low_x, low_y, high_x, high_y = floor.shape.bounds
    if not wall or not room_along.any():
        centers = rng.uniform((low_x, low_y), (high_x, high_y), size=(PLACES_DRAWN, 2))
        turns = rng.uniform(0, 360, PLACES_DRAWN)
        if kind not in TURNED_FREELY:
            turns = np.floor(turns / 90) * 90
        return _Places(centers, turns)
    side = rng.choice(len(lengths), size=PLACES_DRAWN, p=room_along / room_along.sum())
    share = rng.integers(2, size=PLACES_DRAWN) if corner else rng.random(PLACES_DRAWN)
    distance = WALL_GAP_M + size_m.x / 2 + share * room_along[side]
    off_wall = inward[side] * (WALL_GAP_M + size_m.z / 2)
    centers = corners[side] + along[side] * distance[:, None] + off_wall
    return _Places(centers, np.degrees(np.arctan2(inward[side, 0], inward[side, 1])) % 360)


def _place(
    floor: _Floor,
    kind: str,
    asset_id: str,
    size_m: Size,
    places: _Places,
    may_cut_off: bool,
    table: shapely.Polygon | None = None,
) -> tuple[Piece, shapely.Polygon] | None:
    """Put the piece at the first suitable place, or return None if no place is suitable."""
    places = _Places(np.round(places.centers, DECIMALS), np.round(places.rotations_deg, DECIMALS))
    shapes = places.shapes(size_m)
    candidates = floor.fitting(shapes, table)[:PLACES_CHECKED]
    for index in candidates:
        if floor.add(shapes[index], kind in CONTAINER_TYPES, POCKET_SHARE if may_cut_off else 0.0):
            x, y = places.centers[index]
            piece = Piece(kind, asset_id, size_m, (float(x), float(y)), float(places.rotations_deg[index]))
            return piece, shapes[index]
    return None


def _place_chairs(
    floor: _Floor,
    catalogue: Catalogue,
    table: Piece,
    table_shape: shapely.Polygon,
    count: int,
    may_cut_off: bool,
    rng: np.random.Generator,
) -> list[Piece]:
    """Place chairs of one kind around a table, facing it and pushed under it a little."""
    asset_id, size_m = _draw_asset(catalogue, "Chair", rng)
    corners = shapely.get_coordinates(table_shape)[:4]
    sides = np.roll(corners, -1, axis=0) - corners
    chairs: list[Piece] = []
    for _ in range(count):
        side = rng.integers(4, size=PLACES_DRAWN)
        along = sides[side]
        outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
        push = rng.uniform(*SEAT_OVERLAP, PLACES_DRAWN)
        centers = corners[side] + along * rng.uniform(0.15, 0.85, PLACES_DRAWN)[:, None]
        centers += outward * (size_m.z * (0.5 - push))[:, None]
        turns = np.degrees(np.arctan2(-outward[:, 0], -outward[:, 1]))
        turns = (turns + rng.uniform(-CHAIR_TURN_DEG, CHAIR_TURN_DEG, PLACES_DRAWN)) % 360
        if chairs:  # the places furthest from the earlier chairs come first
            others = np.array([chair.center for chair in chairs])
            order = np.argsort(-np.hypot(*(centers[:, None] - others).transpose(2, 0, 1)).min(axis=1))
            centers, turns = centers[order], turns[order]
        placed = _place(floor, "Chair", asset_id, size_m, _Places(centers, turns), may_cut_off, table_shape)
        if placed is not None:
            chairs.append(placed[0])
    return chairs
