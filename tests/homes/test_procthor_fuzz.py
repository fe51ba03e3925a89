"""House JSON damaged at random: a clear error or a home that is fit for use, never a crash or silent nonsense."""

import copy
import json
import math
import re

from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon

from mrtask.homes.generator.house import generate_house
from mrtask.homes.procthor import HouseError, parse_house
from mrtask.maps.home_map import build_map

HOUSE = generate_house(11, "small")

ODD_VALUES = st.one_of(
    st.sampled_from(
        [
            None,
            True,
            math.nan,
            math.inf,
            -math.inf,
            1e308,
            -1e308,
            2**80,
            -1,
            0,
            0.0,
            "",
            "x",
            "NaN",
            "room|99",
            [],
            {},
            [[]],
        ]
    ),
    st.floats(),
    st.integers(-(10**30), 10**30),
    st.text(max_size=8),
    st.lists(st.floats(-1, 1), max_size=4),
)


def places(value, path=()):
    """All paths into a JSON value, but for what the reader does not look at."""
    if path:
        yield path
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in entries:
        if path or key in ("rooms", "doors", "walls", "objects"):
            yield from places(child, (*path, key))


PLACES = list(places(HOUSE))


@st.composite
def damaged_houses(draw):
    house = copy.deepcopy(HOUSE)
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(PLACES))
        target = house
        try:
            for key in path[:-1]:
                target = target[key]
            change = draw(st.sampled_from(["replace", "delete", "double", "swap"]))
            if change == "delete":
                del target[path[-1]]
            elif change == "double" and isinstance(target, list):
                target.append(copy.deepcopy(target[path[-1]]))
            elif change == "swap" and isinstance(target, list):
                target[path[-1]], target[0] = target[0], target[path[-1]]
            else:
                target[path[-1]] = draw(ODD_VALUES)
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change removed the place
    return house


@given(house=damaged_houses())
@example(house={**HOUSE, "objects": HOUSE["objects"] * 2})
@settings(deadline=None, max_examples=400, suppress_health_check=[HealthCheck.too_slow])
def test_damaged_houses(house):
    try:
        home = parse_house(house, None, "homes.jsonl.gz", 12)
    except HouseError as error:
        assert re.match(r"homes\.jsonl\.gz, line 13: \S", str(error))
        assert error.problem
        return
    check_usable(home)


@given(
    text=st.recursive(
        ODD_VALUES, lambda inner: st.lists(inner) | st.dictionaries(st.text(max_size=6), inner), max_leaves=12
    )
)
@settings(deadline=None, max_examples=200)
def test_any_json(text):
    try:
        parse_house(json.loads(json.dumps(text)), None, "f", 0)
    except HouseError:
        return
    raise AssertionError("this is no house")


def check_usable(home):
    """What every later stage relies on."""
    rooms = {room.id: Polygon(room.polygon) for room in home.rooms}
    assert len(rooms) == len(home.rooms)
    assert all(shape.is_valid and shape.area > 0 for shape in rooms.values())
    assert home.containers
    assert len({container.id for container in home.containers}) == len(home.containers)
    for container in home.containers:
        assert container.room_id in rooms
        assert all(math.isfinite(value) for point in container.footprint for value in point)
        assert list(container.objects) == sorted(set(container.objects))
    for door in home.doors:
        assert set(door.rooms) <= set(rooms)
        assert all(math.isfinite(value) for point in (door.start, door.end) for value in point)
    home_map = build_map(home, 0.1)
    assert home_map.travel_m.shape == (len(home.containers), len(home.containers))
