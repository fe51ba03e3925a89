"""Read ProcTHOR house JSON (schema 1.0.0, the format of ProcTHOR-10K) as homes.

Source: Deitke et al., *ProcTHOR: Large-Scale Embodied AI Using Procedural Generation*, NeurIPS 2022. Object ids are
``Type|room|n`` (ProcTHOR-10K) or ``room|n`` (ProcTHOR's own generator); for the latter, the type comes from the asset
database by ``assetId``. Without a database, sizes come from the catalogue: the asset's size if it is listed, else its
type's.
"""

import gzip
import json
import math
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from shapely.geometry import LineString
from shapely.geometry import Point as ShapelyPoint
from shapely.geometry import Polygon as ShapelyPolygon

from mrtask.errors import InputError
from mrtask.homes.catalogue import CONTAINER_TYPES, Asset, AssetDatabase, Size, load_catalogue
from mrtask.homes.home import Container, Door, Home, Obstacle, Point, Polygon, Room
from mrtask.names import check_name, counted
from mrtask.validation import dotted, first_problem

MAX_COORDINATE_M = 1000.0
MAX_EXTENT_M = 100.0
"""Wider homes are refused. Their map would not fit in memory, and real homes are smaller."""
MIN_ROOM_AREA_M2 = 0.1
ROOM_OVERLAP_TOLERANCE_M2 = 0.05
ON_FLOOR_BELOW_M = 0.3
"""Things with a higher underside (paintings, televisions on walls) are not obstacles."""
WALL_TOLERANCE_M = 0.05
"""Wall ids have two decimals, door positions have all of them."""
_ASSET_GROUP = re.compile(r"_\d+$")
"""What the ids of asset groups append to their type: ``Mug_3``."""


class HouseError(InputError):
    """A house that cannot be read. The message names the file, the line (from 1) with the home, and the field."""

    def __init__(self, source: str, number: int | None, field: str, problem: str) -> None:
        self.source, self.number, self.field, self.problem = source, number, field, problem
        line = "" if number is None else f", line {number + 1}"
        super().__init__(f"{source}{line}: {f'{field}: ' if field else ''}{problem}")


_Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M, allow_inf_nan=False)]
_Length = Annotated[float, Field(gt=0, le=MAX_COORDINATE_M, allow_inf_nan=False)]
_Angle = Annotated[float, Field(ge=-3600, le=3600, allow_inf_nan=False)]


class _Schema(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True)


class _Vector(_Schema):
    x: _Coordinate
    y: _Coordinate = 0.0
    z: _Coordinate


class _Rotation(_Schema):
    y: _Angle


class _BoundingBox(_Schema):
    x: _Length
    y: _Length
    z: _Length


class _Asset(_Schema):
    assetId: str
    boundingBox: _BoundingBox


class _Room(_Schema):
    id: str
    roomType: str = Field(min_length=1)
    floorPolygon: list[_Vector] = Field(min_length=3)


class _Wall(_Schema):
    id: str
    roomId: str = ""
    polygon: list[_Vector] = Field(min_length=2)
    empty: bool = False


class _Door(_Schema):
    id: str
    room0: str
    room1: str
    wall0: str
    holePolygon: list[_Vector] = Field(min_length=2)


class _Child(_Schema):
    id: str
    assetId: str = ""
    children: list["_Child"] = []


class _Object(_Child):
    position: _Vector
    rotation: _Rotation


class _House(_Schema):
    rooms: list[_Room] = Field(min_length=1)
    doors: list[_Door]
    walls: list[_Wall] = []
    objects: list[_Object]


def load_asset_types(path: Path | str) -> AssetDatabase:
    """Read ProcTHOR's asset database (object type -> list of assets).

    Raises `HouseError`, which names the file and the field.
    """
    path = Path(path)
    raw = _parse_json(_read_text(path), path.name, None)
    if not isinstance(raw, dict) or not raw:
        raise HouseError(path.name, None, "", "an asset database is an object of type -> list of assets")
    assets: dict[str, Asset] = {}
    for object_type, entries in raw.items():
        if not isinstance(entries, list):
            raise HouseError(path.name, None, object_type, "should be a list of assets")
        for index, entry in enumerate(entries):
            try:
                asset = _Asset.model_validate(entry)
            except ValidationError as error:
                raise _first_error(error, entry, path.name, None, prefix=f"{object_type}[{index}]") from None
            box = asset.boundingBox
            assets[asset.assetId] = Asset(object_type, Size(box.x, box.y, box.z))
    return assets


def read_houses(
    files: Iterable[Path | str],
    assets_path: Path | str | None = None,
    on_error: Callable[[HouseError], None] | None = None,
) -> Iterator[Home]:
    """Yield the homes of ``.jsonl``, ``.jsonl.gz`` (one house per line) or ``.json`` (one house) files, in order.

    A faulty house raises `HouseError`; with ``on_error``, it is passed to that function and left out. A file that
    cannot be read to its end (missing, truncated) raises in either case.
    """
    paths = [Path(file) for file in files]
    for path in paths:
        if not path.is_file():
            raise HouseError(str(path), None, "", "no such file")
    assets = load_asset_types(assets_path) if assets_path is not None else None
    for path in paths:
        count = 0
        for number, line in _lines(path):
            count += 1
            try:
                yield parse_house(_parse_json(line, path.name, number), assets, path.name, number)
            except HouseError as error:
                if on_error is None:
                    raise
                on_error(error)
        if count == 0:
            raise HouseError(path.name, None, "", "the file holds no house")


def parse_house(raw: object, assets: AssetDatabase | None, source: str, number: int | None) -> Home:
    """Turn one decoded house JSON into a `Home`. Raises `HouseError` if it is not a valid house."""
    try:
        house = _House.model_validate(raw)
    except ValidationError as error:
        raise _first_error(error, raw, source, number) from None
    except RecursionError:
        raise HouseError(source, number, "objects", "children are nested too deeply") from None

    def fail(field: str, problem: str) -> HouseError:
        return HouseError(source, number, field, problem)

    rooms, shapes = _read_rooms(house, fail)
    containers: list[Container] = []
    obstacles: list[Obstacle] = []
    seen: set[str] = set()
    for index, item in enumerate(house.objects):
        if item.id in seen:
            raise fail(f"objects[{index}].id", f"'{item.id}' is used twice")
        seen.add(item.id)
        asset = _find_asset(item, assets, fail, f"objects[{index}]")
        if item.position.y - asset.size_m.y / 2 >= ON_FLOOR_BELOW_M:
            continue
        footprint = rotated_rectangle(item.position.x, item.position.z, asset.size_m, item.rotation.y)
        if asset.type in CONTAINER_TYPES:
            room_id = _room_of(item, shapes)
            if room_id is None:
                raise fail(f"objects[{index}].position", f"the {asset.type} '{item.id}' stands in no room")
            held = tuple(sorted(set(_held_types(item, assets, fail, f"objects[{index}]"))))
            containers.append(Container(item.id, asset.type, room_id, footprint, held))
        else:
            obstacles.append(Obstacle(item.id, asset.type, footprint))
    if not containers:
        raise fail("objects", "no container among them; a home needs one of " + ", ".join(sorted(CONTAINER_TYPES)))
    doors = _read_doors(house, shapes, fail)
    return Home(source, tuple(rooms), tuple(doors), tuple(containers), tuple(obstacles))


def rotated_rectangle(x_m: float, y_m: float, size_m: Size, rotation_deg: float) -> Polygon:
    """Return the footprint of a box centred at ``(x_m, y_m)``.

    Unity's ``rotation.y`` turns clockwise seen from above.
    """
    cos, sin = math.cos(math.radians(rotation_deg)), math.sin(math.radians(rotation_deg))
    half_x, half_z = size_m.x / 2, size_m.z / 2
    corners = [(-half_x, -half_z), (half_x, -half_z), (half_x, half_z), (-half_x, half_z)]
    return tuple((round(x_m + a * cos + b * sin, 6), round(y_m - a * sin + b * cos, 6)) for a, b in corners)


_Fail = Callable[[str, str], HouseError]


def _read_rooms(house: _House, fail: _Fail) -> tuple[list[Room], dict[str, ShapelyPolygon]]:
    rooms: list[Room] = []
    shapes: dict[str, ShapelyPolygon] = {}
    for index, raw in enumerate(house.rooms):
        if raw.id in shapes:
            raise fail(f"rooms[{index}].id", f"'{raw.id}' is used twice")
        polygon = tuple((point.x, point.z) for point in raw.floorPolygon)
        shape = ShapelyPolygon(polygon)
        if not shape.is_valid or shape.area < MIN_ROOM_AREA_M2:
            problem = "has no area" if shape.is_valid else "intersects itself"
            raise fail(f"rooms[{index}].floorPolygon", f"the polygon {problem}")
        rooms.append(Room(raw.id, raw.roomType, polygon))
        shapes[raw.id] = shape
    for (first, shape), (second, other) in combinations(shapes.items(), 2):
        if shape.intersection(other).area > ROOM_OVERLAP_TOLERANCE_M2:
            raise fail("rooms", f"'{first}' and '{second}' overlap")
    xs, ys = zip(*(point for room in rooms for point in room.polygon), strict=True)
    extent_m = max(max(xs) - min(xs), max(ys) - min(ys))
    if extent_m > MAX_EXTENT_M:
        raise fail("rooms", f"the home is {extent_m:.0f} m wide, more than the {MAX_EXTENT_M:.0f} m allowed")
    return rooms, shapes


def _read_doors(house: _House, shapes: Mapping[str, ShapelyPolygon], fail: _Fail) -> list[Door]:
    walls = {wall.id: wall for wall in house.walls}
    doors: list[Door] = []
    seen: set[str] = set()
    for index, raw in enumerate(house.doors):
        field = f"doors[{index}]"
        if raw.id in seen:
            raise fail(f"{field}.id", f"'{raw.id}' is used twice")
        seen.add(raw.id)
        for name, room_id in (("room0", raw.room0), ("room1", raw.room1)):
            if room_id not in shapes:
                raise fail(f"{field}.{name}", f"no room '{room_id}'; the rooms are {', '.join(sorted(shapes))}")
        ends = _wall_ends(raw.wall0, walls)
        if ends is None:
            raise fail(f"{field}.wall0", f"no wall '{raw.wall0}', and its id does not end in x0|z0|x1|z1")
        (x0, y0), (x1, y1) = ends
        length_m = math.hypot(x1 - x0, y1 - y0)
        low_m, high_m = sorted((raw.holePolygon[0].x, raw.holePolygon[1].x))
        if low_m < -WALL_TOLERANCE_M or high_m > length_m + WALL_TOLERANCE_M or high_m - low_m <= 0:
            problem = f"the opening from {low_m:.2f} to {high_m:.2f} m is not on its wall of {length_m:.2f} m"
            raise fail(f"{field}.holePolygon", problem)
        ux, uy = (x1 - x0) / length_m, (y1 - y0) / length_m
        start = (round(x0 + ux * low_m, 6), round(y0 + uy * low_m, 6))
        end = (round(x0 + ux * high_m, 6), round(y0 + uy * high_m, 6))
        for room_id in (raw.room0, raw.room1):
            if not LineString([start, end]).within(shapes[room_id].exterior.buffer(WALL_TOLERANCE_M)):
                raise fail(f"{field}.wall0", f"the opening is not on the outline of '{room_id}'")
        doors.append(Door(raw.id, (raw.room0, raw.room1), start, end))
    return [*doors, *_read_openings(house, set(shapes))]


def _read_openings(house: _House, room_ids: set[str]) -> Iterator[Door]:
    """Yield the openings.

    A wall marked ``empty`` does not exist: a pair of them, one for each room, is an opening of the wall's length.
    """
    first_sides: dict[str, _Wall] = {}
    for wall in house.walls:
        if not wall.empty or wall.roomId not in room_ids:
            continue
        place = "|".join(wall.id.split("|")[-4:])
        other = first_sides.setdefault(place, wall)
        if other.roomId != wall.roomId:
            start, end = wall.polygon[:2]
            rooms = (other.roomId, wall.roomId)
            yield Door(f"opening|{place}", rooms, (start.x, start.z), (end.x, end.z))


def _wall_ends(wall_id: str, walls: Mapping[str, _Wall]) -> tuple[Point, Point] | None:
    """Return where a wall starts and ends, or None if that is unknown.

    Door positions run along the wall's *polygon*, which for half of the walls is the reverse of the order in the id.
    Following the id's order would put the opening behind furniture. The id counts only if the house lists no such wall.
    """
    if (wall := walls.get(wall_id)) is not None:
        start, end = wall.polygon[:2]
        ends = ((start.x, start.z), (end.x, end.z))
    else:
        try:
            x0, y0, x1, y1 = (float(part) for part in wall_id.split("|")[-4:])
        except ValueError:
            return None
        ends = ((x0, y0), (x1, y1))
    usable = all(math.isfinite(value) for end in ends for value in end) and ends[0] != ends[1]
    return ends if usable else None


def _id_type(object_id: str) -> str | None:
    """Return the type in an id (``Fridge|2|1``, ``Mug_3|2|0|1``); None for ids without one (``2|1``, ``small|2|1``)."""
    head, _, rest = object_id.partition("|")
    return _ASSET_GROUP.sub("", head) if rest and head[:1].isupper() else None


def _object_type(item: _Child, assets: AssetDatabase | None) -> str | None:
    if assets is not None and item.assetId in assets:
        return assets[item.assetId].type
    if (listed := load_catalogue().assets.get(item.assetId)) is not None:
        return listed.type
    return _id_type(item.id)


def _find_asset(item: _Child, assets: AssetDatabase | None, fail: _Fail, field: str) -> Asset:
    catalogue = load_catalogue()
    for known in (assets or {}, catalogue.assets):
        if item.assetId in known:
            return known[item.assetId]
    object_type = _id_type(item.id)
    if object_type is None:
        raise fail(field, _unknown_type(item, assets))
    size_m = catalogue.typical_size_m(object_type)
    if size_m is None:
        raise fail(
            field, f"no size is known for the type '{object_type}'; give an asset database that has '{item.assetId}'"
        )
    return Asset(object_type, size_m)


def _unknown_type(item: _Child, assets: AssetDatabase | None) -> str:
    if "|" not in item.id:
        return (
            f"'{item.id}' is no id of ProcTHOR's houses (Type|room|n, or room|n with an asset database); houses in "
            "other formats, such as Holodeck's, cannot be read"
        )
    if assets is None:
        return f"'{item.id}' names no type; give the asset database that has its assetId '{item.assetId}'"
    return f"'{item.id}' names no type and its assetId '{item.assetId}' is not in the asset database"


def _held_types(item: _Child, assets: AssetDatabase | None, fail: _Fail, field: str) -> Iterator[str]:
    for index, child in enumerate(item.children):
        child_field = f"{field}.children[{index}]"
        child_type = _object_type(child, assets)
        if child_type is None:
            raise fail(child_field, _unknown_type(child, assets))
        try:
            check_name(child_type)
        except InputError as error:
            raise fail(f"{child_field}.id", str(error)) from None
        yield child_type
        yield from _held_types(child, assets, fail, child_field)


def _room_of(item: _Object, shapes: Mapping[str, ShapelyPolygon]) -> str | None:
    """Return the room around the object's centre.

    If several rooms qualify, return the one that the id names (``Bed|2|0``, ``2|0`` -> ``room|2``).
    """
    center = ShapelyPoint(item.position.x, item.position.z)
    around = [room_id for room_id, shape in shapes.items() if shape.distance(center) <= WALL_TOLERANCE_M]
    parts = item.id.split("|")
    named = f"room|{parts[1] if _id_type(item.id) else parts[0]}" if len(parts) > 1 else ""
    return named if named in around else next(iter(around), None)


def _lines(path: Path) -> Iterator[tuple[int | None, str]]:
    """Yield the houses of a file with their lines, from 0; a ``.json`` file is one house of any number of lines."""
    if path.suffix == ".json":
        yield None, _read_text(path)
        return
    opener: Any = gzip.open if path.suffix == ".gz" else open
    number = homes = 0
    try:
        with opener(path, "rt", encoding="utf-8") as file:
            for line in file:
                if line.strip():
                    yield number, line
                    homes += 1
                number += 1
    except (EOFError, OSError, UnicodeDecodeError, zlib.error) as error:
        problem = f"the file is damaged or cut off after {counted(homes, 'whole home')} ({error})"
        raise HouseError(path.name, number, "", problem) from None


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise HouseError(str(path), None, "", f"cannot be read ({error})") from None


def _parse_json(text: str, source: str, number: int | None) -> object:
    try:
        return json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise HouseError(source, number, "", f"is not JSON ({error})") from None


def _first_error(error: ValidationError, raw: object, source: str, number: int | None, prefix: str = "") -> HouseError:
    """Return the first error of pydantic, with its place written as ``objects[3].position.x``."""
    place, problem = first_problem(error, raw)
    field = dotted(place)
    return HouseError(source, number, f"{prefix}.{field}".strip(".") if prefix else field, problem)
