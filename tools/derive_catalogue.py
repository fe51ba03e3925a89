"""Derive ``catalogue.yaml`` from ProcTHOR homes: facts for the generator, and for reading homes without asset database.

    python tools/derive_catalogue.py homes.jsonl.gz [more ...] --assets asset-database.json
    python tools/derive_catalogue.py ... --share 0 0.5 --out half.yaml --others rest.jsonl.gz

The second command derives it from half of the homes, chosen by a hash of their content, and writes the other homes to a
file: a generator that uses such a catalogue can be tested on homes that it was not fitted on.

Only aggregates are kept: counts, shares and rounded sizes. The rooms of a type are divided by floor area into six
classes of equal number, since the furniture of a room depends on its size.
"""

import argparse
import gzip
import hashlib
import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from shapely import get_coordinates, union_all
from shapely.geometry import LineString, Point, Polygon

from mrtask.homes.catalogue import CONTAINER_TYPES, Asset, is_larger
from mrtask.homes.home import SIZE_CLASSES, size_class_of
from mrtask.homes.procthor import ON_FLOOR_BELOW_M, load_asset_types, rotated_rectangle
from mrtask.sources import ROOT

CATALOGUE = ROOT / "mrtask" / "homes" / "catalogue.yaml"
MIN_CELL_M, MAX_CELL_M = 1.6, 2.2
"""ProcTHOR's range for the side of a floor plan's grid cell."""
CELL_SIDES_M = np.arange(MAX_CELL_M, MIN_CELL_M - 1e-3, -1e-3)
AREA_CLASSES = 6
AREA_QUANTILES = np.linspace(0, 1, 11)
FOOTPRINT_QUANTILES = np.linspace(0, 1, 21)
MAX_ASSETS_PER_TYPE = 12
AT_WALL_M = 0.12
GROUP_GAP_M = 0.3
"""A chair at most this far from a table or desk belongs to it."""
CHAIR_HOSTS = ("DiningTable", "Desk")
MIN_SHARE = 0.002

House = dict[str, Any]
"""A decoded house JSON."""


class _Item:
    """A piece of furniture on the floor of a room."""

    def __init__(self, raw: Mapping[str, Any], asset: Asset) -> None:
        position, turn = raw["position"], raw["rotation"]["y"]
        self.type, self.asset_id, self.size = asset.type, raw["assetId"], asset.size_m
        self.corners = rotated_rectangle(position["x"], position["z"], asset.size_m, turn)
        self.shape = Polygon(self.corners)
        self.aligned = min(turn % 90, 90 - turn % 90) < 0.1
        self.host: _Item | None = None

    def at_wall(self, walls: LineString) -> tuple[bool, bool]:
        """Say whether it stands with its back to a wall, and whether also with a side to a wall (in a corner)."""
        near = [walls.distance(Point(corner)) < AT_WALL_M for corner in self.corners]
        back = near[0] and near[1]
        return back, back and ((near[1] and near[2]) or (near[3] and near[0]))


def derive(homes: Iterable[House], assets: Mapping[str, Asset]) -> dict[str, Any]:
    """Return the catalogue as plain data, from decoded house JSONs and the asset database."""
    homes = list(homes)
    rooms = [room for home in homes for room in _rooms(home, assets)]
    edges = {
        room_type: [float(np.quantile([r["area"] for r in rooms if r["type"] == room_type], q)) for q in _class_cuts()]
        for room_type in sorted({room["type"] for room in rooms})
    }
    return {
        "homes": _home_facts(homes),
        "doors": _door_facts(homes, rooms),
        "rooms": {kind: _room_facts([r for r in rooms if r["type"] == kind], cuts) for kind, cuts in edges.items()},
        "types": _type_facts(rooms, assets, edges),
        "objects": _object_facts(rooms),
    }


def _class_cuts() -> list[float]:
    return [k / AREA_CLASSES for k in range(1, AREA_CLASSES)]


def _floor(room: Mapping[str, Any]) -> Polygon:
    return Polygon([(point["x"], point["z"]) for point in room["floorPolygon"]])


def _rooms(home: House, assets: Mapping[str, Asset]) -> Iterator[dict[str, Any]]:
    for raw in home["rooms"]:
        shape = _floor(raw)
        number = raw["id"].split("|")[1]
        items, held, small = [], [], Counter[str]()
        for thing in home["objects"]:
            asset = assets[thing["assetId"]]
            own_room = thing["id"].split("|")[0] == number
            if not own_room or thing["position"]["y"] - asset.size_m.y / 2 >= ON_FLOOR_BELOW_M:
                continue
            items.append(_Item(thing, asset))
            children = [assets[child["assetId"]].type for child in thing.get("children", [])]
            small.update({child["assetId"]: 1 for child in thing.get("children", [])})
            if asset.type in CONTAINER_TYPES:
                held.append((asset.type, sorted(set(children))))
        hosts = [item for item in items if item.type in CHAIR_HOSTS]
        for item in items:
            if item.type == "Chair" and hosts:
                nearest = min(hosts, key=lambda host: host.shape.distance(item.shape))
                item.host = nearest if nearest.shape.distance(item.shape) < GROUP_GAP_M else None
        yield {
            "type": raw["roomType"],
            "area": shape.area,
            "shape": shape,
            "items": items,
            "held": held,
            "small": small,
        }


def _home_facts(homes: list[House]) -> dict[str, Any]:
    by_class: dict[str, list[tuple[str, float]]] = defaultdict(list)
    members: dict[str, tuple[str, ...]] = {}
    share: dict[tuple[str, str], list[float]] = defaultdict(list)
    for home in homes:
        areas = [(room["roomType"], _floor(room).area) for room in home["rooms"]]
        total, spec = sum(area for _, area in areas), home["metadata"]["roomSpecId"]
        by_class[size_class_of(total)].append((spec, total))
        members[spec] = tuple(sorted(kind for kind, _ in areas))
        for kind, area in areas:
            share[spec, kind].append(area / total)
    specs = {
        spec: [{"type": kind, "area_share": round(float(np.median(share[spec, kind])), 3)} for kind in kinds]
        for spec, kinds in sorted(members.items())
    }
    classes: dict[str, dict[str, Any]] = {}
    for size_class in SIZE_CLASSES:
        entries = by_class[size_class]
        classes[size_class] = {}
        for spec, count in sorted(Counter(spec for spec, _ in entries).items()):
            totals = [total for other, total in entries if other == spec]
            quantiles = [round(float(value), 1) for value in np.quantile(totals, AREA_QUANTILES)]
            classes[size_class][spec] = {"share": round(count / len(entries), 4), "area_m2": quantiles}
    return {"footprints": _footprint_facts(homes), "specs": specs, "size_classes": classes}


def _footprint_facts(homes: list[House]) -> dict[str, dict[str, list[float]]]:
    """Return quantiles by size class: the floor plan's cell side, its share of the bounding box, the box's aspect."""
    found: dict[str, dict[str, list[float]]] = {name: {"cell_m": [], "fill": [], "aspect": []} for name in SIZE_CLASSES}
    for home in homes:
        floors = [_floor(room) for room in home["rooms"]]
        area_m2 = sum(floor.area for floor in floors)
        low_x, low_y, high_x, high_y = union_all(floors).bounds
        short_m, long_m = sorted((high_x - low_x, high_y - low_y))
        facts = found[size_class_of(area_m2)]
        facts["cell_m"].append(_cell_side_m(floors))
        facts["fill"].append(area_m2 / (short_m * long_m))
        facts["aspect"].append(long_m / short_m)
    return {
        size_class: {
            name: [round(float(value), 3) for value in np.quantile(values, FOOTPRINT_QUANTILES)]
            for name, values in facts.items()
        }
        for size_class, facts in found.items()
    }


def _cell_side_m(floors: Iterable[Polygon]) -> float:
    """Return the side of the grid cells that make up the rooms; wall distances are multiples of it."""
    coordinates = np.concatenate([get_coordinates(floor) for floor in floors])
    gaps = np.concatenate([np.diff(np.unique(np.round(values, 2))) for values in coordinates.T])
    counts = gaps[gaps > MIN_CELL_M / 2] / CELL_SIDES_M[:, None]
    return float(CELL_SIDES_M[np.argmin(np.abs(counts - np.round(counts)).max(axis=1))])


def _door_facts(homes: list[House], rooms: list[dict[str, Any]]) -> dict[str, Any]:
    widths: dict[str, list[float]] = defaultdict(list)
    joined, outside = Counter[tuple[str, ...]](), Counter[str]()
    for home in homes:
        kinds = {room["id"]: room["roomType"] for room in home["rooms"]}
        for door in home["doors"]:
            name = door["assetId"].rsplit("_", 1)[0]
            widths[name].append(abs(door["holePolygon"][1]["x"] - door["holePolygon"][0]["x"]))
            if door["room0"] == door["room1"]:
                outside[kinds[door["room0"]]] += 1
            else:
                joined[(*sorted((kinds[door["room0"]], kinds[door["room1"]])), name)] += 1
        open_walls: dict[tuple[str, ...], set[str]] = defaultdict(set)
        for wall in home["walls"]:
            if wall.get("empty"):
                open_walls[tuple(wall["id"].split("|")[-4:])].add(wall["roomId"])
        for pair in {tuple(sorted(sides)) for sides in open_walls.values() if len(sides) == 2}:
            joined[(*sorted(kinds[room] for room in pair), "opening")] += 1
    pairs: dict[str, dict[str, int]] = defaultdict(dict)
    for (first, second, name), count in sorted(joined.items()):
        pairs[f"{first}-{second}"][name] = count
    counts = Counter(room["type"] for room in rooms)
    return {
        "width_m": {name: round(float(np.median(values)), 3) for name, values in sorted(widths.items())},
        "between": dict(pairs),
        "outside_share": {kind: round(outside[kind] / counts[kind], 3) for kind in sorted(counts)},
    }


def _histogram(counts: Iterable[int]) -> list[float]:
    """Return the shares of 0, 1, 2, ..."""
    tally = Counter(counts)
    total = sum(tally.values())
    return [round(tally[n] / total, 4) for n in range(max(tally) + 1)]


def _room_facts(rooms: list[dict[str, Any]], cuts: list[float]) -> dict[str, Any]:
    classes: list[list[dict[str, Any]]] = [[] for _ in range(AREA_CLASSES)]
    for room in rooms:
        classes[int(np.searchsorted(cuts, room["area"], side="right"))].append(room)
    kinds = sorted({item.type for room in rooms for item in room["items"]})
    furniture: dict[str, list[list[float]]] = {}
    for kind in kinds:
        per_class = [
            _histogram(sum(item.type == kind and item.host is None for item in room["items"]) for room in members)
            for members in classes
        ]
        if any(len(histogram) > 1 for histogram in per_class):
            furniture[kind] = per_class
    chairs: dict[str, list[list[float]]] = {}
    for host in CHAIR_HOSTS:
        per_host = [
            [
                sum(other.host is item for other in room["items"])
                for room in members
                for item in room["items"]
                if item.type == host
            ]
            for members in classes
        ]
        if any(per_host):
            chairs[host] = [_histogram(counts) if counts else [1.0] for counts in per_host]
    return {"area_classes_m2": [round(cut, 2) for cut in cuts], "furniture": furniture, "chairs_at": chairs}


def _type_facts(
    rooms: list[dict[str, Any]], assets: Mapping[str, Asset], edges: Mapping[str, list[float]]
) -> dict[str, Any]:
    used: dict[str, Counter[str]] = defaultdict(Counter)
    # By type and whether the room is in the larger half of its kind: in small rooms more furniture stands in corners.
    back, corner, total = (Counter[tuple[str, bool]]() for _ in range(3))
    for room in rooms:
        walls = room["shape"].exterior
        larger = is_larger(room["area"], edges[room["type"]])
        for item in room["items"]:
            used[item.type][item.asset_id] += 1
            total[item.type, larger] += 1
            at_back, at_corner = item.at_wall(walls)
            back[item.type, larger] += at_back
            corner[item.type, larger] += at_corner
        for asset_id, count in room["small"].items():
            used[assets[asset_id].type][asset_id] += count
    facts = {}
    for kind in sorted({asset.type for asset in assets.values()}):
        own = {name: asset for name, asset in assets.items() if asset.type == kind}
        on_floor = total[kind, False] + total[kind, True] > 0
        names = _representative(used[kind] or Counter(sorted(own)[:1]), own, MAX_ASSETS_PER_TYPE if on_floor else 1)
        sizes = np.array([own[name].size_m for name in (used[kind].elements() if used[kind] else own)])
        entry: dict[str, Any] = {
            "size_m": [round(float(v), 2) for v in np.median(sizes, axis=0)],
            "spread_m": [round(float(v), 2) for v in np.std(sizes, axis=0)],
            "assets": {name: [max(round(side, 2), 0.01) for side in own[name].size_m] for name in names},
        }
        if on_floor:
            for name, counts in (("back_at_wall", back), ("in_corner", corner)):
                entry[name] = [
                    round(sum(counts[kind, half] for half in halves) / sum(total[kind, half] for half in halves), 2)
                    for halves in ([half] if total[kind, half] else [False, True] for half in (False, True))
                ]
        entry["size_m"] = [max(side, 0.01) for side in entry["size_m"]]
        facts[kind] = entry
    return facts


def _representative(used: Counter[str], own: Mapping[str, Asset], number: int) -> list[str]:
    """Pick assets at evenly spaced quantiles of footprint area, so that uniform draws keep the spread of sizes."""
    ranked = sorted(used.elements(), key=lambda name: (own[name].size_m.x * own[name].size_m.z, name))
    places = (np.arange(number) + 0.5) / number * len(ranked)
    return list(dict.fromkeys(ranked[int(place)] for place in places))


def _object_facts(rooms: list[dict[str, Any]]) -> dict[str, Any]:
    counts: dict[tuple[str, str], list[int]] = defaultdict(list)
    present: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    for room in rooms:
        for container, held in room["held"]:
            counts[room["type"], container].append(len(held))
            present[room["type"], container].update(held)
    facts: dict[str, dict[str, Any]] = defaultdict(dict)
    for (room_type, container), numbers in sorted(counts.items()):
        shares = {kind: round(n / len(numbers), 3) for kind, n in present[room_type, container].most_common()}
        facts[room_type][container] = {
            "distinct_objects": _histogram(numbers),
            "likelihoods": {kind: share for kind, share in shares.items() if share >= MIN_SHARE},
        }
    return dict(facts)


def place(house: House) -> float:
    """Return a number from 0 up to 1 that depends on the house's content alone, for shares of houses."""
    text = json.dumps(house, sort_keys=True, separators=(",", ":"))
    return int(hashlib.sha256(text.encode()).hexdigest()[:13], 16) / 16**13


def divide(houses: Iterable[House], low: float, high: float) -> tuple[list[House], list[House]]:
    """Return the houses whose `place` is from ``low`` up to ``high``, and the others."""
    inside, outside = [], []
    for house in houses:
        (inside if low <= place(house) < high else outside).append(house)
    return inside, outside


def _read(files: Iterable[Path]) -> Iterator[House]:
    for file in files:
        with gzip.open(file, "rt", encoding="utf-8") as lines:
            yield from (json.loads(line) for line in lines)


def main() -> None:
    """Write the catalogue to ``--out``, by default its place in the library."""
    parser = argparse.ArgumentParser(description="derive the furniture catalogue from ProcTHOR homes")
    parser.add_argument("files", nargs="+", type=Path, help=".jsonl.gz files of ProcTHOR houses")
    parser.add_argument("--assets", required=True, type=Path, help="ProcTHOR's asset-database.json")
    parser.add_argument("--out", type=Path, default=CATALOGUE)
    shares = {"nargs": 2, "type": float, "default": (0.0, 1.0), "metavar": ("LOW", "HIGH")}
    parser.add_argument("--share", **shares, help="derive it from this share of the homes only, by their content")
    parser.add_argument("--others", type=Path, help="write the other homes to this .jsonl.gz file")
    arguments = parser.parse_args()
    low, high = arguments.share
    if not 0 <= low < high <= 1:
        parser.error(f"--share {low:g} {high:g}: give two numbers from 0 to 1, the smaller one first")
    houses, others = divide(_read(arguments.files), low, high)
    if not houses:
        parser.error(f"--share {low:g} {high:g}: none of the {len(others)} homes is in this share; give a larger one")
    facts = derive(houses, load_asset_types(arguments.assets))
    if arguments.others is not None:
        with gzip.open(arguments.others, "wt", encoding="utf-8") as file:
            file.writelines(json.dumps(house) + "\n" for house in others)
    schema = f"{len(houses)} homes in ProcTHOR's schema"
    header = f"# Facts on {schema}, made by `python tools/derive_catalogue.py`; NOTICE names the homes.\n"
    text = yaml.safe_dump(facts, sort_keys=False, default_flow_style=None, width=120)
    arguments.out.write_text(header + text, encoding="utf-8")


if __name__ == "__main__":
    main()
