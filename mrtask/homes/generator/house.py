"""Generate homes after ProcTHOR's method, as house JSON for our reader and for ProcTHOR's own tools.

Source: Deitke et al. 2022: room specification -> floor plan -> doors and openings along the room graph -> furniture by
room type -> objects by room, container and object. The likelihoods come from the catalogue. A home depends only on its
seed and the two size arguments.
"""

import gzip
import json
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np

from mrtask.files import replacing
from mrtask.homes.catalogue import CONTAINER_TYPES, Catalogue, load_catalogue
from mrtask.homes.contents import draw_objects
from mrtask.homes.generator.floor_plan import OUTSIDE, FloorPlan, Wall, make_floor_plan
from mrtask.homes.generator.furnishing import Piece, Segment, furnish_room
from mrtask.homes.home import LARGE_ABOVE_M2, SIZE_CLASSES, SMALL_BELOW_M2, Point

SCHEMA = "1.0.0"
MAX_ROOMS = 10
FIRST_ROOM_NUMBER = 2
"""ProcTHOR reserves 0 and 1 for the outside."""
CLASS_AREAS_M2 = {
    "small": (15.0, SMALL_BELOW_M2),
    "medium": (SMALL_BELOW_M2, LARGE_ABOVE_M2),
    "large": (LARGE_ABOVE_M2, 400.0),
}
AREA_MARGIN_M2 = 0.5
"""The distance from the borders of the size classes, so that rounding does not cross them."""
ROOM_AREA_M2 = (15.0, 32.0)
"""The mean floor area per room if only the number of rooms is given."""
MIN_ROOM_AREA_M2 = 5.0
WALL_HEIGHT_M = 3.0
DOOR_HEIGHT_M = 2.1
DOOR_MARGIN_M = 0.12
"""The length of wall that remains beside a door."""
OPENING = "opening"
EXTRA_JOINT_SHARE = 0.05
"""The share of neighbouring pairs of rooms that are joined although a way between them exists already."""
FURNISHINGS_TRIED = 8
HOUSES_TRIED = 20

House = dict[str, Any]


@dataclass(frozen=True)
class _Door:
    wall: Wall
    asset_id: str
    low_m: float
    high_m: float

    @property
    def segment(self) -> Segment:
        """Return the opening on the floor plane."""
        return _point_along(self.wall, self.low_m), _point_along(self.wall, self.high_m)


def generate_house(seed: int, size_class: str | None = None, rooms: int | None = None) -> House:
    """Generate a house JSON of schema 1.0.0 with object ids ``Type|room|n``.

    ``size_class`` is ``small``, ``medium`` or ``large`` (default: drawn evenly, or according to ``rooms``). ``rooms``
    is 1 to 10 (default: as in ProcTHOR's homes of that class). A house into which no container fits is drawn again.
    Raises `ValueError` for other values.
    """
    if size_class is not None and size_class not in SIZE_CLASSES:
        raise ValueError(f"size_class '{size_class}' is unknown; allowed: {', '.join(SIZE_CLASSES)}")
    if rooms is not None and not 1 <= rooms <= MAX_ROOMS:
        raise ValueError(f"rooms = {rooms} is not allowed; choose 1 to {MAX_ROOMS}")
    key = [seed, SIZE_CLASSES.index(size_class) + 1 if size_class else 0, rooms or 0]
    for attempt in range(HOUSES_TRIED):
        house = _draw_house(seed, size_class, rooms, np.random.default_rng([*key, attempt] if attempt else key))
        if house is not None:
            return house
    of = f" of {rooms} rooms" if rooms else ""
    raise ValueError(f"no container fitted into {HOUSES_TRIED} homes{of}; ask for a larger size class or fewer rooms")


def write_houses(path: Path, houses: Iterable[House]) -> int:
    """Write houses as gzipped JSON lines and return their number. The file appears complete or not at all."""
    count = 0
    # The header has no name and no time, so that equal houses give equal files.
    with (
        replacing(path) as temporary,
        temporary.open("wb") as raw,
        gzip.GzipFile("", "wb", fileobj=raw, mtime=0) as packed,
    ):
        for house in houses:
            packed.write(json.dumps(house, separators=(",", ":")).encode() + b"\n")
            count += 1
    return count


def _draw_house(seed: int, size_class: str | None, rooms: int | None, rng: np.random.Generator) -> House | None:
    """Return a house, or None where no container fits into it."""
    catalogue = load_catalogue()
    spec_id, specs, area_m2 = _draw_spec(catalogue, size_class, rooms, rng)
    types = [spec["type"] for spec in specs]
    plan = make_floor_plan([spec["area_share"] for spec in specs], area_m2, rng)
    doors, open_walls = _join_rooms(plan, types, catalogue, rng)
    objects = _furnish(plan, types, doors, open_walls, catalogue, rng)
    if objects is None:
        return None
    return {
        "rooms": [_room_json(plan, room, kind) for room, kind in enumerate(types)],
        "doors": [_door_json(door, number) for number, door in enumerate(doors)],
        "windows": [],
        "walls": [entry for wall in plan.walls for entry in _wall_json(wall, wall in open_walls)],
        "objects": objects,
        "proceduralParameters": {"lights": [], "reflections": [], "skyboxId": "Sky1"},
        "metadata": {"schema": SCHEMA, "roomSpecId": spec_id, "seed": seed},
    }


def _draw_spec(
    catalogue: Catalogue, size_class: str | None, rooms: int | None, rng: np.random.Generator
) -> tuple[str, Sequence[dict[str, Any]], float]:
    """Return the specification's name, its rooms' types and shares of the area, and the area."""
    if size_class is None and rooms is not None:
        return *_spec_with(catalogue, rooms, rng), rooms * float(rng.uniform(*ROOM_AREA_M2))
    size_class = size_class or SIZE_CLASSES[int(rng.integers(len(SIZE_CLASSES)))]
    entries = catalogue.homes["size_classes"][size_class]
    shares = np.array([entry["share"] for entry in entries.values()])
    drawn = list(entries)[int(rng.choice(len(entries), p=shares / shares.sum()))]
    quantiles = entries[drawn]["area_m2"]
    area_m2 = float(np.interp(rng.random(), np.linspace(0, 1, len(quantiles)), quantiles))
    low_m2, high_m2 = CLASS_AREAS_M2[size_class]
    low_m2 = max(low_m2 + AREA_MARGIN_M2, MIN_ROOM_AREA_M2 * (rooms or 0))
    area_m2 = min(max(area_m2, low_m2), high_m2 - AREA_MARGIN_M2)
    if rooms is None:
        return drawn, catalogue.homes["specs"][drawn], area_m2
    return *_spec_with(catalogue, rooms, rng), area_m2


def _spec_with(catalogue: Catalogue, rooms: int, rng: np.random.Generator) -> tuple[str, Sequence[dict[str, Any]]]:
    """Return a specification with this many rooms.

    If no specification has this many, leave some rooms out of a larger one.
    """
    specs = catalogue.homes["specs"]
    enough = min(len(spec) for spec in specs.values() if len(spec) >= rooms)
    fitting = [name for name, spec in specs.items() if len(spec) == enough]
    name = fitting[int(rng.integers(len(fitting)))]
    kept = sorted(rng.permutation(enough)[:rooms])
    return name, [specs[name][index] for index in kept]


def _join_rooms(
    plan: FloorPlan, types: Sequence[str], catalogue: Catalogue, rng: np.random.Generator
) -> tuple[list[_Door], frozenset[Wall]]:
    """Return the doors and the opened walls.

    They follow a spanning tree of the room graph that prefers usual pairs. The doors include the front door.
    """
    shared: dict[tuple[int, int], list[Wall]] = defaultdict(list)
    for wall in plan.walls:
        if wall.rooms[1] != OUTSIDE:
            shared[wall.rooms].append(wall)
    graph = nx.Graph()
    graph.add_nodes_from(range(len(types)))
    for first, second in shared:
        usual = sum(_joint_counts(catalogue, types[first], types[second]).values()) + 1
        graph.add_edge(first, second, cost=-math.log(usual) + rng.gumbel())
    joined = {tuple(sorted(edge, reverse=True)) for edge in nx.minimum_spanning_edges(graph, weight="cost", data=False)}
    joined |= {pair for pair in shared if rng.random() < EXTRA_JOINT_SHARE}
    doors: list[_Door] = []
    open_walls: set[Wall] = set()
    for pair in sorted(joined):
        longest = max(shared[pair], key=lambda wall: wall.length_m)
        counts = _joint_counts(catalogue, types[pair[0]], types[pair[1]]) or {OPENING: 1}
        widths = {name: catalogue.doors["width_m"].get(name, 0.0) for name in counts}
        fitting = [name for name in counts if widths[name] + 2 * DOOR_MARGIN_M <= longest.length_m] or [OPENING]
        shares = np.array([counts.get(name, 1) for name in fitting], dtype=np.float64)
        kind = fitting[int(rng.choice(len(fitting), p=shares / shares.sum()))]
        if kind == OPENING:
            open_walls.update(shared[pair])
        else:
            doors.append(_place_door(longest, kind, widths[kind], rng))
    return [*doors, *_front_door(plan, types, catalogue, rng)], frozenset(open_walls)


def _joint_counts(catalogue: Catalogue, first: str, second: str) -> dict[str, int]:
    """Return how often each kind of door joins two room types."""
    counts: dict[str, int] = catalogue.doors["between"].get("-".join(sorted((first, second))), {})
    return counts


def _place_door(wall: Wall, kind: str, width_m: float, rng: np.random.Generator) -> _Door:
    # On a wall that is just long enough, rounding could put the highest place below the lowest.
    highest_m = max(wall.length_m - DOOR_MARGIN_M - width_m, DOOR_MARGIN_M)
    low_m = round(float(rng.uniform(DOOR_MARGIN_M, highest_m)), 3)
    return _Door(wall, f"{kind}_1", low_m, low_m + width_m)


def _front_door(plan: FloorPlan, types: Sequence[str], catalogue: Catalogue, rng: np.random.Generator) -> list[_Door]:
    """Return one door to the outside, in a usual room with a long enough outer wall.

    Return no door if no wall is long enough.
    """
    kind = "Doorway"
    width_m = catalogue.doors["width_m"][kind]
    outer = [w for w in plan.walls if w.rooms[1] == OUTSIDE and w.length_m >= width_m + 2 * DOOR_MARGIN_M]
    if not outer:
        return []
    shares = np.array([catalogue.doors["outside_share"][types[wall.rooms[0]]] + 1e-6 for wall in outer])
    return [_place_door(outer[int(rng.choice(len(outer), p=shares / shares.sum()))], kind, width_m, rng)]


def _furnish(
    plan: FloorPlan,
    types: Sequence[str],
    doors: Sequence[_Door],
    open_walls: frozenset[Wall],
    catalogue: Catalogue,
    rng: np.random.Generator,
) -> list[dict[str, Any]] | None:
    """Return the objects of all rooms.

    In the rare case that no object is a container, they are drawn again, a few times; None if that does not help.
    """
    openings: list[list[Segment]] = [[] for _ in types]
    for room in range(len(types)):
        openings[room] += [door.segment for door in doors if room in door.wall.rooms]
        openings[room] += [(wall.start, wall.end) for wall in plan.walls if wall in open_walls and room in wall.rooms]
    for _ in range(FURNISHINGS_TRIED):
        objects: list[dict[str, Any]] = []
        has_container = False
        for room, kind in enumerate(types):
            pieces = furnish_room(kind, plan.rooms[room], openings[room], catalogue, rng)
            has_container |= any(piece.type in CONTAINER_TYPES for piece in pieces)
            objects += _object_json(pieces, room + FIRST_ROOM_NUMBER, kind, catalogue, rng)
        if has_container:
            return objects
    return None


def _object_json(
    pieces: Sequence[Piece], room: int, room_type: str, catalogue: Catalogue, rng: np.random.Generator
) -> list[dict[str, Any]]:
    objects = []
    smalls = 0
    for number, piece in enumerate(pieces):
        children = []
        for kind in draw_objects(catalogue, room_type, piece.type, rng):
            asset_id, asset = next((name, catalogue.assets[name]) for name in catalogue.types[kind]["assets"])
            x, y = piece.center
            position = {"x": x, "y": round(piece.size_m.y + asset.size_m.y / 2, 3), "z": y}
            rotation = {"x": 0, "y": piece.rotation_deg, "z": 0}
            children.append(
                {
                    "id": f"{kind}|surface|{room}|{smalls}",
                    "assetId": asset_id,
                    "position": position,
                    "rotation": rotation,
                    "kinematic": False,
                }
            )
            smalls += 1
        objects.append(
            {
                "id": f"{piece.type}|{room}|{number}",
                "assetId": piece.asset_id,
                "position": {"x": piece.center[0], "y": round(piece.size_m.y / 2, 3), "z": piece.center[1]},
                "rotation": {"x": 0, "y": piece.rotation_deg, "z": 0},
                "kinematic": True,
                "children": children,
            }
        )
    return objects


def _point_along(wall: Wall, distance_m: float) -> Point:
    share = distance_m / wall.length_m
    (x0, y0), (x1, y1) = wall.start, wall.end
    return (x0 + share * (x1 - x0), y0 + share * (y1 - y0))


def _vector(point: Point, height_m: float = 0.0) -> dict[str, float]:
    return {"x": point[0], "y": height_m, "z": point[1]}


def _room_json(plan: FloorPlan, room: int, kind: str) -> dict[str, Any]:
    return {
        "id": _room_id(room),
        "roomType": kind,
        "floorPolygon": [_vector(point) for point in plan.rooms[room]],
        "children": [],
        "ceilings": [],
    }


def _room_id(room: int) -> str:
    return f"room|{room + FIRST_ROOM_NUMBER}"


def _wall_id(room: int, wall: Wall) -> str:
    name = "exterior" if room == OUTSIDE else str(room + FIRST_ROOM_NUMBER)
    return "|".join(["wall", name, *(f"{value:.2f}" for value in (*wall.start, *wall.end))])


def _wall_json(wall: Wall, is_open: bool) -> list[dict[str, Any]]:
    """Return the wall's two sides. Each follows its room's outline, hence they run in opposite directions."""
    sides = []
    for room, (start, end) in zip(wall.rooms, ((wall.start, wall.end), (wall.end, wall.start)), strict=True):
        corners = [_vector(point, height_m) for height_m in (0.0, WALL_HEIGHT_M) for point in (start, end)]
        owner = wall.rooms[0] if room == OUTSIDE else room
        side: dict[str, Any] = {"id": _wall_id(room, wall), "roomId": _room_id(owner), "polygon": corners}
        sides.append({**side, "empty": True} if is_open else side)
    return sides


def _door_json(door: _Door, number: int) -> dict[str, Any]:
    first, second = door.wall.rooms
    middle_m = round((door.low_m + door.high_m) / 2, 3)
    return {
        "id": f"door|{number}",
        "room0": _room_id(first),
        "room1": _room_id(first if second == OUTSIDE else second),
        "wall0": _wall_id(first, door.wall),
        "wall1": _wall_id(second, door.wall),
        "assetId": door.asset_id,
        "assetPosition": {"x": middle_m, "y": DOOR_HEIGHT_M / 2, "z": 0},
        "holePolygon": [{"x": door.low_m, "y": 0, "z": 0}, {"x": door.high_m, "y": DOOR_HEIGHT_M, "z": 0}],
        "openable": second != OUTSIDE,
        "openness": int(second != OUTSIDE),
    }
