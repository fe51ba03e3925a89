from dataclasses import replace
from itertools import pairwise
from math import dist

import numpy as np
import pytest

from mrtask.execution.episode import run_episode
from mrtask.execution.team_spec import RobotSpec
from mrtask.execution.trace import Trace
from mrtask.execution.trials import TrialOptions, home_order, sample_trial
from mrtask.maps.home_map import build_map
from mrtask.planning.planners import PLANNERS, make_planner
from mrtask.tasks.templates import PAPER_TEMPLATES
from tests.execution.trace_check import check_trace

OPTIONS = {"pouct": {"samples": 25}, "known": {"samples": 25}, "pouct_paper": {"samples": 25}}


@pytest.fixture(scope="module")
def world(generated_homes):
    maps = {home.id: build_map(home) for home in generated_homes}
    return generated_homes, maps


def make_trial(world, size_class, robots, number, **options):
    homes, maps = world
    trial = sample_trial(
        size_class,
        robots,
        number,
        home_order(homes, size_class, robots, 0),
        lambda home: maps[home.id],
        seed=0,
        options=TrialOptions(**options),
    )
    home = next(home for home in homes if home.id == trial.home_id)
    likelihood = np.random.default_rng(number).beta(0.3, 2.0, (len(home.containers), len(trial.objects)))
    return trial, home, maps[home.id], likelihood


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("template", PAPER_TEMPLATES)
@pytest.mark.parametrize("robots", [1, 2, 3])
def test_traces_obey_the_world(world, planner, template, robots):
    for number, (size_class, search_s, interact_s) in enumerate(
        [("small", 0.0, 0.0), ("medium", 1.5, 2.5), ("large", 0.0, 0.0)]
    ):
        trial, home, home_map, likelihood = make_trial(
            world,
            size_class,
            robots,
            number,
            templates=(template,),
            robot=RobotSpec(0.7, search_s, interact_s),
        )
        result = run_episode(trial, home, home_map, likelihood, make_planner(planner, OPTIONS.get(planner)))
        assert result.status == "accepted"
        check_trace(trial, home, home_map, result, known=planner == "known")
        assert Trace.from_json(result.trace.to_json()) == result.trace
        again = run_episode(trial, home, home_map, likelihood, make_planner(planner, OPTIONS.get(planner)))
        assert (again.cost_s, again.trace, again.decisions) == (result.cost_s, result.trace, result.decisions)


@pytest.mark.parametrize("planner", [name for name in PLANNERS if name != "known"])
def test_an_object_that_is_nowhere_fails_with_its_name(world, planner):
    trial, home, home_map, likelihood = make_trial(world, "small", 2, 0, templates=["and2"])
    lost = replace(trial, objects=(trial.objects[0], "Unicorn"), formula=f"F {trial.objects[0]} & F Unicorn")
    result = run_episode(lost, home, home_map, likelihood, make_planner(planner, OPTIONS.get(planner)))
    assert result.status == "failed"
    assert result.cost_s is None and "Unicorn" in result.error
    check_trace(lost, home, home_map, result)


def test_known_fails_at_once_when_an_object_is_nowhere(world):
    trial, home, home_map, likelihood = make_trial(world, "small", 1, 0, templates=["and2"])
    lost = replace(trial, objects=("Unicorn", "Dragon"), formula="F Unicorn & F Dragon")
    result = run_episode(lost, home, home_map, likelihood, make_planner("known", OPTIONS["known"]))
    assert (result.status, result.decisions) == ("failed", 1)


def test_a_formula_true_from_the_start_costs_nothing(world):
    trial, home, home_map, likelihood = make_trial(world, "small", 2, 0, templates=["and2"])
    done = replace(trial, formula=f"true | F {trial.objects[0]}")
    result = run_episode(done, home, home_map, likelihood, make_planner("pouct", OPTIONS["pouct"]))
    assert (result.status, result.cost_s, result.decisions) == ("accepted", 0.0, 0)


def test_the_decision_limit_ends_an_episode_with_a_reason(world):
    trial, home, home_map, likelihood = make_trial(world, "large", 1, 0, templates=["and3"])
    result = run_episode(trial, home, home_map, likelihood, make_planner("nonlearned_myopic"), max_decisions=1)
    assert result.status == "failed"
    assert "decision limit of 1" in result.error


def test_least_motion_is_the_driving_of_the_robot_that_drove_least(world):
    trial, home, home_map, likelihood = make_trial(world, "large", 3, 0, templates=["and3"], robot=RobotSpec(0.5))
    timed = run_episode(trial, home, home_map, likelihood, make_planner("greedy"))
    least = run_episode(replace(trial, cost="least_motion"), home, home_map, likelihood, make_planner("greedy"))
    assert least.trace == timed.trace
    driven_m = [sum(dist(*ends) for leg in legs for ends in pairwise(leg.path)) for legs in timed.trace.robots]
    assert least.cost_cells == pytest.approx(min(driven_m) / 0.05, rel=1e-4)
    assert least.cost_s == pytest.approx(min(driven_m) / 0.5, rel=1e-4)
    assert timed.cost_s == timed.trace.letters[-1].t_s >= least.cost_s


@pytest.mark.parametrize("planner", ["learned_myopic", "greedy", "pouct"])
def test_containers_known_from_the_start_are_never_searched(world, planner):
    trial, home, home_map, likelihood = make_trial(world, "medium", 2, 1, unsearched_share=(0.0, 0.0))
    result = run_episode(trial, home, home_map, likelihood, make_planner(planner, OPTIONS.get(planner)))
    assert result.status == "accepted"
    check_trace(trial, home, home_map, result)
    known = {home.containers[index].id for index in trial.known}
    searched = {leg.container for legs in result.trace.robots for leg in legs if leg.kind == "search"}
    holding = {c.id for c in home.containers if set(c.objects) & set(trial.objects)}
    assert known and searched <= holding
    assert not known & holding


def test_soft_ways_are_driven_as_the_map_has_them(world):
    trial, home, _, likelihood = make_trial(world, "small", 2, 0)
    soft = build_map(home, ways="soft")
    result = run_episode(trial, home, soft, likelihood, make_planner("learned_myopic"))
    assert result.status == "accepted"
    check_trace(trial, home, soft, result)
