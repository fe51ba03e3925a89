"""A home: rooms, doors, containers and the objects in them, in metres on the floor plane.

Every home source (ProcTHOR files, the procedural generator, a lab's own map) produces this type, and everything after
it starts from here. Coordinates are ``(x, y)`` in metres; a ProcTHOR house's ``z`` axis is our ``y``.
"""

import hashlib
import json
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from shapely.geometry import Polygon as ShapelyPolygon

Point = tuple[float, float]
Polygon = tuple[Point, ...]

SIZE_CLASSES = ("small", "medium", "large")
SMALL_BELOW_M2 = 60.0
LARGE_ABOVE_M2 = 110.0
CORRIDOR, LIFT_LOBBY = "Corridor", "LiftLobby"
"""The types of the rooms that join the flats of a residence."""
RESIDENCE = "residence"
ALL_SIZE_CLASSES = (*SIZE_CLASSES, RESIDENCE)
"""The classes of single homes, small to large, and that of many homes along corridors."""


@dataclass(frozen=True)
class Room:
    """A room. ``type`` is ``Kitchen``, ``LivingRoom``, ``Bedroom`` or ``Bathroom`` in ProcTHOR, and free elsewhere."""

    id: str
    type: str
    polygon: Polygon


@dataclass(frozen=True)
class Door:
    """An opening from ``start`` to ``end`` on the wall shared by two rooms.

    An outside door names one room twice.
    """

    id: str
    rooms: tuple[str, str]
    start: Point
    end: Point


@dataclass(frozen=True)
class Container:
    """Floor-standing furniture that can hold small objects, with the sorted distinct object types that it holds."""

    id: str
    type: str
    room_id: str
    footprint: Polygon
    objects: tuple[str, ...]


@dataclass(frozen=True)
class Obstacle:
    """Anything else on the floor that a robot cannot drive through."""

    id: str
    type: str
    footprint: Polygon


@dataclass(frozen=True)
class Home:
    """One home. ``source`` says where it came from (``generated``, a file's name, ...) and is not part of its id."""

    source: str
    rooms: tuple[Room, ...]
    doors: tuple[Door, ...]
    containers: tuple[Container, ...]
    obstacles: tuple[Obstacle, ...]

    @cached_property
    def id(self) -> str:
        """Return the content hash (16 hex digits). It is equal for homes with equal content, whatever their source."""
        content = asdict(self)
        del content["source"]
        return _content_hash(content)

    @cached_property
    def layout_id(self) -> str:
        """Return a hash like ``id``, but without the contents of the containers.

        Homes that differ only in these contents have the same map.
        """
        content = asdict(self)
        del content["source"]
        for container in content["containers"]:
            del container["objects"]
        return _content_hash(content)

    @cached_property
    def area_m2(self) -> float:
        """Return the floor area of all rooms."""
        return float(sum(ShapelyPolygon(room.polygon).area for room in self.rooms))

    @property
    def size_class(self) -> str:
        """Return ``small`` below 60 m2, ``large`` above 110 m2, else ``medium``.

        A home of more than 110 m2 with a corridor and a lift lobby is a ``residence``.
        """
        by_area = size_class_of(self.area_m2)
        is_residence = by_area == "large" and {CORRIDOR, LIFT_LOBBY} <= {room.type for room in self.rooms}
        return RESIDENCE if is_residence else by_area

    @cached_property
    def room_types(self) -> dict[str, str]:
        """Return the room types by room id."""
        return {room.id: room.type for room in self.rooms}

    def container_kinds(self) -> list[tuple[str, str]]:
        """Return the ``(container type, room type)`` of each container, in the order of ``containers``."""
        return [(container.type, self.room_types[container.room_id]) for container in self.containers]


def size_class_of(area_m2: float) -> str:
    """Return the size class of a single home with this floor area."""
    if area_m2 < SMALL_BELOW_M2:
        return "small"
    return "large" if area_m2 > LARGE_ABOVE_M2 else "medium"


def _content_hash(content: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
