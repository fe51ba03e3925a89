import numpy as np
import pytest

from mrtask.bounds.assess import assess, home_with, searches_of
from mrtask.execution.episode import run_episode
from mrtask.execution.trials import home_order, sample_trial
from mrtask.maps.home_map import build_map
from mrtask.planning.planners import make_planner
from mrtask.tasks.automaton import build_automaton


@pytest.fixture(scope="module")
def small_homes(generated_homes):
    return [home for home in generated_homes if home.size_class == "small"]


def make_trial(homes, robots, number):
    trial = sample_trial("small", robots, number, home_order(homes, "small", robots, 0), build_map, seed=0)
    home = next(home for home in homes if home.id == trial.home_id)
    likelihood = np.random.default_rng(number).beta(0.3, 2.0, (len(home.containers), len(trial.objects)))
    return trial, home, build_map(home), likelihood


@pytest.mark.parametrize("planner", ["nonlearned_myopic", "greedy"])
def test_one_robots_cost_is_not_below_its_bound_whatever_the_worlds(small_homes, planner):
    for number in range(3):
        row = assess(*make_trial(small_homes, 1, number), make_planner(planner), 4)
        assert row["bound_s"] <= row["cost_s"] + 1e-3 * row["cost_s"]
        assert row["clairvoyant_s"] <= row["cost_s"] + 1e-3 * row["cost_s"]
        assert row["failed"] == 0
        assert row["kind"] in ("exact", "penalised")


def test_a_teams_row_is_the_same_again(small_homes):
    drawn = make_trial(small_homes, 2, 0)
    first, again = (assess(*drawn, make_planner("nonlearned_myopic"), 3) for _ in range(2))
    assert {**first, "bound_seconds": 0} == {**again, "bound_seconds": 0}
    assert first["kind"] == "team"
    assert first["bound_s"] > 0


def test_the_home_holds_what_the_world_says_and_keeps_what_the_task_does_not_name(two_room_home):
    world = np.array([[False, True], [True, True], [False, False]])
    home = home_with(two_room_home, ("Book", "Egg"), world)
    assert [container.objects for container in home.containers] == [("Egg",), ("Book", "Egg"), ("Pillow",)]
    assert home.layout_id == two_room_home.layout_id


def test_searches_come_with_the_state_before_them(small_homes):
    trial, home, home_map, likelihood = make_trial(small_homes, 1, 0)
    result = run_episode(trial, home, home_map, likelihood, make_planner("nonlearned_myopic"))
    automaton = build_automaton(trial.formula, trial.objects)
    searches = searches_of(result.trace, home, automaton)
    made = [leg for leg in result.trace.robots[0] if leg.kind == "search"]
    assert [home.containers[search.container].id for search in searches] == [leg.container for leg in made]
    for search, leg in zip(searches, made, strict=True):
        done = [letter.object for letter in result.trace.letters if letter.t_s < leg.t1_s]
        assert search.state == automaton.run(done)
