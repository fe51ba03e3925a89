import numpy as np
import pytest
from scipy.stats import ks_2samp

from mrtask.analysis.studies.realism import KINDS, NUMBERS, _ks_distance, _tv_distance, compare_homes, describe_home
from mrtask.homes.procthor import read_houses
from mrtask.maps.home_map import build_map


@pytest.fixture(scope="module")
def described(generated_homes):
    return [describe_home(home, build_map(home, 0.1)) for home in generated_homes]


def test_description(two_room_home, two_room_map):
    described = describe_home(two_room_home, two_room_map)
    assert NUMBERS["containers"](described) == [3]
    assert NUMBERS["containers in a Kitchen"](described) == [2]
    assert NUMBERS["containers in a Bathroom"](described) == []
    assert NUMBERS["objects in a container"](described) == [1, 0, 2]
    assert NUMBERS["share of empty containers"](described) == [pytest.approx(1 / 3)]
    assert NUMBERS["mean travel, m"](described)[0] == pytest.approx(two_room_map.travel_m.sum() / 6)
    assert KINDS["objects by container"](described) == ["Egg in Fridge", "Book in Bed", "Pillow in Bed"]
    assert described.reachable_share == 1.0
    assert 0.5 < described.free_floor_share < 0.9
    assert described.main_region_share == pytest.approx(1.0, abs=0.02)


def test_equal_homes_are_at_distance_zero(described):
    table = compare_homes(described, described)
    assert (table["distance"] == 0).all()
    assert set(table["size_class"]) == {"small", "medium", "large"}
    assert len(table) == 3 * (len(NUMBERS) + len(KINDS))
    assert table["yardstick"].between(0, 1).all()


@pytest.mark.parametrize("seed", range(5))
def test_ks_distance_is_that_of_scipy(seed):
    rng = np.random.default_rng(seed)
    first, second = rng.integers(0, 9, 40), rng.normal(4, 3, 55)
    assert _ks_distance(first, second) == pytest.approx(ks_2samp(first, second).statistic)
    assert _ks_distance([], []) == 0.0
    assert _ks_distance([], [1.0]) == 1.0


def test_tv_distance():
    assert _tv_distance(["a", "a", "b", "b"], ["a", "c"]) == pytest.approx(0.5)
    assert _tv_distance([], []) == 0.0


def test_unlike_homes_are_far_apart(described):
    small = [d for d in described if d.home.size_class == "small"]
    fuller = [d for d in small if len(d.home.containers) == max(len(e.home.containers) for e in small)]
    emptier = [d for d in small if d not in fuller]
    table = compare_homes(fuller, emptier).set_index("statistic")
    assert table.loc["containers", "distance"] == 1.0
    assert table.loc["containers", "generated"] > table.loc["containers", "real"]


def test_generated_homes_resemble_real_ones(shared_homes, described):
    real = list(read_houses([shared_homes / "procthor-2to3room.jsonl.gz"], shared_homes / "asset-database.json"))[:60]
    table = compare_homes(described, [describe_home(home, build_map(home, 0.1)) for home in real])
    rows = table.set_index(["size_class", "statistic"])
    for size_class in ("small", "medium"):
        row = rows.loc[(size_class, "mean travel, m")]
        assert row["generated"] == pytest.approx(row["real"], rel=0.5)
