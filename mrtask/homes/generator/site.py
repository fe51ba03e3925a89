"""Join houses to one site: flats on both sides of a corridor, floor by floor, all reached from the lift lobbies.

A house stays as it is: it is turned by quarter turns until its entrance faces the corridor, and its ids get the number
of its flat (``Bed|2|0`` of flat 3 becomes ``Bed|3.2|0``). Where an entrance lies back from the corridor, the corridor
gets a niche in front of it. A map has one plane, so the floors lie side by side, and robots drive from one lift lobby
into the next.
"""

import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import shapely

from mrtask.errors import InputError
from mrtask.homes.generator.house import (
    DOOR_HEIGHT_M,
    DOOR_MARGIN_M,
    SCHEMA,
    WALL_HEIGHT_M,
    House,
    floor_point,
)
from mrtask.homes.generator.residence_size import flats_on_a_side, floors_of
from mrtask.homes.home import CORRIDOR, LIFT_LOBBY, Home, Point, Polygon
from mrtask.homes.procthor import MAX_EXTENT_M
from mrtask.names import counted

CORRIDOR_WIDTH_M = 2.4
LOBBY_WIDTH_M = 3.0
PARTY_WALL_M = 0.2
"""The gap between neighbouring flats."""
PASSAGE, PASSAGE_WIDTH_M = "Doorframe_Double_1", 1.965
DOOR, DOOR_WIDTH_M = "Doorway_1", 1.038
NICHE_SIDE_M = 0.3
"""The length of wall beside an entrance that a niche takes in, where there is as much."""
STEP_M = 0.25
"""The distance between the places that are tried for an entrance where no outside door can be used."""
CLEAR_DEPTH_M = 0.75
"""The depth of the floor behind a new entrance that furniture must leave free."""
OVERLAP_M2 = 1e-3
ON_WALL_M = 0.05
STRAIGHT_ON = 0.9
"""An entrance faces the corridor if its width, seen from there, is at least this share of its length."""
DECIMALS = 6
TURNS = 4
_ROOM_NUMBER = re.compile(r"(^|\|)(\d[\d.]*)(?=\||$)")

Segment = tuple[Point, Point]
Furnish = Callable[[str, str, Polygon, Sequence[Segment]], list[dict[str, Any]]]
"""Makes the objects of a common room from its name in ids, its type, its clockwise outline and its openings."""


@dataclass(frozen=True)
class CommonRoom:
    """A room off the lift lobby of each floor, ``width_m`` away from the lobby and ``length_m`` along it."""

    name: str
    """What ids call it, before the number of the floor."""
    type: str
    width_m: float
    length_m: float


@dataclass(frozen=True)
class Flat:
    """A house with the way into it, in the house's own coordinates."""

    house: House
    bounds_m: tuple[float, float, float, float]
    """Least x and y, greatest x and y."""
    turns: int
    """How many quarter turns anticlockwise make the entrance face towards smaller y."""
    door: int
    """The entrance's number among the house's doors; it leads outside."""
    niche: Polygon
    """The floor in front of the entrance, as far as into the corridor."""

    @property
    def size_m(self) -> tuple[float, float]:
        """Return the width along the corridor and the depth."""
        x0, y0, x1, y1 = self.bounds_m
        return (x1 - x0, y1 - y0) if self.turns % 2 == 0 else (y1 - y0, x1 - x0)


@dataclass(frozen=True)
class _Move:
    """A turn by quarters, anticlockwise, then a shift in metres."""

    turns: int
    shift_m: Point = (0.0, 0.0)

    def point(self, point: Point) -> Point:
        x, y = point
        for _ in range(self.turns):
            x, y = -y, x
        # Adding zero turns -0.0 into 0.0, so that equal places have equal texts.
        return (round(x + self.shift_m[0], DECIMALS) + 0.0, round(y + self.shift_m[1], DECIMALS) + 0.0)

    def points(self, points: Iterable[Point]) -> Polygon:
        return tuple(self.point(point) for point in points)

    def vector(self, vector: Mapping[str, float]) -> dict[str, float]:
        x, y = self.point((vector["x"], vector["z"]))
        return {**vector, "x": x, "z": y}


def make_flat(house: House, home: Home) -> Flat | None:
    """Return a house as a flat, or None if there is no room for an entrance; ``home`` is the house as it was read.

    The entrance is an outside door from which the way out is clear, or else a new door in an outer wall with no
    furniture behind it. Of several, the one that lies least far back is taken.
    """
    outside = [
        (room_id, (door.start, door.end), number)
        for number, door in enumerate(home.doors)
        if number < len(house["doors"])
        for room_id in door.rooms[:1]
        if door.rooms[0] == door.rooms[1]
    ]
    found = _nearest_way_out(home, outside)
    if found is None:
        footprints = [one.footprint for one in home.containers] + [one.footprint for one in home.obstacles]
        furniture = shapely.union_all([shapely.Polygon(footprint) for footprint in footprints])
        new = [(room_id, opening, -1) for room_id, opening in _places_on_walls(home)]
        found = _nearest_way_out(home, new, furniture)
    if found is None:
        return None
    turns, (room_id, opening, number), niche = found
    if number < 0:
        number = len(house["doors"])
        house = {**house, "doors": [*house["doors"], _new_entrance(room_id, opening)]}
    points = np.array([point for room in home.rooms for point in room.polygon])
    (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return Flat(house, (x0, y0, x1, y1), turns, number, niche)


_Opening = tuple[str, Segment, int]
"""A room's id, where the opening is, and the number of its door, or -1."""


def _nearest_way_out(
    home: Home, openings: Sequence[_Opening], furniture: shapely.Geometry | None = None
) -> tuple[int, _Opening, Polygon] | None:
    """Return the turn, the opening and its niche that lie least far back; None if all ways are barred.

    With ``furniture``, the floor behind the opening must be free of it.
    """
    best: tuple[float, int, _Opening, Polygon] | None = None
    outlines = {room.id: room.polygon for room in home.rooms}
    for turns in range(TURNS):
        there, back = _Move(turns), _Move(-turns % TURNS)
        rooms = {room_id: there.points(outline) for room_id, outline in outlines.items()}
        floor = shapely.union_all([shapely.Polygon(outline) for outline in rooms.values()])
        in_the_way = None if furniture is None else shapely.transform(furniture, _turning(turns))
        edge_m = floor.bounds[1]
        for opening in openings:
            start, end = sorted(there.points(opening[1]))
            back_m = max(start[1], end[1]) - edge_m
            if (best is not None and back_m >= best[0]) or end[0] - start[0] < STRAIGHT_ON * math.dist(start, end):
                continue
            left, right = _widened(start, end, rooms[opening[0]])
            niche = (left, right, (right[0], edge_m - CORRIDOR_WIDTH_M / 2), (left[0], edge_m - CORRIDOR_WIDTH_M / 2))
            if floor.intersection(shapely.Polygon(niche)).area > OVERLAP_M2:
                continue
            if in_the_way is not None:
                behind = [start, end, (end[0], end[1] + CLEAR_DEPTH_M), (start[0], start[1] + CLEAR_DEPTH_M)]
                if in_the_way.intersects(shapely.Polygon(behind)):
                    continue
            best = back_m, turns, opening, back.points(niche)
    return best[1:] if best is not None else None


def _turning(turns: int) -> Callable[[Any], Any]:
    return lambda points: np.array([_Move(turns).point((x, y)) for x, y in points]).reshape(-1, 2)


def _widened(start: Point, end: Point, outline: Polygon) -> Segment:
    """Return the opening with some of the wall beside it, as far as the wall goes on straight."""
    for first, last in _edges(outline):
        wall = shapely.LineString([first, last])
        low, high = sorted((wall.project(shapely.Point(start)), wall.project(shapely.Point(end))))
        if max(wall.distance(shapely.Point(start)), wall.distance(shapely.Point(end))) > ON_WALL_M:
            continue
        if high - low < math.dist(start, end) - ON_WALL_M:
            continue
        ends = (wall.interpolate(max(low - NICHE_SIDE_M, 0.0)), wall.interpolate(min(high + NICHE_SIDE_M, wall.length)))
        left, right = sorted((round(point.x, DECIMALS), round(point.y, DECIMALS)) for point in ends)
        return left, right
    return start, end


def _edges(outline: Polygon) -> Iterator[Segment]:
    return zip(outline, (*outline[1:], outline[0]), strict=True)


def _places_on_walls(home: Home) -> Iterator[tuple[str, Segment]]:
    for room in home.rooms:
        for start, end in _edges(room.polygon):
            length_m = math.dist(start, end)
            for low_m in np.arange(DOOR_MARGIN_M, length_m - DOOR_WIDTH_M - DOOR_MARGIN_M, STEP_M).tolist():
                yield room.id, (_along(start, end, low_m), _along(start, end, low_m + DOOR_WIDTH_M))


def _along(start: Point, end: Point, distance_m: float) -> Point:
    share = distance_m / math.dist(start, end)
    x, y = (round(a + share * (b - a), DECIMALS) for a, b in zip(start, end, strict=True))
    return x, y


def _new_entrance(room_id: str, opening: Segment) -> dict[str, Any]:
    wall = "|".join(["wall", room_id.rpartition("|")[2], *(str(value) for point in opening for value in point)])
    return {"id": "door|entrance", "room0": room_id, "room1": room_id, "wall0": wall, **_hole(0.0, DOOR_WIDTH_M, DOOR)}


def _hole(low_m: float, high_m: float, asset_id: str) -> dict[str, Any]:
    """Return the part of a door's JSON that says where on its wall it is."""
    return {
        "assetId": asset_id,
        "assetPosition": {"x": round((low_m + high_m) / 2, DECIMALS), "y": DOOR_HEIGHT_M / 2, "z": 0},
        "holePolygon": [{"x": low_m, "y": 0, "z": 0}, {"x": high_m, "y": DOOR_HEIGHT_M, "z": 0}],
        "openable": True,
        "openness": 1,
    }


def id_in_flat(name: str, flat: int) -> str:
    """Return an id of a house as it is in a site: ``Bed|2|0`` is ``Bed|3.2|0`` in flat 3."""
    renamed, found = _ROOM_NUMBER.subn(rf"\g<1>{flat}.\g<2>", name, count=1)
    return renamed if found else f"{name}|{flat}"


def _moved(house: House, flat: int, move: _Move) -> House:
    """Return the house's rooms, walls, doors, windows and objects at their place in the site, with ids of the flat."""

    def wall_id(name: str) -> str:
        head, *tail = name.rsplit("|", 4)
        try:
            x0, y0, x1, y1 = map(float, tail)
        except ValueError:
            return id_in_flat(name, flat)
        ends = move.points([(x0, y0), (x1, y1)])
        return "|".join([id_in_flat(head, flat), *(f"{value:.3f}" for point in ends for value in point)])

    def opening(one: Mapping[str, Any]) -> dict[str, Any]:
        rooms = {key: id_in_flat(one[key], flat) for key in ("room0", "room1") if key in one}
        walls = {key: wall_id(one[key]) for key in ("wall0", "wall1") if key in one}
        return {**one, "id": id_in_flat(one["id"], flat), **rooms, **walls}

    def thing(one: Mapping[str, Any]) -> dict[str, Any]:
        placed = {**one, "id": id_in_flat(one["id"], flat)}
        if "position" in one:
            placed["position"] = move.vector(one["position"])
        if "rotation" in one:
            placed["rotation"] = {**one["rotation"], "y": (one["rotation"]["y"] - 90 * move.turns) % 360}
        if "children" in one:
            placed["children"] = [thing(child) for child in one["children"]]
        return placed

    return {
        "rooms": [
            {
                **room,
                "id": id_in_flat(room["id"], flat),
                "floorPolygon": [move.vector(one) for one in room["floorPolygon"]],
            }
            for room in house["rooms"]
        ],
        "walls": [
            {
                **wall,
                "id": wall_id(wall["id"]),
                "roomId": id_in_flat(wall.get("roomId", ""), flat),
                "polygon": [move.vector(one) for one in wall["polygon"]],
            }
            for wall in house.get("walls", [])
        ],
        "doors": [opening(door) for door in house["doors"]],
        "windows": [opening(window) for window in house.get("windows", [])],
        "objects": [thing(one) for one in house["objects"]],
    }


class _Site:
    """The house JSON of a site while it grows."""

    def __init__(self) -> None:
        self.parts: dict[str, list[dict[str, Any]]] = {
            name: [] for name in ("rooms", "doors", "windows", "walls", "objects")
        }
        self.outlines: dict[str, Polygon] = {}
        self.types: dict[str, str] = {}
        self.openings: dict[str, list[Segment]] = defaultdict(list)

    def add_room(self, name: str, kind: str, outline: Polygon) -> None:
        """Add a common room with a clockwise outline, and its walls."""
        self.outlines[name], self.types[name] = outline, kind
        self.parts["rooms"].append(
            {
                "id": f"room|{name}",
                "roomType": kind,
                "floorPolygon": [floor_point(point) for point in outline],
                "children": [],
                "ceilings": [],
            }
        )
        for ends in _edges(outline):
            corners = [floor_point(point, height_m) for height_m in (0.0, WALL_HEIGHT_M) for point in ends]
            self.parts["walls"].append({"id": _wall_id(name, ends), "roomId": f"room|{name}", "polygon": corners})

    def add_door(self, first: str, second: str, opening: Segment, asset_id: str) -> None:
        """Join two common rooms."""
        walls = {name: self._wall(name, opening) for name in (first, second)}
        start = walls[first][0]
        low_m, high_m = sorted(round(math.dist(start, point), DECIMALS) for point in opening)
        self.parts["doors"].append(
            {
                "id": f"door|{first}|{second}",
                "room0": f"room|{first}",
                "room1": f"room|{second}",
                "wall0": _wall_id(first, walls[first]),
                "wall1": _wall_id(second, walls[second]),
                **_hole(low_m, high_m, asset_id),
            }
        )
        for name in (first, second):
            self.openings[name].append(opening)

    def add_flat(self, flat: Flat, number: int, move: _Move, corridor: str) -> None:
        """Put a flat in its place and lead its entrance to the corridor."""
        house = _moved(flat.house, number, move)
        opened = {"openable": True, "openness": 1}
        house["doors"][flat.door] |= {"room1": f"room|{corridor}", **opened}
        for name, parts in house.items():
            self.parts[name] += parts

    def _wall(self, name: str, opening: Segment) -> Segment:
        middle = shapely.LineString(opening).centroid
        return min(_edges(self.outlines[name]), key=lambda ends: shapely.LineString(ends).distance(middle))


def _wall_id(name: str, ends: Segment) -> str:
    return "|".join(["wall", name, *(f"{value:.3f}" for point in ends for value in point)])


def join_flats(
    flats: Sequence[Flat], flats_per_side: int, common: Sequence[CommonRoom] = (), furnish: Furnish | None = None
) -> House:
    """Return a house JSON of all flats, on as few floors as hold them, with the common rooms on every floor.

    The floors hold about equally many flats, at most ``flats_per_side`` on each side of the corridor.
    ``furnish`` makes what stands in the lift lobbies and the common rooms; without it they are empty. The site may be
    wider than homes may be that are read, see `extent_m`.
    """
    if flats_per_side < 1 or not flats:
        raise ValueError(f"a site needs flats, at least one on a side; got {len(flats)} and {flats_per_side}")
    site, base_m = _Site(), 0.0
    floors = floors_of(len(flats), flats_per_side)
    ends = [len(flats) * floor // floors for floor in range(floors + 1)]
    for floor, (first, end) in enumerate(pairwise(ends), start=1):
        top_m = _add_floor(site, floor, first, flats[first:end], base_m, common)
        if floor > 1:
            low_m = -(LOBBY_WIDTH_M + PASSAGE_WIDTH_M) / 2
            lift = ((low_m, base_m), (round(low_m + PASSAGE_WIDTH_M, DECIMALS), base_m))
            site.add_door(f"lobby{floor - 1}", f"lobby{floor}", lift, PASSAGE)
        base_m = top_m
    for name, kind in site.types.items():
        if furnish is not None and kind != CORRIDOR:
            site.parts["objects"] += furnish(name, kind, site.outlines[name], site.openings[name])
    return {
        **site.parts,
        "proceduralParameters": {"lights": [], "reflections": [], "skyboxId": "Sky1"},
        "metadata": {"schema": SCHEMA, "roomSpecId": f"site-of-{len(flats)}"},
    }


def join_homes(houses: Sequence[tuple[House, Home]], flats_per_side: int | None = None) -> House:
    """Return a site of homes in the order given, each with the JSON that it was read from.

    By default, as many lie on each side of a corridor as make the site about square.

    Raises:
        InputError: a home has no room for an entrance, or the site would be wider than a home may be.
    """
    flats: list[Flat] = []
    for house, home in houses:
        if (flat := make_flat(house, home)) is None:
            raise InputError(
                f"{home.source}: home {len(flats) + 1} of {len(houses)} cannot be joined: it has no outside door with "
                f"a clear way out, and no outer wall with {DOOR_WIDTH_M:.1f} m free of furniture; add an outside door"
            )
        flats.append(flat)
    most_a_side = flats_per_side or flats_on_a_side(len(flats))
    site = join_flats(flats, most_a_side)
    width_m, depth_m = extent_m(site)
    if max(width_m, depth_m) > MAX_EXTENT_M:
        raise InputError(
            f"the site of {counted(len(flats), 'home')}, with up to {most_a_side} on a side of each corridor, measures "
            f"{width_m:.0f} m x {depth_m:.0f} m, and {MAX_EXTENT_M:.0f} m are allowed; give fewer homes, or "
            f"{'fewer' if width_m > depth_m else 'more'} on a side"
        )
    return site


def _add_floor(
    site: _Site, floor: int, before: int, flats: Sequence[Flat], base_m: float, common: Sequence[CommonRoom]
) -> float:
    """Add a floor that begins at y = ``base_m``, after ``before`` flats, and return where it ends.

    The flats take turns above and below the corridor.
    """
    above, below = flats[0::2], flats[1::2]
    low_m = round(base_m + max((flat.size_m[1] for flat in below), default=0.0), DECIMALS)
    high_m = round(low_m + CORRIDOR_WIDTH_M, DECIMALS)
    needed_m = sum(room.length_m for room in common)
    top_m = round(max(high_m + max(flat.size_m[1] for flat in above), base_m + needed_m), DECIMALS)
    corridor, lobby = f"corridor{floor}", f"lobby{floor}"
    niches, ends_m = [], []
    for side, members in enumerate((above, below)):
        at_m = 0.0
        for place, flat in enumerate(members):
            at_m += PARTY_WALL_M
            move = _place(flat, at_m, high_m if side == 0 else low_m, upside_down=side == 1)
            site.add_flat(flat, before + 2 * place + side + 1, move, corridor)
            niches.append(shapely.Polygon(move.points(flat.niche)))
            at_m += flat.size_m[0]
        ends_m.append(at_m)
    site.add_room(
        corridor, CORRIDOR, _clockwise(shapely.union_all([shapely.box(0, low_m, max(ends_m), high_m), *niches]))
    )
    site.add_room(lobby, LIFT_LOBBY, _box(-LOBBY_WIDTH_M, base_m, 0.0, top_m))
    middle_m = (low_m + high_m) / 2
    site.add_door(lobby, corridor, _upright(0.0, middle_m, PASSAGE_WIDTH_M), PASSAGE)
    at_m = base_m
    for room in common:
        name = f"{room.name}{floor}"
        end_m = round(at_m + room.length_m, DECIMALS)
        site.add_room(name, room.type, _box(-LOBBY_WIDTH_M - room.width_m, at_m, -LOBBY_WIDTH_M, end_m))
        site.add_door(lobby, name, _upright(-LOBBY_WIDTH_M, (at_m + end_m) / 2, DOOR_WIDTH_M), DOOR)
        at_m = end_m
    return top_m


def _place(flat: Flat, left_m: float, corridor_m: float, upside_down: bool) -> _Move:
    """Return how to move a flat so that it begins at x = ``left_m`` and touches the corridor's side."""
    turn = _Move((flat.turns + 2 * upside_down) % TURNS)
    x0, y0, x1, y1 = flat.bounds_m
    (xa, ya), (xb, yb) = turn.points([(x0, y0), (x1, y1)])
    return replace(turn, shift_m=(left_m - min(xa, xb), corridor_m - (max(ya, yb) if upside_down else min(ya, yb))))


def _upright(x_m: float, middle_m: float, width_m: float) -> Segment:
    return (x_m, round(middle_m - width_m / 2, DECIMALS)), (x_m, round(middle_m + width_m / 2, DECIMALS))


def _box(x0: float, y0: float, x1: float, y1: float) -> Polygon:
    return ((x0, y0), (x0, y1), (x1, y1), (x1, y0))


def _clockwise(shape: shapely.Polygon) -> Polygon:
    outline = shapely.orient_polygons(shape.simplify(0), exterior_cw=True)
    return tuple((round(x, DECIMALS), round(y, DECIMALS)) for x, y in shapely.get_coordinates(outline)[:-1].tolist())


def extent_m(house: House) -> tuple[float, float]:
    """Return how wide a house is along x and along y."""
    points = np.array([(point["x"], point["z"]) for room in house["rooms"] for point in room["floorPolygon"]])
    width_m, depth_m = (points.max(axis=0) - points.min(axis=0)).tolist()
    return width_m, depth_m
