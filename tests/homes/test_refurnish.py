"""Refurnished homes hold as much as before, where the votes say."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from mrtask.homes.home import Container
from mrtask.homes.receptacles import ReceptacleTable, match_homes, read_table
from mrtask.homes.refurnish import Refurnisher
from mrtask.homes.votes import Votes, VotesError, read_votes
from tests.homes.made_up_votes import PLACEMENTS, write

PLACES = [tuple(name.split("|")) for name in PLACEMENTS]


def nothing_like_it(name, candidates):
    return None


@pytest.fixture
def votes(tmp_path):
    return read_votes(write(tmp_path / "votes.npy"))


@pytest.fixture
def home(two_room_home):
    """A kitchen with fridge and table and a bedroom with a bed, six objects of four types, one type in each."""
    contents = [("Apple", "Egg"), ("Apple", "Mug"), ("Apple", "Book")]
    containers = tuple(
        replace(container, objects=objects)
        for container, objects in zip(two_room_home.containers, contents, strict=True)
    )
    return replace(two_room_home, containers=containers)


def placed(home):
    return Counter(name for container in home.containers for name in container.objects)


def refurnisher(votes, home, misplaced=0.0, table=None):
    return Refurnisher(votes, match_homes([home], votes.placements, table or read_table(), nothing_like_it), misplaced)


def test_a_home_keeps_its_layout_and_how_many_objects_and_types_it_has(votes, home):
    anywhere = np.random.default_rng(0).integers(1, 5, votes.ranks.shape).astype(np.int16)
    votes = replace(votes, ranks=anywhere)
    drawn = [refurnisher(votes, home, 0.5).refurnish(home, np.random.default_rng(seed)) for seed in range(30)]
    assert {other.layout_id for other in drawn} == {home.layout_id}
    assert all(sorted(placed(other).values()) == [1, 1, 1, 3] for other in drawn)
    assert all(set(placed(other)) <= set(votes.objects) for other in drawn)
    for container in (container for other in drawn for container in other.containers):
        assert container.objects == tuple(sorted(set(container.objects)))
    again = refurnisher(votes, home, 0.5).refurnish(home, np.random.default_rng(3))
    assert again == drawn[3] != drawn[4]


def test_objects_lie_in_right_places_unless_some_are_misplaced(votes, home):
    tidy = refurnisher(votes, home)
    for seed in range(50):
        other = tidy.refurnish(home, np.random.default_rng(seed))
        for container, kind in zip(other.containers, home.container_kinds(), strict=True):
            for name in container.objects:
                assert votes.share_right[list(tidy.match.places[kind]), votes.objects.index(name)].sum() > 0


def test_places_are_drawn_by_rank_and_agreement_within_a_household(home):
    """One ranks bed, then table; the other calls only the bed right, and finds the object in the fridge misplaced."""
    places = (("kitchen", "fridge"), ("kitchen", "table"), ("bedroom", "bed"))
    votes = Votes(places, ("Pillow",), np.array([[[0, -1]], [[2, 0]], [[1, 1]]], dtype=np.int16))
    one = replace(home, containers=tuple(replace(container, objects=()) for container in home.containers))
    one = replace(one, containers=(replace(one.containers[0], objects=("Egg",)), *one.containers[1:]))
    table = ReceptacleTable({"Fridge": ("fridge",), "DiningTable": ("table",), "Bed": ("bed",)}, {})
    draws, misplaced = 4000, 0.2
    maker, rng = refurnisher(votes, one, misplaced, table), np.random.default_rng(0)
    where = Counter(
        container.type for _ in range(draws) for container in maker.refurnish(one, rng).containers if container.objects
    )
    # The first: bed 1 x 2/2, table 1/2 x 1/2, so 4 to 1, and nowhere to be misplaced. The second: bed, or fridge.
    expected = {"DiningTable": 0.5 / 5, "Bed": 0.5 * 4 / 5 + 0.5 * (1 - misplaced), "Fridge": 0.5 * misplaced}
    for kind, prob in expected.items():
        assert where[kind] / draws == pytest.approx(prob, abs=4 * np.sqrt(prob / draws))


def test_an_object_without_a_place_in_the_home_is_not_put_there(votes, home):
    only_bed = replace(home, containers=home.containers[2:])
    other = refurnisher(votes, only_bed).refurnish(only_bed, np.random.default_rng(0))
    known = {name for name, share in zip(votes.objects, votes.share_right[0], strict=True) if share}
    assert set(placed(other)) <= known and placed(other).total() == min(2, len(known))


def test_a_home_without_containers_and_a_share_beyond_one(votes, home):
    bare = replace(home, containers=())
    assert refurnisher(votes, bare).refurnish(bare, np.random.default_rng(0)) == bare
    with pytest.raises(ValueError, match=r"misplaced_prob must be within 0 and 1, got 1.5"):
        refurnisher(votes, home, 1.5)


def kinds_of(home, *kinds):
    rooms = {room.type: room.id for room in home.rooms}
    return replace(
        home,
        containers=tuple(
            Container(f"{kind}|{n}", kind, rooms[room], home.containers[0].footprint, ())
            for n, (kind, room) in enumerate(kinds)
        ),
    )


def test_the_table_finds_the_rooms_own_receptacles_first(home):
    kinds = [("DiningTable", "Kitchen"), ("Bed", "Kitchen"), ("Dresser", "Bedroom"), ("GarbageCan", "Kitchen")]
    match = match_homes([kinds_of(home, *kinds)], PLACES, read_table(), nothing_like_it)
    found = {kind: [PLACEMENTS[place] for place in places] for kind, places in match.places.items()}
    assert found["DiningTable", "Kitchen"] == ["kitchen|table"]
    assert found["Bed", "Kitchen"] == ["bedroom|bed"]
    assert found["Dresser", "Bedroom"] == ["bedroom|chest", "bedroom|bottom_cabinet"]
    assert found["GarbageCan", "Kitchen"] == []
    assert match.unmatched == ("GarbageCan",) and match.by_name == {}


def test_a_type_that_is_not_in_the_table_is_matched_by_name_or_listed(home):
    def nearest(name, candidates):
        return "sofa" if name == "Couch" else None

    table = ReceptacleTable({}, {"Kitchen": ("kitchen",), "Bedroom": ("bedroom",)})
    strange = kinds_of(home, ("Couch", "Kitchen"), ("Anvil", "Bedroom"))
    match = match_homes([strange], PLACES, table, nearest)
    assert match.places["Couch", "Kitchen"] == (PLACEMENTS.index("living_room|sofa"),)
    assert match.by_name == {"Couch": "sofa"} and match.unmatched == ("Anvil",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[containers", "is not a table of receptacles"),
        ("[container]\nBed = []", "no section 'container'; allowed: containers, rooms"),
        ("[containers]\nBed = 'bed'", "containers.Bed must be a list of names, got 'bed'"),
    ],
)
def test_bad_tables_are_refused(text, message, tmp_path):
    path = tmp_path / "table.toml"
    path.write_text(text)
    with pytest.raises(VotesError, match=message):
        read_table(path)


def test_what_the_table_names_but_nobody_voted_on_is_listed(home):
    table = ReceptacleTable({"Bed": ("hammock", "bed"), "Fridge": ("icebox",), "Oven": ("oven",)}, {})
    match = match_homes([home], PLACES, table, nothing_like_it)
    assert match.unknown == ("hammock", "icebox")
    assert match.unmatched == ("DiningTable", "Fridge")
