"""Read a scanned floor as a home: ROS map_server's YAML and image, and a YAML list of the containers on it.

Source: the map_server format of ROS 1 and nav2 (image, resolution, origin, negate, occupied_thresh, free_thresh; modes
``trinary`` and ``scale``). Cells that are not surely free are walls. The containers' file, in the map's metres:

    rooms: {kitchen: Kitchen, office: Bedroom}        # optional: room -> room type; default is the room's own name
    containers:
      - {name: fridge, type: Fridge, room: kitchen, position: [1.0, 2.5], objects: [Egg]}
      - {name: desk-1, type: Desk, room: office, position: [4.2, 0.8], size: [1.4, 0.7], yaw_deg: 90}

``objects`` is what a simulation puts there. If no container of the file has it, `read_map_worlds` draws the contents.
``size`` (width, depth) defaults to the type's usual size. A scan has no rooms, so each piece of floor belongs to the
room of the container with the shortest way to it. Where two such rooms meet there is an opening, so that only obstacles
on the scan stand in a robot's way.
"""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from itertools import combinations, pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
import shapely
from pydantic import AfterValidator, ConfigDict, Field
from scipy import ndimage

from mrtask.arrays import Bools, Ints
from mrtask.homes.catalogue import Size, load_catalogue
from mrtask.homes.contents import fill_home, rooms_with
from mrtask.homes.home import Container, Door, Home, Obstacle, Point, Polygon, Room
from mrtask.homes.procthor import rotated_rectangle
from mrtask.maps.distance_fields import distance_fields
from mrtask.maps.home_map import REACH_M
from mrtask.maps.ros_image import ImageError, read_cells
from mrtask.maps.yaml_file import MapError as MapError
from mrtask.maps.yaml_file import Schema, YamlFile
from mrtask.names import check_name, counted

DEFAULT_SIZE_M = Size(0.3, 0.5, 0.3)
"""The size of containers whose type the catalogue does not know."""
COORDINATE_DECIMALS = 6
SAME_YAW_RAD = 1e-6
MAX_SPECKS = 5000
"""More separate spots that are not free than this are noise, and would take hours as obstacles."""
MIN_REGION_M2 = 0.5
"""Free floor that is separate from the rest counts if it is at least this large. Smaller spots are noise or the inside
of furniture."""

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Share = Annotated[float, Field(ge=0, le=1)]
_Text = Annotated[str, Field(min_length=1)]
_Name = Annotated[str, AfterValidator(check_name)]


class MapWarning(UserWarning):
    """A map that can be read, but perhaps not in the way that its owner intended."""


class _MapFile(Schema):
    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)

    image: _Text
    resolution: _Positive
    origin: list[float] = Field(min_length=2, max_length=3)
    negate: bool | int = 0
    occupied_thresh: _Share = 0.65
    free_thresh: _Share = 0.196
    mode: str = "trinary"


class _ContainerEntry(Schema):
    name: _Name
    type: _Name
    room: _Name
    position: list[_Finite] = Field(min_length=2, max_length=2)
    size: list[_Positive] | None = Field(default=None, min_length=2, max_length=2)
    yaw_deg: _Finite = 0.0
    objects: list[_Name] | None = None


class _ContainersFile(Schema):
    rooms: dict[_Name, _Name] = Field(default_factory=dict)
    containers: list[_ContainerEntry] = Field(min_length=1)


class CellKind(IntEnum):
    """What a cell of a scan was read as."""

    NOT_FREE = 0
    FLOOR = 1
    UNKNOWN_AS_FLOOR = 2
    """Floor of the home whose grey is that of unknown space."""
    LEFT_OUT = 3
    """Free floor to which no way leads."""


@dataclass(frozen=True)
class _Floor:
    """The free cells of a scan."""

    main: Bools
    """[H, W] the largest connected region: the home."""
    rest: Bools
    """[H, W] other regions large enough to stand on."""
    unknown: Bools
    """[H, W] free cells with the grey for unknown."""

    def kinds(self) -> Ints:
        """Return [H, W] the `CellKind` of each cell."""
        kinds = np.where(self.main, CellKind.FLOOR, CellKind.NOT_FREE)
        kinds[self.unknown & self.main], kinds[self.rest] = CellKind.UNKNOWN_AS_FLOOR, CellKind.LEFT_OUT
        return kinds


def read_map_worlds(map_path: Path | str, containers_path: Path | str, worlds: int, seed: int) -> tuple[Home, ...]:
    """Read the scanned floor as homes: one with the listed contents, or ``worlds`` with drawn contents.

    Contents are drawn, from the catalogue's likelihoods, if the file lists none. World k of a seed does not depend on
    ``worlds``. Raises `MapError`, also if contents are to be drawn for a container whose type the catalogue does not
    know.
    """
    return map_worlds(_said(scan_floor(map_path, containers_path)), worlds, seed)


def map_worlds(scan: "ScannedFloor", worlds: int, seed: int) -> tuple[Home, ...]:
    """Return the homes of a scanned floor; takes and raises what `read_map_worlds` does."""
    home, containers_file = scan.home, YamlFile(scan.containers_path)
    listed = containers_file.check(_ContainersFile).containers
    if any(entry.objects is not None for entry in listed):
        return (home,)
    catalogue = load_catalogue()
    for index, entry in enumerate(listed):
        if not rooms_with(catalogue, entry.type):
            known = sorted({kind for containers in catalogue.objects.values() for kind in containers})
            problem = (
                f"the contents of a {entry.type} are not known; choose one of {', '.join(known)}, "
                "or list the objects of the containers"
            )
            raise containers_file.error(("containers", index, "type"), problem)
    drawn = (fill_home(home, np.random.default_rng([seed, number])) for number in range(worlds))
    return tuple({world.id: world for world in drawn}.values())


@dataclass(frozen=True, eq=False)
class ScannedFloor:
    """A home read from a map, and what its owner should know about the reading."""

    home: Home
    area_m2: float
    warnings: tuple[str, ...]
    containers_path: Path
    """The file that lists the containers."""
    cells: Ints
    """[H, W] the `CellKind` of each cell of the scan; row 0 is at the origin's side."""
    origin_m: Point
    resolution_m: float

    @property
    def summary(self) -> str:
        """Return a line such as ``lab.yaml: 42.0 m2 of floor (small), 2 rooms, 5 containers``."""
        rooms = len({room.id.partition("#")[0] for room in self.home.rooms})
        containers = counted(len(self.home.containers), "container")
        floor = f"{self.area_m2:.1f} m2 of floor ({self.home.size_class})"
        return f"{self.home.source}: {floor}, {counted(rooms, 'room')}, {containers}"

    @property
    def told(self) -> tuple[str, ...]:
        """Return what a program should say about the reading: the summary, then a line for each warning."""
        return (self.summary, *(f"warning: {text}" for text in self.warnings))


def read_ros_map(map_path: Path | str, containers_path: Path | str) -> Home:
    """Read the scanned floor, with its containers, as a home.

    Issues a `MapWarning` for everything that `scan_floor` finds doubtful. Raises `MapError`, which names the file, the
    line and the field.
    """
    return _said(scan_floor(map_path, containers_path)).home


def _said(scan: ScannedFloor) -> ScannedFloor:
    for text in scan.warnings:
        warnings.warn(text, MapWarning, stacklevel=3)
    return scan


def scan_floor(map_path: Path | str, containers_path: Path | str) -> ScannedFloor:
    """Read the scanned floor with its containers. Raises `MapError`, which names the file, the line and the field."""
    map_path = Path(map_path)
    map_file = YamlFile(map_path)
    facts, doubts = _facts(map_file)
    floor, more_doubts = _floor(map_file, facts)
    containers_file = YamlFile(Path(containers_path))
    listed = containers_file.check(_ContainersFile)
    containers, seeds = _placed(containers_file, listed, floor, facts)
    names = list(dict.fromkeys(entry.room for entry in listed.containers))
    if unused := sorted(set(listed.rooms) - set(names)):
        raise containers_file.error(
            ("rooms", unused[0]), "no container is in this room; the rooms are " + ", ".join(names)
        )
    room_of = _divide(floor.main, seeds, [names.index(entry.room) for entry in listed.containers])
    rooms: list[Room] = []
    obstacles: list[Obstacle] = []
    for number, name in enumerate(names):
        pieces = list(_pieces(room_of, number))
        if not pieces:
            index = next(index for index, entry in enumerate(listed.containers) if entry.room == name)
            problem = f"no floor is left for '{name}': a container of another room is as near to all of it"
            raise containers_file.error(("containers", index, "room"), problem)
        for piece in pieces:
            outline = _to_metres(piece.exterior, facts)
            room_id = name if name not in {room.id for room in rooms} else f"{name}#{len(rooms)}"
            rooms.append(Room(room_id, listed.rooms.get(name, name), outline))
            obstacles += [Obstacle("", "Wall", _to_metres(hole, facts)) for hole in piece.interiors]
    numbered = tuple(Obstacle(f"wall-{index}", wall.type, wall.footprint) for index, wall in enumerate(obstacles))
    home = Home(map_path.name, tuple(rooms), tuple(_openings(rooms)), tuple(containers), numbered)
    return ScannedFloor(
        home=home,
        area_m2=float(floor.main.sum()) * facts.resolution**2,
        warnings=(*doubts, *more_doubts),
        containers_path=Path(containers_path),
        cells=floor.kinds(),
        origin_m=(facts.origin[0], facts.origin[1]),
        resolution_m=facts.resolution,
    )


def _placed(
    file: YamlFile, listed: _ContainersFile, floor: _Floor, facts: _MapFile
) -> tuple[list[Container], list[tuple[int, int]]]:
    """Return the containers, and for each of them the nearest cell of the floor."""
    containers: list[Container] = []
    cells: list[tuple[int, int]] = []
    for index, entry in enumerate(listed.containers):
        if entry.name in {container.id for container in containers}:
            raise file.error(("containers", index, "name"), f"'{entry.name}' is used twice")
        container = _container(entry)
        containers.append(container)
        cell, away_m = _nearest_floor(floor.main, facts, container.footprint)
        _, away_elsewhere_m = _nearest_floor(floor.rest, facts, container.footprint)
        if away_elsewhere_m + facts.resolution < away_m:
            problem = f"{entry.position} is on floor that is not connected with the rest of the map (a shut door?)"
            raise file.error(("containers", index, "position"), problem)
        if cell is None:
            problem = f"{entry.position} is not within {REACH_M} m of free floor; is it in the map's metres?"
            raise file.error(("containers", index, "position"), problem)
        cells.append(cell)
    return containers, cells


def _facts(file: YamlFile) -> tuple[_MapFile, list[str]]:
    """Return the map's YAML, checked, and warnings about it."""
    facts, warnings_ = file.check(_MapFile), []
    if facts.mode not in ("trinary", "scale"):
        raise file.error(("mode",), f"'{facts.mode}' is not supported; allowed: trinary, scale")
    for axis in (0, 1):
        if not np.isfinite(facts.origin[axis]):
            raise file.error(("origin", axis), "input should be a finite number")
    yaw = facts.origin[2] if len(facts.origin) == 3 else 0.0
    if not np.isfinite(yaw):
        warnings_.append(
            f"{file.path.name}: the yaw of origin is {yaw}, which some versions of map_saver write; read as 0"
        )
    elif abs(yaw) > SAME_YAW_RAD:
        raise file.error(("origin", 2), f"a turn of {yaw} rad is not supported; turn the image instead")
    if facts.free_thresh >= facts.occupied_thresh:
        raise file.error(("free_thresh",), f"{facts.free_thresh} is not below occupied_thresh {facts.occupied_thresh}")
    return facts, warnings_


def _floor(file: YamlFile, facts: _MapFile) -> tuple[_Floor, list[str]]:
    """Return the floor, with row 0 at the origin's side (images start at the top), and warnings about it."""
    path, cell_m2 = file.path.parent / facts.image, facts.resolution**2
    try:
        cells = read_cells(path, negate=bool(facts.negate), free_thresh=facts.free_thresh)
    except ImageError as error:
        raise file.error(("image",), f"'{facts.image}' {error}") from None
    labels, count = ndimage.label(cells.free)
    if count == 0:
        raise file.error(("image",), "no cell is free; are negate and free_thresh right?")
    _, specks = ndimage.label(~cells.free)
    if specks > MAX_SPECKS:
        raise file.error(
            ("image",),
            f"{specks} separate spots of the image are not free, more than {MAX_SPECKS}: the scan is too noisy; "
            "smooth it, for example with a median filter",
        )
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    main = int(np.argmax(sizes))
    large = np.flatnonzero(sizes * cell_m2 >= MIN_REGION_M2)
    left_out = [int(label) for label in large if label != main]
    floor = _Floor(labels == main, np.isin(labels, left_out), cells.unknown_as_free)
    name, warnings_ = file.path.name, []
    if unknown := int(floor.unknown.sum()):
        warnings_.append(
            f"{name}: {unknown} cells of grey 205, which map_saver writes for unknown space, count as "
            f"floor since free_thresh is {facts.free_thresh:g}; free_thresh: 0.196 leaves them out"
        )
    if left_out:
        area_m2 = float(sizes[left_out].sum()) * cell_m2
        warnings_.append(
            f"{name}: {area_m2:.1f} m2 of free floor in {counted(len(left_out), 'region')} are left out: no way leads "
            "there on the scan (a shut door?)"
        )
    return floor, warnings_


def _container(entry: _ContainerEntry) -> Container:
    usual = load_catalogue().typical_size_m(entry.type) or DEFAULT_SIZE_M
    size_m = usual if entry.size is None else Size(entry.size[0], usual.y, entry.size[1])
    # A footprint turns clockwise, as in Unity; a map's yaw is counter-clockwise.
    footprint = rotated_rectangle(entry.position[0], entry.position[1], size_m, -entry.yaw_deg)
    return Container(entry.name, entry.type, entry.room, footprint, tuple(sorted(set(entry.objects or ()))))


def _nearest_floor(floor: Bools, facts: _MapFile, footprint: Polygon) -> tuple[tuple[int, int] | None, float]:
    """Return the floor cell nearest to a footprint and its distance in metres.

    Return None and inf if no floor is within reach.
    """
    corners = (np.array(footprint) - facts.origin[:2]) / facts.resolution
    reach = REACH_M / facts.resolution
    left, bottom = np.maximum(np.floor(corners.min(axis=0) - reach), 0).astype(int)
    right, top = np.maximum(np.ceil(corners.max(axis=0) + reach), 0).astype(int)
    rows, cols = np.nonzero(floor[bottom:top, left:right])
    if len(rows) == 0:
        return None, np.inf
    points = shapely.points(cols + left + 0.5, rows + bottom + 0.5)
    distance = shapely.distance(points, shapely.Polygon(corners))
    best = int(np.argmin(distance))
    if distance[best] > reach:
        return None, np.inf
    return (int(rows[best] + bottom), int(cols[best] + left)), float(distance[best]) * facts.resolution


def _divide(floor: Bools, seeds: list[tuple[int, int]], rooms: list[int]) -> Ints:
    """Return, for each cell [H, W], the room of the seed with the shortest way to it, or -1 off the floor."""
    best = np.full(floor.shape, np.inf, np.float32)
    room_of = np.full(floor.shape, -1, np.int64)
    for seed, room in zip(seeds, rooms, strict=True):
        (distance,) = distance_fields(floor, np.array([seed], np.int32), 1.0)
        nearer = floor & (distance < best)
        best[nearer], room_of[nearer] = distance[nearer], room
    return room_of


def _pieces(room_of: Ints, room: int) -> Iterator[shapely.Polygon]:
    """Yield a room's connected pieces, in cells.

    A piece around another room is cut in two, so that no rooms overlap.
    """
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
    """Yield the polygons of a cell mask, in cells, built from runs along the rows."""
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
    """Yield an opening along every straight stretch that two rooms share."""
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
