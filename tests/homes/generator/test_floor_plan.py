from itertools import combinations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Polygon

from mrtask.homes.catalogue import load_catalogue
from mrtask.homes.generator import floor_plan
from mrtask.homes.generator.floor_plan import OUTSIDE, make_floor_plan
from mrtask.homes.home import size_class_of


def check_plan(plan, shares, area_m2):
    shapes = [Polygon(room) for room in plan.rooms]
    assert all(shape.is_valid and not shape.exterior.is_ccw for shape in shapes)
    assert sum(shape.area for shape in shapes) == pytest.approx(area_m2, rel=0.01)
    for first, second in combinations(shapes, 2):
        assert first.intersection(second).area < 1e-3
    # The walls are the rooms' outlines, once each, and lie on the rooms they name.
    outlines = shapely.union_all([shape.exterior for shape in shapes])
    walls = [LineString([wall.start, wall.end]) for wall in plan.walls]
    assert sum(wall.length for wall in walls) == pytest.approx(shapely.set_precision(outlines, 1e-3).length, rel=1e-3)
    for wall, line in zip(plan.walls, walls, strict=True):
        for room in wall.rooms:
            assert room == OUTSIDE or line.within(shapes[room].exterior.buffer(2e-3))
    assert len(shapely.get_parts(shapely.union_all([shape.buffer(1e-3) for shape in shapes]))) == 1


@given(
    shares=st.lists(st.floats(0.05, 1.0), min_size=1, max_size=10),
    area_per_room_m2=st.floats(5.0, 40.0),
    seed=st.integers(0, 10**9),
)
@settings(deadline=None, max_examples=40)
def test_plans_are_sound(shares, area_per_room_m2, seed):
    area_m2 = area_per_room_m2 * len(shares)
    check_plan(make_floor_plan(shares, area_m2, np.random.default_rng(seed)), shares, area_m2)


def test_rooms_get_their_shares_and_are_not_all_rectangles():
    errors, corners = [], []
    for seed in range(20):
        plan = make_floor_plan([0.5, 0.3, 0.2], 90.0, np.random.default_rng(seed))
        shares = np.array([Polygon(room).area for room in plan.rooms]) / 90.0
        errors.append(np.abs(shares - [0.5, 0.3, 0.2]).max())
        corners += [len(room) for room in plan.rooms]
    assert np.mean(errors) < 0.06
    assert 0.2 < np.mean(np.array(corners) > 4) < 0.9


@pytest.mark.parametrize(("area_m2", "rooms", "plans"), [(40.0, 2, 120), (85.0, 3, 90), (160.0, 6, 60)])
def test_footprints_are_as_full_and_as_long_as_the_catalogue_says(area_m2, rooms, plans):
    facts = load_catalogue().homes["footprints"][size_class_of(area_m2)]
    fills, aspects = [], []
    for seed in range(plans):
        plan = make_floor_plan([1.0] * rooms, area_m2, np.random.default_rng(seed))
        x0, y0, x1, y1 = shapely.union_all([Polygon(room) for room in plan.rooms]).bounds
        fills.append(area_m2 / ((x1 - x0) * (y1 - y0)))
        aspects.append(max(x1 - x0, y1 - y0) / min(x1 - x0, y1 - y0))
    assert np.mean(fills) == pytest.approx(np.mean(facts["fill"]), abs=0.05)
    assert np.mean(aspects) == pytest.approx(np.mean(facts["aspect"]), rel=0.15)


def test_the_seeds_of_rooms_are_apart():
    grid = np.full((8, 8), floor_plan.EMPTY)
    apart = []
    for seed in range(200):
        seeds = floor_plan._seeds(grid, 4, np.random.default_rng(seed))
        assert len(set(seeds)) == 4
        apart += [np.hypot(a[0] - b[0], a[1] - b[1]) for a, b in combinations(seeds, 2)]
    cells = np.argwhere(grid == floor_plan.EMPTY)
    anywhere = [np.hypot(*(a - b)) for a, b in combinations(cells, 2)]
    assert np.mean(apart) > 1.1 * np.mean(anywhere)
    assert sorted(floor_plan._seeds(np.full((2, 2), floor_plan.EMPTY), 4, np.random.default_rng(0))) == [
        (0, 0), (0, 1), (1, 0), (1, 1),
    ]  # fmt: skip


def test_strips_serve_where_no_plan_is_sound(monkeypatch):
    monkeypatch.setattr(floor_plan, "_fault", lambda grid, weights: None)
    shares = [0.4, 0.4, 0.15, 0.05]
    check_plan(make_floor_plan(shares, 80.0, np.random.default_rng(0)), shares, 80.0)
