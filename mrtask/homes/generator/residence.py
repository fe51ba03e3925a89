"""Generate residences: flats of the generator along corridors, with a lift lobby, a common kitchen and a laundry.

A residence depends only on its seed and its size. Its flats are small and medium homes. The common kitchen is furnished
as the catalogue's kitchens are; what lies in the laundry and in the lobby is drawn as in bathrooms and living rooms.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mrtask.errors import InputError
from mrtask.homes.catalogue import CONTAINER_TYPES, Catalogue, load_catalogue
from mrtask.homes.generator.furnishing import furnish_room
from mrtask.homes.generator.house import House, furniture_json, generate_house
from mrtask.homes.generator.residence_size import TOLERANCE, ResidenceSize, floors_of
from mrtask.homes.generator.site import CommonRoom, Flat, Segment, extent_m, join_flats, make_flat
from mrtask.homes.home import LIFT_LOBBY, RESIDENCE, Home, Polygon
from mrtask.homes.procthor import MAX_EXTENT_M, parse_house

FLAT_CLASSES: Mapping[str, float] = {"small": 0.6, "medium": 0.4}
"""The size classes of the flats, and how often each is drawn."""
CONTAINERS_PER_FLOOR = 13.0
"""About how many containers the common rooms of a floor have."""
COMMON_KITCHEN, LAUNDRY = "CommonKitchen", "Laundry"
COMMON_ROOMS = (CommonRoom("kitchen", COMMON_KITCHEN, 5.0, 5.0), CommonRoom("laundry", LAUNDRY, 4.0, 3.5))
FURNISHED_LIKE: Mapping[str, str] = {COMMON_KITCHEN: "Kitchen", LAUNDRY: "Bathroom", LIFT_LOBBY: "LivingRoom"}
"""The catalogue's room type after which the contents of a common room are drawn."""
OWN_FURNITURE: Mapping[str, Mapping[str, int]] = {
    LAUNDRY: {"WashingMachine": 3, "Sink": 1, "SideTable": 1, "Dresser": 1, "GarbageCan": 1},
    LIFT_LOBBY: {"Sofa": 1, "SideTable": 1, "GarbageCan": 1, "HousePlant": 1},
}
"""The furniture of the common rooms that no home has."""
TRIES = 40
RESIDENCE_STREAM = 7
"""Part of the random key, so that a residence shares no random numbers with the home of the same seed."""


def generate_residence(seed: int, size: ResidenceSize | None = None) -> House:
    """Generate the residence of a seed as house JSON of schema 1.0.0, by default one of about 100 containers.

    Raises:
        InputError: no residence of this size was found.
    """
    size = size or ResidenceSize()
    for attempt in range(TRIES):
        house = _draw(np.random.default_rng([seed, RESIDENCE_STREAM, attempt]), size)
        if house is not None and max(extent_m(house)) <= MAX_EXTENT_M:
            house["metadata"]["seed"] = seed
            return house
    raise InputError(f"no residence of {size} was found in {TRIES} tries; ask for another size")


def generate_residence_home(seed: int, size: ResidenceSize | None = None) -> Home:
    """Generate the residence of a seed as a `Home`; takes and raises what `generate_residence` does."""
    return parse_house(generate_residence(seed, size), None, RESIDENCE, seed)


def _draw(rng: np.random.Generator, size: ResidenceSize) -> House | None:
    """Return a residence of this size; None if with one flat less it is too small, and with that flat too large."""
    catalogue, furnishing_seed = _with_common_rooms(load_catalogue()), int(rng.integers(2**63))

    def join(drawn: Sequence[Flat]) -> House:
        furnishing = np.random.default_rng(furnishing_seed)

        def furnish(name: str, kind: str, outline: Polygon, openings: Sequence[Segment]) -> list[dict[str, Any]]:
            pieces = furnish_room(kind, outline, openings, catalogue, furnishing)
            return furniture_json(pieces, name, kind, catalogue, furnishing)

        return join_flats(drawn, size.most_a_side, COMMON_ROOMS, furnish)

    if size.flats is not None:
        return join([_draw_flat(rng) for _ in range(size.flats)])
    drawn: list[Flat] = []
    expected = 0.0
    while expected < size.containers:
        drawn.append(_draw_flat(rng))
        in_flats = sum(_containers_in(flat.house) for flat in drawn)
        expected = in_flats + CONTAINERS_PER_FLOOR * floors_of(len(drawn), size.most_a_side)
    last_change = 0
    while True:
        house = join(drawn)
        missing = size.containers - _containers_in(house)
        if abs(missing) <= TOLERANCE * size.containers:
            return house
        change = 1 if missing > 0 else -1
        if change == -last_change or len(drawn) + change < 1:
            return None
        last_change = change
        drawn = [*drawn, _draw_flat(rng)] if change > 0 else drawn[:-1]


def _draw_flat(rng: np.random.Generator) -> Flat:
    """Return a flat; a home with no clear way out is drawn again."""
    for _ in range(TRIES):
        size_class = str(rng.choice(list(FLAT_CLASSES), p=list(FLAT_CLASSES.values())))
        house = generate_house(int(rng.integers(2**63)), size_class)
        if (flat := make_flat(house, parse_house(house, None, "flat", None))) is not None:
            return flat
    raise InputError(f"none of {TRIES} homes has a way out")


def _containers_in(house: House) -> int:
    return sum(one["id"].partition("|")[0] in CONTAINER_TYPES for one in house["objects"])


def _with_common_rooms(catalogue: Catalogue) -> Catalogue:
    """Return the catalogue with the common rooms as room types of their own."""
    rooms, objects = dict(catalogue.rooms), dict(catalogue.objects)
    for kind, like in FURNISHED_LIKE.items():
        objects[kind] = objects[like]
        rooms[kind] = _exactly(OWN_FURNITURE[kind]) if kind in OWN_FURNITURE else rooms[like]
    return replace(catalogue, rooms=rooms, objects=objects)


def _exactly(furniture: Mapping[str, int]) -> dict[str, Any]:
    """Return the catalogue's entry of a room type that holds this furniture whatever its area."""
    shares = {kind: [[0.0] * count + [1.0]] for kind, count in furniture.items()}
    return {"area_classes_m2": [math.inf], "furniture": shares, "chairs_at": {}}
