"""Write a home for both sides: a ROS map and a list of containers for the live team, a world for pyrobosim.

    <folder>/map.yaml, floor.png, containers.yaml      what the live team knows, without the containers' contents
    <folder>/world.yaml, locations.yaml, objects.yaml  the truth; pyrobosim's own programs open the first

Rooms become pyrobosim's rooms, drawn in by half a wall; doors and openings its hallways; furniture its locations, the
containers with one object spawn each, whose navigation pose is where the live team's routes to it end. pyrobosim has no
overlapping furniture, so a piece gives up what a smaller one or a wall covers of it; the live team keeps clear of the
whole piece.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import atan2, degrees, hypot
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import yaml
from numpy.typing import NDArray
from PIL import Image
from shapely.geometry.base import BaseGeometry

from mrtask.errors import InputError
from mrtask.homes.home import Container, Home, Obstacle, Point, Polygon
from mrtask.maps.home_map import HomeMap, build_map
from mrtask.maps.ros_map import read_ros_map
from simulators.pyrobosim.robot import Body

RESOLUTION_M = 0.05
HALF_WALL_M = 0.05
HALLWAY_REACH_M = 0.1
"""A hallway reaches this much further into a room than the robot's centre must be from the wall."""
GAP_M = 0.002
"""Between pieces of furniture, and between them and walls."""
MIN_AREA_M2 = 0.001
OBJECT_RADIUS_M, OBJECT_MARGIN_M = 0.008, 0.002
SPACINGS_M = (0.2, 0.1, 0.05, 0.025)
"""Between objects; as wide as there is room for."""
FREE, WALL = 254, 0
OBJECT_COLOR, CONTAINER_COLOR, OBSTACLE_COLOR = "#c02020", "#b08050", "#909090"


@dataclass(frozen=True, eq=False)
class World:
    """A home in a folder."""

    folder: Path
    home: Home
    """The home that the live team reads, with the containers' true contents."""
    size_class: str
    """The home's own: on a map, walls take part of the floor."""
    home_map: HomeMap
    """The live team's map."""
    left_out: tuple[str, ...]
    """Containers that no robot can stand at in pyrobosim: for both sides they are furniture like any other."""

    @property
    def map_file(self) -> Path:
        """ROS map_server's YAML."""
        return self.folder / "map.yaml"

    @property
    def containers_file(self) -> Path:
        """The containers on the map."""
        return self.folder / "containers.yaml"

    @property
    def world_file(self) -> Path:
        """The world in pyrobosim's YAML."""
        return self.folder / "world.yaml"


def write_world(home: Home, folder: Path, body: Body) -> World:
    """Write a home's files.

    Raises:
        InputError: no container is left that a robot can stand at.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rooms = {room.id: _drawn_in(room.polygon) for room in home.rooms}
    pieces = _pieces(home, rooms)
    left_out: set[str] = set()
    while True:
        known = _without(home, left_out)
        _write_map(known, rooms, folder)
        read = read_ros_map(folder / "map.yaml", folder / "containers.yaml")
        home_map = build_map(read, RESOLUTION_M, body.planned_radius_m)
        poses = _navigation_poses(read, home_map, rooms, pieces, body)
        unusable = {container.id for container in read.containers} - set(poses)
        if not unusable:
            break
        left_out |= unusable
        if len(left_out) == len(home.containers):
            raise InputError(
                f"home {home.id}: a robot of radius {body.planned_radius_m:.2f} m fits before no container"
            )
    held = {container.id: container.objects for container in home.containers}
    containers = tuple(replace(container, objects=held[container.id]) for container in read.containers)
    _write_world(known, rooms, pieces, poses, folder, body)
    known_home = replace(read, containers=containers)
    return World(folder, known_home, home.size_class, home_map, tuple(sorted(left_out)))


def _without(home: Home, left_out: set[str]) -> Home:
    """Return the home in which these containers are obstacles."""
    kept = tuple(container for container in home.containers if container.id not in left_out)
    others = tuple(Obstacle(one.id, one.type, one.footprint) for one in home.containers if one.id in left_out)
    return replace(home, containers=kept, obstacles=home.obstacles + others)


def _drawn_in(polygon: Polygon) -> shapely.Polygon:
    return _largest(shapely.Polygon(polygon).buffer(-HALF_WALL_M, join_style="mitre"))


def _largest(shape: BaseGeometry) -> shapely.Polygon:
    """Return the largest polygon of a shape; an empty polygon if it has none."""
    parts = [part for part in shapely.get_parts(shape) if part.geom_type == "Polygon"]
    return max(parts, key=lambda part: part.area, default=shapely.Polygon())


def _openings(home: Home) -> Iterator[tuple[str, tuple[str, str], Point, Point]]:
    """``name, rooms, start, end`` of every opening between two rooms, without the ends that walls cover."""
    for number, door in enumerate(home.doors):
        length_m = hypot(door.end[0] - door.start[0], door.end[1] - door.start[1])
        if door.rooms[0] == door.rooms[1] or length_m <= 2 * HALF_WALL_M:
            continue
        share = HALF_WALL_M / length_m
        dx, dy = (share * (door.end[axis] - door.start[axis]) for axis in (0, 1))
        start, end = (door.start[0] + dx, door.start[1] + dy), (door.end[0] - dx, door.end[1] - dy)
        yield f"door-{number}", door.rooms, start, end


def _pieces(home: Home, rooms: Mapping[str, shapely.Polygon]) -> dict[tuple[str, str], shapely.Polygon]:
    """``(furniture, room)`` -> what pyrobosim gets of the piece in that room; smaller pieces first."""
    wanted = []
    for container in home.containers:
        wanted.append((container.id, container.room_id, shapely.Polygon(container.footprint)))
    for obstacle in home.obstacles:
        wanted += [(obstacle.id, room, shapely.Polygon(obstacle.footprint)) for room in rooms]
    pieces: dict[tuple[str, str], shapely.Polygon] = {}
    for name, room, footprint in sorted(wanted, key=lambda one: (one[2].area, one[0], one[1])):
        floor = rooms[room].buffer(-GAP_M, join_style="mitre")
        taken = [other.buffer(GAP_M, join_style="mitre") for (_, where), other in pieces.items() if where == room]
        shape = _without_holes(_largest(footprint.intersection(floor).difference(shapely.union_all(taken))))
        if shape.area >= MIN_AREA_M2:
            pieces[name, room] = shape
    return pieces


def _without_holes(shape: shapely.Polygon) -> shapely.Polygon:
    """The shape with a cut from each hole to its upper side: pyrobosim's polygons have no holes."""
    while shape.interiors:
        left, bottom, right, _ = shapely.Polygon(shape.interiors[0]).bounds
        shape = _largest(shape.difference(shapely.box(left, bottom, right, shape.bounds[3] + GAP_M)))
    return shape


def _write_map(home: Home, rooms: Mapping[str, shapely.Polygon], folder: Path) -> None:
    """What a lab has of its rooms: an occupancy grid, and where which furniture stands."""
    doors = [
        shapely.LineString([start, end]).buffer(HALF_WALL_M + GAP_M, cap_style="flat")
        for _, _, start, end in _openings(home)
    ]
    solid = [shapely.Polygon(obstacle.footprint) for obstacle in home.obstacles]
    floor = shapely.union_all([*rooms.values(), *doors]).difference(shapely.union_all(solid))
    # A cell is free only if all of it is, so that what is free on the map is free in pyrobosim's exact geometry.
    floor = floor.buffer(-RESOLUTION_M / 2, join_style="mitre")
    left, bottom, right, top = floor.bounds
    cols, rows = (int(np.ceil(extent / RESOLUTION_M)) + 2 for extent in (right - left, top - bottom))
    origin = (left - RESOLUTION_M, bottom - RESOLUTION_M)
    xs, ys = (origin[axis] + (np.arange(count) + 0.5) * RESOLUTION_M for axis, count in enumerate((cols, rows)))
    shapely.prepare(floor)
    free = shapely.contains_xy(floor, *np.meshgrid(xs, ys))
    image = np.where(free, FREE, WALL).astype(np.uint8)
    Image.fromarray(np.flipud(image)).save(folder / "floor.png")  # images start at the top, maps at the bottom
    facts = {
        "image": "floor.png",
        "resolution": RESOLUTION_M,
        "origin": [round(float(origin[0]), 6), round(float(origin[1]), 6), 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    _write_yaml(folder / "map.yaml", facts)
    types = home.room_types
    used = dict.fromkeys(container.room_id for container in home.containers)
    content = {"rooms": {room: types[room] for room in used}, "containers": list(map(_entry, home.containers))}
    _write_yaml(folder / "containers.yaml", content)


def _entry(container: Container) -> dict[str, Any]:
    """A container as the containers' file has it, from its rectangle."""
    first, second, third, _ = container.footprint
    width_m, depth_m = (
        hypot(second[0] - first[0], second[1] - first[1]),
        hypot(third[0] - second[0], third[1] - second[1]),
    )
    middle = [(first[axis] + third[axis]) / 2 for axis in (0, 1)]
    return {
        "name": container.id,
        "type": container.type,
        "room": container.room_id,
        "position": [round(value, 6) for value in middle],
        "size": [round(width_m, 6), round(depth_m, 6)],
        "yaw_deg": round(degrees(atan2(second[1] - first[1], second[0] - first[0])), 4),
    }


Pose = tuple[float, float, float]
"""``x, y`` in metres and the yaw in radians."""


def _navigation_poses(
    read: Home,
    home_map: HomeMap,
    rooms: Mapping[str, shapely.Polygon],
    pieces: Mapping[tuple[str, str], shapely.Polygon],
    body: Body,
) -> dict[str, Pose]:
    """Container -> where a robot stands to search it, facing it; only where pyrobosim lets it stand."""
    poses: dict[str, Pose] = {}
    for index, container in enumerate(read.containers):
        room_id = container.room_id
        piece = pieces.get((container.id, room_id))
        if piece is None or not home_map.reachable[index]:
            continue
        x, y = home_map.cell_center((int(home_map.access[index, 0]), int(home_map.access[index, 1])))
        open_floor = rooms[room_id].buffer(-body.radius_m, join_style="mitre")
        grown = [
            one.buffer(body.radius_m, join_style="mitre") for (_, where), one in pieces.items() if where == room_id
        ]
        if not shapely.contains_xy(open_floor, x, y) or shapely.intersects_xy(shapely.union_all(grown), x, y):
            continue
        middle = piece.centroid
        poses[container.id] = (x, y, atan2(middle.y - y, middle.x - x))
    return poses


def _write_world(
    home: Home,
    rooms: Mapping[str, shapely.Polygon],
    pieces: Mapping[tuple[str, str], shapely.Polygon],
    poses: Mapping[str, Pose],
    folder: Path,
    body: Body,
) -> None:
    locations: dict[str, Any] = {}
    placed: list[dict[str, Any]] = []
    objects: list[dict[str, Any]] = []
    held = {container.id: container.objects for container in home.containers}
    for number, ((name, room), piece) in enumerate(pieces.items()):
        middle = piece.centroid
        category = f"furniture-{number}"
        facts: dict[str, Any] = {
            "footprint": {
                "type": "polygon",
                "coords": _coordinates(shapely.affinity.translate(piece, -middle.x, -middle.y)),
            },
            "color": CONTAINER_COLOR if name in poses else OBSTACLE_COLOR,
        }
        if name in poses:
            x, y, yaw = poses[name]
            facts["locations"] = [{"name": "top", "nav_poses": [[x - middle.x, y - middle.y, 0.0, yaw]]}]
            for kind, (at_x, at_y) in zip(held[name], _spots(piece, len(held[name])), strict=True):
                where = {"parent": name, "pose": [at_x, at_y, 0.0, 0.0]}
                objects.append({"name": f"{kind}@{name}", "category": kind, **where})
        locations[category] = facts
        shown = name if name in poses else f"{name}-{number}"
        placed.append({"name": shown, "category": category, "parent": room, "pose": [middle.x, middle.y, 0.0, 0.0]})
    kinds = {kind: _object_kind() for kind in sorted({one["category"] for one in objects})}
    world = {
        "params": {"name": "home", "inflation_radius": body.radius_m, "object_radius": OBJECT_MARGIN_M},
        "metadata": {"locations": "$PWD/locations.yaml", "objects": "$PWD/objects.yaml"},
        "rooms": [
            {"name": name, "footprint": _coordinates(shape), "wall_width": HALF_WALL_M} for name, shape in rooms.items()
        ],
        "hallways": list(_hallways(home, body)),
        "locations": placed,
        "objects": objects,
    }
    _write_yaml(folder / "locations.yaml", locations)
    _write_yaml(folder / "objects.yaml", kinds)
    _write_yaml(folder / "world.yaml", world)


def _object_kind() -> dict[str, Any]:
    return {"footprint": {"type": "circle", "radius": OBJECT_RADIUS_M}, "color": OBJECT_COLOR}


def _hallways(home: Home, body: Body) -> Iterator[dict[str, Any]]:
    for name, (first, second), start, end in _openings(home):
        width_m = hypot(end[0] - start[0], end[1] - start[1])
        reach_m = HALF_WALL_M + 2 * body.radius_m + HALLWAY_REACH_M
        across = ((start[1] - end[1]) / width_m * reach_m, (end[0] - start[0]) / width_m * reach_m)
        middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
        yield {
            "name": name,
            "room_start": first,
            "room_end": second,
            "width": width_m,
            "conn_method": "points",
            "conn_points": [
                [middle[0] - across[0], middle[1] - across[1]],
                [middle[0] + across[0], middle[1] + across[1]],
            ],
            "wall_width": HALF_WALL_M,
        }


def _spots(piece: shapely.Polygon, count: int) -> list[Point]:
    """Return this many places for objects in a piece of furniture.

    Raises:
        InputError: there is no room for them.
    """
    for spacing_m in SPACINGS_M:
        inside = piece.buffer(-2 * (OBJECT_RADIUS_M + OBJECT_MARGIN_M))
        left, bottom, right, top = piece.bounds
        xs, ys = np.arange(left, right, spacing_m) + spacing_m / 2, np.arange(bottom, top, spacing_m) + spacing_m / 2
        grid: NDArray[np.float64] = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
        fitting = grid[shapely.contains_xy(inside, grid[:, 0], grid[:, 1])]
        if len(fitting) >= count:
            chosen = fitting[np.linspace(0, len(fitting) - 1, count).round().astype(int)] if count else fitting[:0]
            return [(float(x), float(y)) for x, y in chosen]
    raise InputError(f"{count} objects do not fit on furniture of {piece.area:.2f} m2")


def _coordinates(shape: shapely.Polygon) -> list[list[float]]:
    return [[round(float(x), 6), round(float(y), 6)] for x, y in shapely.get_coordinates(shape.exterior)[:-1]]


def _write_yaml(path: Path, content: Mapping[str, Any] | Sequence[Any]) -> None:
    path.write_text(yaml.safe_dump(content, sort_keys=False, default_flow_style=None), encoding="utf-8")
