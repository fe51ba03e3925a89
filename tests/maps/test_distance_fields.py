import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.graph import MCP_Geometric

from mrtask.maps.distance_fields import WALL_COST, descend, distance_fields, follow, soft_cost, soft_fields

spec = importlib.util.spec_from_file_location("naive_maps", Path(__file__).with_name("naive_maps.py"))
naive = importlib.util.module_from_spec(spec)
spec.loader.exec_module(naive)


def random_grid(seed, rows, cols, blocked_prob):
    rng = np.random.default_rng(seed)
    free = rng.random((rows, cols)) >= blocked_prob
    goal = tuple(int(v) for v in rng.integers((rows, cols)))
    free[goal] = True
    return free, goal


@given(seed=st.integers(0, 10**6), rows=st.integers(1, 14), cols=st.integers(1, 14), prob=st.floats(0, 0.7))
@settings(deadline=None, max_examples=80)
def test_fields_equal_plain_dijkstra(seed, rows, cols, prob):
    free, goal = random_grid(seed, rows, cols, prob)
    (field_m,) = distance_fields(free, np.array([goal], np.int32), 0.5)
    np.testing.assert_allclose(field_m, naive.dijkstra(free, goal) * 0.5, rtol=1e-6)


def test_fields_equal_scikit_image_on_a_large_grid():
    free, goal = random_grid(3, 180, 240, 0.35)
    (field_m,) = distance_fields(free, np.array([goal], np.int32), 0.05)
    costs, _ = MCP_Geometric(np.where(free, 1.0, np.inf)).find_costs([goal])
    np.testing.assert_allclose(field_m, costs * 0.05, rtol=1e-5)


@given(seed=st.integers(0, 10**6), prob=st.floats(0, 0.5))
@settings(deadline=None, max_examples=50)
def test_paths_step_between_free_neighbours_and_are_as_long_as_the_field_says(seed, prob):
    free, goal = random_grid(seed, 12, 15, prob)
    (field_m,) = distance_fields(free, np.array([goal], np.int32), 0.05)
    for row, col in np.argwhere(np.isfinite(field_m))[::7]:
        cells = descend(field_m, 0.05, int(row), int(col))
        assert tuple(cells[0]) == (row, col)
        assert tuple(cells[-1]) == goal
        assert free[tuple(cells.T)].all()
        assert naive.path_length_m(cells, 0.05) == pytest.approx(field_m[row, col], rel=1e-5, abs=1e-6)


def test_a_straight_way_is_not_zigzagged():
    field = distance_fields(np.ones((9, 30), bool), np.array([[4, 29]], np.int32), 1.0)[0]
    cells = descend(field, 1.0, 0, 0)
    turns = (np.diff(cells, n=2, axis=0) != 0).any(axis=1).sum()
    assert turns <= 1


def test_goals_without_a_cell_have_infinite_fields():
    fields = distance_fields(np.ones((3, 3), bool), np.array([[-1, -1], [1, 1]], np.int32), 1.0)
    assert np.isinf(fields[0]).all()
    assert fields[1, 0, 0] == pytest.approx(2**0.5)


@pytest.mark.parametrize(("rows", "cols", "blocked_prob"), [(1, 1, 0.0), (9, 14, 0.3), (60, 80, 0.05)])
def test_soft_ways_are_of_least_cost_and_as_long_as_the_field_says(rows, cols, blocked_prob):
    free, goal = random_grid(5, rows, cols, blocked_prob)
    goals = np.array([goal, (-1, -1)], np.int32)
    (field_m, none_m), (steps, _) = soft_fields(free, goals, 0.05)
    assert np.isinf(none_m).all()
    cost = soft_cost(free, 0.05)
    least, _ = MCP_Geometric(np.where(free, cost, np.inf)).find_costs([goal])
    np.testing.assert_array_equal(np.isfinite(field_m), np.isfinite(least))
    for row, col in np.argwhere(np.isfinite(field_m))[::11]:
        cells = follow(steps, int(row), int(col))
        assert tuple(cells[0]) == (row, col) and tuple(cells[-1]) == goal
        assert naive.path_length_m(cells, 0.05) == pytest.approx(field_m[row, col], rel=1e-5, abs=1e-6)
        lengths = np.hypot(*np.diff(cells, axis=0).T)
        along = cost[tuple(cells.T)]
        assert (lengths * (along[:-1] + along[1:]) / 2).sum() == pytest.approx(least[row, col], rel=1e-9, abs=1e-9)


def test_cells_cost_most_beside_walls():
    cost = soft_cost(np.ones((41, 41), bool), 0.05)
    assert cost[0, 20] == cost[20, 40] == WALL_COST
    assert cost[20, 20] == cost[11, 20] == 1.0
    assert (np.diff(cost[:21, 20]) <= 0).all()
