"""Reads a scanned floor as a home: ROS map_server's YAML and image, and a YAML list of the containers on it.

Source: the map_server format of ROS 1 and nav2 (image, resolution, origin, negate, occupied_thresh, free_thresh; modes
``trinary`` and ``scale``). Cells that are not surely free are walls. The containers' file, in the map's metres:

    rooms: {kitchen: Kitchen, office: Bedroom}        # optional: room -> room type; default is the room's own name
    containers:
      - {name: fridge, type: Fridge, room: kitchen, position: [1.0, 2.5], objects: [Egg]}
      - {name: desk-1, type: Desk, room: office, position: [4.2, 0.8], size: [1.4, 0.7], yaw_deg: 90}

``objects`` is what a simulation puts there; where no container of the file has it, `read_map_worlds` draws contents.
``size`` (width, depth) is the type's usual one by default. A scan has no rooms, so each piece of floor goes to the room
of the container with the shortest way to it; where two such rooms meet there is an opening, so that only what is on the
scan stands in a robot's way.
"""

from collections.abc import Iterator
from itertools import combinations, pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import shapely
import yaml
from PIL import Image, UnidentifiedImageError
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy import ndimage

from mrtask.arrays import Bools, Ints
from mrtask.errors import InputError
from mrtask.homes.catalogue import Size, load_catalogue
from mrtask.homes.contents import fill_home, rooms_with
from mrtask.homes.home import Container, Door, Home, Obstacle, Polygon, Room
from mrtask.homes.procthor import rotated_rectangle
from mrtask.maps.distance_fields import distance_fields
from mrtask.maps.home_map import MAX_CELLS, REACH_M

DEFAULT_SIZE_M = Size(0.3, 0.5, 0.3)
"""For containers of a type that the catalogue does not know."""
COORDINATE_DECIMALS = 6
MAX_GRAY = 255.0

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Share = Annotated[float, Field(ge=0, le=1)]
_Name = Annotated[str, Field(min_length=1)]


class MapError(InputError):
    """A map or containers file that cannot be used: names the file, the line (from 1) and the field."""

    def __init__(self, path: Path, line: int | None, field: str, problem: str) -> None:
        self.path, self.line, self.field, self.problem = path, line, field, problem
        where = path.name if line is None else f"{path.name}, line {line}"
        super().__init__(f"{where}: {f'{field}: ' if field else ''}{problem}")


class _Schema(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class _MapFile(_Schema):
    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)

    image: _Name
    resolution: _Positive
    origin: list[_Finite] = Field(min_length=2, max_length=3)
    negate: bool | int = 0
    occupied_thresh: _Share = 0.65
    free_thresh: _Share = 0.196
    mode: str = "trinary"


class _ContainerEntry(_Schema):
    name: _Name
    type: _Name
    room: _Name
    position: list[_Finite] = Field(min_length=2, max_length=2)
    size: list[_Positive] | None = Field(default=None, min_length=2, max_length=2)
    yaw_deg: _Finite = 0.0
    objects: list[_Name] | None = None


class _ContainersFile(_Schema):
    rooms: dict[_Name, _Name] = {}
    containers: list[_ContainerEntry] = Field(min_length=1)


_T = TypeVar("_T", bound=_Schema)


class _YamlFile:
    """A YAML file's data with the line of each field."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lines: dict[tuple[str | int, ...], int] = {}
        try:
            node = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
        except (OSError, UnicodeDecodeError) as error:
            raise MapError(path, None, "", f"cannot be read ({error})") from None
        except yaml.MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else None
            raise MapError(path, line, "", f"is not YAML ({error.problem})") from None
        self.data = self._construct(node, ())

    def _construct(self, node: yaml.Node | None, place: tuple[str | int, ...]) -> Any:
        if node is None:
            return None
        self._lines[place] = node.start_mark.line + 1
        if isinstance(node, yaml.MappingNode):
            result = {}
            for key_node, value_node in node.value:
                key = str(key_node.value)
                if key in result:
                    raise MapError(self.path, key_node.start_mark.line + 1, key, "is given twice")
                result[key] = self._construct(value_node, (*place, key))
            return result
        if isinstance(node, yaml.SequenceNode):
            return [self._construct(item, (*place, index)) for index, item in enumerate(node.value)]
        return yaml.safe_load(yaml.serialize(node))

    def error(self, place: tuple[str | int, ...], problem: str) -> MapError:
        """An error at a field, or at the nearest that is written down."""
        known = place
        while known and known not in self._lines:
            known = known[:-1]
        field = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
        return MapError(self.path, self._lines.get(known), field, problem)

    def check(self, schema: type[_T]) -> _T:
        """The data as the schema has it."""
        try:
            return schema.model_validate(self.data)
        except ValidationError as error:
            first = error.errors(include_url=False, include_context=False, include_input=False)[0]
            raise self.error(tuple(first["loc"]), first["msg"][:1].lower() + first["msg"][1:]) from None


def read_map_worlds(map_path: Path | str, containers_path: Path | str, worlds: int, seed: int) -> tuple[Home, ...]:
    """The scanned floor as homes: with the contents listed, one; where none is listed, ``worlds`` with contents drawn.

    Contents come from the catalogue's likelihoods; world k of a seed is the same whatever ``worlds``. Raises
    `MapError`, also where contents are to be drawn for a container of a type that the catalogue does not know.
    """
    home = read_ros_map(map_path, containers_path)
    containers_file = _YamlFile(Path(containers_path))
    listed = containers_file.check(_ContainersFile).containers
    if any(entry.objects is not None for entry in listed):
        return (home,)
    catalogue = load_catalogue()
    for index, entry in enumerate(listed):
        if not rooms_with(catalogue, entry.type):
            known = sorted({kind for containers in catalogue.objects.values() for kind in containers})
            problem = (
                f"what a {entry.type} holds is not known; choose one of {', '.join(known)}, "
                "or list the objects of the containers"
            )
            raise containers_file.error(("containers", index, "type"), problem)
    drawn = (fill_home(home, np.random.default_rng([seed, number])) for number in range(worlds))
    return tuple({world.id: world for world in drawn}.values())


def read_ros_map(map_path: Path | str, containers_path: Path | str) -> Home:
    """The scanned floor with its containers as a home; raises `MapError` naming file, line and field."""
    map_path = Path(map_path)
    map_file = _YamlFile(map_path)
    facts = map_file.check(_MapFile)
    floor = _floor_cells(map_file, facts)
    containers_file = _YamlFile(Path(containers_path))
    listed = containers_file.check(_ContainersFile)
    containers: list[Container] = []
    seeds: list[tuple[int, int]] = []
    for index, entry in enumerate(listed.containers):
        if entry.name in {container.id for container in containers}:
            raise containers_file.error(("containers", index, "name"), f"'{entry.name}' is used twice")
        container = _container(entry)
        containers.append(container)
        cell = _nearest_floor(floor, facts, container.footprint)
        if cell is None:
            problem = f"{entry.position} is not within {REACH_M} m of free floor; is it in the map's metres?"
            raise containers_file.error(("containers", index, "position"), problem)
        seeds.append(cell)
    names = list(dict.fromkeys(entry.room for entry in listed.containers))
    if unused := sorted(set(listed.rooms) - set(names)):
        raise containers_file.error(
            ("rooms", unused[0]), "no container is in this room; the rooms are " + ", ".join(names)
        )
    room_of = _divide(floor, seeds, [names.index(entry.room) for entry in listed.containers])
    rooms: list[Room] = []
    obstacles: list[Obstacle] = []
    for number, name in enumerate(names):
        for piece in _pieces(room_of, number):
            outline = _to_metres(piece.exterior, facts)
            room_id = name if name not in {room.id for room in rooms} else f"{name}#{len(rooms)}"
            rooms.append(Room(room_id, listed.rooms.get(name, name), outline))
            obstacles += [Obstacle("", "Wall", _to_metres(hole, facts)) for hole in piece.interiors]
    numbered = tuple(Obstacle(f"wall-{index}", wall.type, wall.footprint) for index, wall in enumerate(obstacles))
    return Home(map_path.name, tuple(rooms), tuple(_openings(rooms)), tuple(containers), numbered)


def _floor_cells(file: _YamlFile, facts: _MapFile) -> Bools:
    """[H, W] the largest region of surely free cells, row 0 at the origin's side (images start at the top)."""
    if facts.mode not in ("trinary", "scale"):
        raise file.error(("mode",), f"'{facts.mode}' is not supported; allowed: trinary, scale")
    if len(facts.origin) == 3 and facts.origin[2] != 0:
        raise file.error(("origin", 2), f"a turn of {facts.origin[2]} rad is not supported; turn the image instead")
    if facts.free_thresh >= facts.occupied_thresh:
        raise file.error(("free_thresh",), f"{facts.free_thresh} is not below occupied_thresh {facts.occupied_thresh}")
    path = file.path.parent / facts.image
    try:
        with Image.open(path) as image:
            width, height = image.size
            gray = np.asarray(image.convert("L"), np.float64) if width * height <= MAX_CELLS else None
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError) as error:
        raise file.error(("image",), f"'{path}' cannot be read as an image ({error})") from None
    if gray is None:
        raise file.error(("image",), f"{width} x {height} is more than {MAX_CELLS} cells")
    occupied_prob = gray / MAX_GRAY if facts.negate else (MAX_GRAY - gray) / MAX_GRAY
    free = np.flipud(occupied_prob < facts.free_thresh)
    labels, count = ndimage.label(free)
    if count == 0:
        raise file.error(("image",), "no cell is free; are negate and free_thresh right?")
    return np.asarray(labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:])))


def _container(entry: _ContainerEntry) -> Container:
    usual = load_catalogue().typical_size_m(entry.type) or DEFAULT_SIZE_M
    size_m = usual if entry.size is None else Size(entry.size[0], usual.y, entry.size[1])
    # The footprint's turn is Unity's, clockwise; a map's yaw is counter-clockwise.
    footprint = rotated_rectangle(entry.position[0], entry.position[1], size_m, -entry.yaw_deg)
    return Container(entry.name, entry.type, entry.room, footprint, tuple(sorted(set(entry.objects or ()))))


def _nearest_floor(floor: Bools, facts: _MapFile, footprint: Polygon) -> tuple[int, int] | None:
    """The floor cell nearest to a footprint, None where it is out of reach."""
    corners = (np.array(footprint) - facts.origin[:2]) / facts.resolution
    reach = REACH_M / facts.resolution
    left, bottom = np.maximum(np.floor(corners.min(axis=0) - reach), 0).astype(int)
    right, top = np.maximum(np.ceil(corners.max(axis=0) + reach), 0).astype(int)
    rows, cols = np.nonzero(floor[bottom:top, left:right])
    if len(rows) == 0:
        return None
    points = shapely.points(cols + left + 0.5, rows + bottom + 0.5)
    distance = shapely.distance(points, shapely.Polygon(corners))
    best = int(np.argmin(distance))
    return (int(rows[best] + bottom), int(cols[best] + left)) if distance[best] <= reach else None


def _divide(floor: Bools, seeds: list[tuple[int, int]], rooms: list[int]) -> Ints:
    """[H, W] the room of the seed with the shortest way to each cell; -1 off the floor."""
    best = np.full(floor.shape, np.inf, np.float32)
    room_of = np.full(floor.shape, -1, np.int64)
    for seed, room in zip(seeds, rooms, strict=True):
        (distance,) = distance_fields(floor, np.array([seed], np.int32), 1.0)
        nearer = floor & (distance < best)
        best[nearer], room_of[nearer] = distance[nearer], room
    return room_of


def _pieces(room_of: Ints, room: int) -> Iterator[shapely.Polygon]:
    """A room's connected pieces in cells; pieces around another room are cut in two, so that no rooms overlap."""
    mine = room_of == room
    pending = list(_outlines(mine))
    while pending:
        piece = pending.pop(0)
        enclosing = [hole for hole in piece.interiors if _holds_floor(room_of, shapely.Polygon(hole))]
        if not enclosing:
            yield piece
            continue
        cut = round(enclosing[0].centroid.x)
        left, bottom, right, top = piece.bounds
        for half in (shapely.box(left, bottom, cut, top), shapely.box(cut, bottom, right, top)):
            pending += [part for part in shapely.get_parts(piece.intersection(half)) if part.geom_type == "Polygon"]


def _outlines(mask: Bools) -> Iterator[shapely.Polygon]:
    """The polygons of a cell mask, in cells; built from runs along the rows."""
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    rows, starts = np.nonzero(edges == 1)
    _, ends = np.nonzero(edges == -1)
    yield from shapely.get_parts(shapely.union_all(shapely.box(starts, rows, ends, rows + 1)).simplify(0))


def _holds_floor(room_of: Ints, hole: shapely.Polygon) -> bool:
    left, bottom, right, top = (int(value) for value in hole.bounds)
    rows, cols = np.nonzero(room_of[bottom:top, left:right] >= 0)
    return bool(shapely.contains_xy(hole, cols + left + 0.5, rows + bottom + 0.5).any())


def _to_metres(ring: shapely.LinearRing, facts: _MapFile) -> Polygon:
    points = shapely.get_coordinates(ring)[:-1] * facts.resolution + facts.origin[:2]
    return tuple((round(float(x), COORDINATE_DECIMALS), round(float(y), COORDINATE_DECIMALS)) for x, y in points)


def _openings(rooms: list[Room]) -> Iterator[Door]:
    """An opening along every straight stretch that two rooms share."""
    shapes = [shapely.Polygon(room.polygon) for room in rooms]
    for first, second in combinations(range(len(rooms)), 2):
        if not shapes[first].intersects(shapes[second]):
            continue
        shared = shapely.line_merge(shapes[first].exterior.intersection(shapes[second].exterior))
        stretches = [part for part in shapely.get_parts(shared) if part.length > 0]
        for number, line in enumerate(stretches):
            points = [(float(x), float(y)) for x, y in line.simplify(0).coords]
            for step, (start, end) in enumerate(pairwise(points)):
                ids = (rooms[first].id, rooms[second].id)
                yield Door(f"{ids[0]}|{ids[1]}|{number}.{step}", ids, start, end)
