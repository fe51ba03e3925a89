"""Residences: flats of the generator along corridors, and a user's own homes joined to one site."""

import json
import math
import re
from dataclasses import replace
from functools import cache

import pytest
from shapely.geometry import Polygon

from mrtask.errors import InputError
from mrtask.homes.catalogue import load_catalogue
from mrtask.homes.contents import object_probs
from mrtask.homes.generator.house import generate_house
from mrtask.homes.generator.residence import FURNISHED_LIKE, generate_residence
from mrtask.homes.generator.residence_size import TOLERANCE, ResidenceSize
from mrtask.homes.generator.site import id_in_flat, join_homes
from mrtask.homes.home import CORRIDOR, LIFT_LOBBY, RESIDENCE, Home, Room
from mrtask.homes.procthor import parse_house, read_with_json
from mrtask.maps.home_map import build_map
from tests.homes.generator.test_house import check_home

SEEDS = (0, 1, 2)


@cache
def house_of(seed):
    return generate_residence(seed, ResidenceSize(50))


@cache
def residence_of(seed):
    return parse_house(house_of(seed), None, RESIDENCE, seed)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_residence_is_a_valid_home_of_its_size_with_everything_in_reach(seed):
    home = residence_of(seed)
    check_home(home)
    assert abs(len(home.containers) - 50) <= TOLERANCE * 50
    ids = [thing.id for part in (home.rooms, home.doors, home.containers, home.obstacles) for thing in part]
    assert len(set(ids)) == len(ids)
    assert home.size_class == RESIDENCE
    assert build_map(home).reachable.all(), build_map(home).out_of_reach(home)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_common_rooms_hold_what_the_catalogue_says(seed):
    home = residence_of(seed)
    kinds = {room.type for room in home.rooms}
    assert {CORRIDOR, *FURNISHED_LIKE} <= kinds
    common = [one for one in home.containers if home.room_types[one.room_id] in FURNISHED_LIKE]
    assert {home.room_types[one.room_id] for one in common} == set(FURNISHED_LIKE)
    for container in common:
        like = FURNISHED_LIKE[home.room_types[container.room_id]]
        assert set(container.objects) <= set(object_probs(load_catalogue(), like, container.type))
    assert any(one.objects for one in common)


def test_the_seed_decides_and_json_keeps_a_residence(tmp_path):
    assert generate_residence(0, ResidenceSize(50)) == house_of(0)
    assert len({residence_of(seed).id for seed in SEEDS}) == len(SEEDS)
    (tmp_path / "one.json").write_text(json.dumps(house_of(0)))
    ((_, home),) = read_with_json([tmp_path / "one.json"])
    assert (home.id, home.size_class) == (residence_of(0).id, RESIDENCE)


def test_flats_are_asked_for_by_number_and_share_the_floors():
    home = parse_house(generate_residence(5, ResidenceSize(flats=3, flats_per_side=1)), None, RESIDENCE, 0)
    flats = {room.id.partition("|")[2].partition(".")[0] for room in home.rooms if "." in room.id}
    assert flats == {"1", "2", "3"}
    assert sum(room.type == CORRIDOR for room in home.rooms) == 2, "two flats on each floor at most"


@pytest.mark.parametrize(
    ("size", "said"),
    (
        ({"containers": 49}, "containers = 49 is not allowed; choose 50 to 500"),
        ({"flats": 1}, "flats = 1 is not allowed; choose 2 to 64"),
        ({"flats_per_side": 9}, "flats_per_side = 9 is not allowed; choose 1 to 8"),
        (
            {"flats": 30, "flats_per_side": 2},
            "flats_per_side = 2 makes 8 floors of 30 flats, and a residence has at most 4; choose 4 to 8",
        ),
    ),
)
def test_sizes_that_no_residence_has_are_refused(size, said):
    with pytest.raises(InputError, match=re.escape(said)):
        ResidenceSize(**size)


def test_only_a_large_home_with_lobby_and_corridor_is_a_residence():
    def home_of(*rooms):
        return Home("t", tuple(Room(str(n), kind, outline) for n, (kind, outline) in enumerate(rooms)), (), (), ())

    hall = ((0.0, 0.0), (0.0, 10.0), (20.0, 10.0), (20.0, 0.0))
    closet = ((20.0, 0.0), (20.0, 1.0), (21.0, 1.0), (21.0, 0.0))
    assert home_of((CORRIDOR, hall), (LIFT_LOBBY, closet)).size_class == RESIDENCE
    assert home_of((CORRIDOR, hall), ("Bedroom", closet)).size_class == "large"
    assert home_of((CORRIDOR, closet), (LIFT_LOBBY, closet)).size_class == "small"


@cache
def own_homes():
    houses = [generate_house(seed, "small") for seed in (1, 2, 3)]
    return [(house, parse_house(house, None, "own", number)) for number, house in enumerate(houses)]


def test_joined_homes_keep_their_rooms_their_contents_and_their_ids():
    site = parse_house(join_homes(own_homes()), None, "site", 0)
    check_home(site)
    assert site.size_class == RESIDENCE
    assert build_map(site).reachable.all()
    found = {container.id: container for container in site.containers}
    areas = {room.id: Polygon(room.polygon).area for room in site.rooms}
    assert len(found) == sum(len(home.containers) for _, home in own_homes())
    for number, (_, home) in enumerate(own_homes(), start=1):
        for room in home.rooms:
            assert areas[id_in_flat(room.id, number)] == pytest.approx(Polygon(room.polygon).area, abs=1e-3)
        for before in home.containers:
            after = found[id_in_flat(before.id, number)]
            kept = replace(after, id=before.id, room_id=before.room_id, footprint=before.footprint)
            assert (kept, after.room_id) == (before, id_in_flat(before.room_id, number))
            assert Polygon(after.footprint).area == pytest.approx(Polygon(before.footprint).area, abs=1e-3)
    alone = parse_house(join_homes(own_homes()[:2]), None, "site", 0)
    assert {one.id for one in alone.containers} == {name for name in found if re.match(r"\w+\|[12]\.", name)}


def shut(house):
    """The house without its doors to the outside."""
    return {**house, "doors": [door for door in house["doors"] if door["room0"] != door["room1"]]}


def test_a_home_without_an_outside_door_gets_one_where_no_furniture_stands():
    houses = [shut(house) for house, _ in own_homes()]
    site = parse_house(join_homes([(house, parse_house(house, None, "own", 0)) for house in houses]), None, "site", 0)
    assert build_map(site).reachable.all()


def test_a_home_that_cannot_be_entered_is_refused():
    house = shut(own_homes()[0][0])
    home = parse_house(house, None, "own.json", 0)
    everywhere = replace(home.containers[0], footprint=((-50.0, -50.0), (-50.0, 50.0), (50.0, 50.0), (50.0, -50.0)))
    with pytest.raises(InputError, match=r"own\.json: home 1 of 1 cannot be joined: it has no outside door"):
        join_homes([(house, replace(home, containers=(everywhere,)))])


def test_a_site_wider_than_a_home_may_be_is_refused():
    with pytest.raises(InputError, match=r"with up to 20 on a side .* 100 m are allowed; give fewer homes, or fewer"):
        join_homes([own_homes()[0]] * 40, flats_per_side=20)


@pytest.mark.parametrize(
    ("name", "in_flat"),
    (
        ("Bed|2|0", "Bed|3.2|0"),
        ("Pillow|surface|2|5", "Pillow|surface|3.2|5"),
        ("2|0", "3.2|0"),
        ("room|2", "room|3.2"),
        ("Bed|1.2|0", "Bed|3.1.2|0"),
        ("den", "den|3"),
    ),
)
def test_ids_name_the_flat(name, in_flat):
    assert id_in_flat(name, 3) == in_flat


def test_furniture_turns_with_its_home():
    site, turned = join_homes(own_homes()), set()
    for number, (house, _) in enumerate(own_homes(), start=1):
        after = {one["id"]: one for one in site["objects"]}
        pairs = [(one, after[id_in_flat(one["id"], number)]) for one in house["objects"][:2]]
        before_deg, after_deg = (
            math.degrees(math.atan2(b["position"]["x"] - a["position"]["x"], b["position"]["z"] - a["position"]["z"]))
            for a, b in zip(*pairs, strict=True)
        )
        turn_deg = (pairs[0][1]["rotation"]["y"] - pairs[0][0]["rotation"]["y"]) % 360
        assert (after_deg - before_deg - turn_deg + 180) % 360 == pytest.approx(180)
        turned.add(turn_deg)
    assert turned & {90, 270}, "a turn by 180 degrees looks the same in both directions"
