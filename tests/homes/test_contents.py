from dataclasses import replace

import numpy as np
import pytest

from mrtask.homes.catalogue import load_catalogue
from mrtask.homes.contents import draw_objects, fill_home, rooms_with

DRAWS = 3000


def test_objects_are_drawn_as_often_as_the_catalogue_says():
    catalogue = load_catalogue()
    facts = catalogue.objects["Bedroom"]["Bed"]
    rng = np.random.default_rng(0)
    drawn = [draw_objects(catalogue, "Bedroom", "Bed", rng) for _ in range(DRAWS)]
    counts = np.bincount([len(objects) for objects in drawn], minlength=len(facts["distinct_objects"])) / DRAWS
    np.testing.assert_allclose(counts, facts["distinct_objects"], atol=0.03)
    assert all(len(set(objects)) == len(objects) for objects in drawn)
    for kind, likelihood_prob in facts["likelihoods"].items():
        assert np.mean([kind in objects for objects in drawn]) == pytest.approx(likelihood_prob, abs=0.12)


def test_only_the_contents_change_and_the_seed_decides(two_room_home):
    first, again, other = (fill_home(two_room_home, np.random.default_rng(seed)) for seed in (3, 3, 4))
    assert first == again
    assert first.id != other.id
    assert first.layout_id == other.layout_id == two_room_home.layout_id
    known = load_catalogue().objects
    for container, (kind, room) in zip(first.containers, first.container_kinds(), strict=True):
        assert container.objects == tuple(sorted(set(container.objects)))
        assert set(container.objects) <= set(known[room][kind]["likelihoods"])


def test_rooms_and_types_that_the_catalogue_does_not_know(two_room_home):
    fridge, table, bed = two_room_home.containers
    rooms = tuple(replace(room, type="Office") for room in two_room_home.rooms)
    home = replace(two_room_home, rooms=rooms, containers=(fridge, replace(table, type="Anvil"), bed))
    filled = [fill_home(home, np.random.default_rng(seed)).containers for seed in range(20)]
    assert all(anvil.objects == () for _, anvil, _ in filled)
    in_beds = {name for *_, bed in filled for name in bed.objects}
    assert in_beds
    assert in_beds <= set(load_catalogue().objects["Bedroom"]["Bed"]["likelihoods"])
    assert rooms_with(load_catalogue(), "Anvil") == []
    assert rooms_with(load_catalogue(), "Bed") == ["Bedroom"]
