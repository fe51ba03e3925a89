"""Every planner in small worlds at the edge of what is allowed: each episode has a defined end."""

from dataclasses import replace

import numpy as np
import pytest

from mrtask.execution.episode import IDLE_DECISIONS_PER_ROBOT, run_episode
from mrtask.execution.team_spec import RobotSpec, Team
from mrtask.execution.trials import Trial
from mrtask.planning.planners import PLANNERS, make_planner

SEARCHES = {"samples": 500}
OPTIONS = {"pouct": SEARCHES, "known": SEARCHES, "pouct_paper": SEARCHES}
FRIDGE, TABLE, BED = 0, 1, 2


@pytest.fixture
def run(two_room_home, two_room_map):
    """Runs a planner where the egg is in the fridge and the pillow on the bed, from the table."""

    def run(
        planner,
        likelihood,
        formula="F Egg & F Pillow",
        robots=2,
        home=two_room_home,
        objects=("Egg", "Pillow"),
        home_map=two_room_map,
        **options,
    ):
        trial = Trial(
            trial_id="hard",
            home_id=home.id,
            size_class="small",
            team=Team.alike(robots, RobotSpec(**options)),
            template="formula",
            formula=formula,
            objects=objects,
            start_cell=tuple(int(part) for part in two_room_map.access[TABLE]),
            seed=1,
        )
        prior = np.broadcast_to(likelihood, (3, len(objects)))
        return run_episode(trial, home, home_map, prior, make_planner(planner, OPTIONS.get(planner)))

    return run


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("formula", ["F Egg & F Pillow", "(!Pillow U Egg) & F Pillow"])
@pytest.mark.parametrize("likelihood", [0.0, 1.0])
def test_likelihoods_of_zero_and_one_delay_but_do_not_mislead(run, planner, formula, likelihood):
    for robots in (1, 2):
        result = run(planner, likelihood, formula, robots, search_time_s=1.0)
        assert result.status == "accepted"


@pytest.mark.parametrize("planner", PLANNERS)
def test_likelihoods_that_are_sure_and_wrong_only_cost_time(run, two_room_map, planner):
    wrong = np.zeros((3, 2))
    wrong[FRIDGE, 1] = wrong[BED, 0] = 1.0
    result = run(planner, wrong, robots=1)
    assert result.status == "accepted"
    right = run(planner, wrong[::-1], robots=1)
    assert right.cost_s <= result.cost_s


@pytest.mark.parametrize("planner", PLANNERS)
def test_more_robots_than_containers(run, two_room_map, planner):
    result = run(planner, 0.4, robots=5)
    assert result.status == "accepted"
    # The pillow is farthest, and somebody is sent to each place at once.
    assert result.cost_s == pytest.approx(two_room_map.travel_m[TABLE, BED], abs=1e-4)


@pytest.mark.parametrize("planner", PLANNERS)
def test_an_object_out_of_reach_fails_with_its_name(run, two_room_map, planner):
    access, fields_m = two_room_map.access.copy(), two_room_map.fields_m.copy()
    access[BED], fields_m[BED] = -1, np.inf
    walled_in = replace(two_room_map, access=access, fields_m=fields_m)
    result = run(planner, 0.4, home_map=walled_in)
    assert (result.status, result.cost_s) == ("failed", None)
    assert result.error == "found in no container that can be reached: Pillow"


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_formula_true_from_the_start_is_accepted_without_a_decision(run, planner):
    result = run(planner, 0.4, formula="true | F Egg")
    assert (result.status, result.cost_s, result.decisions) == ("accepted", 0.0, 0)


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_formula_that_cannot_come_true_ends_in_failure(run, planner):
    result = run(planner, 0.4, formula="F Egg & !Egg & !Pillow & X(!Egg) & X(!Pillow) & false")
    assert (result.status, result.cost_s) == ("failed", None)


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("robots", [1, 2])
def test_an_interaction_that_leads_away_from_acceptance_is_made_where_no_other_way_is_left(
    run, two_room_home, planner, robots
):
    formula = "(!Egg U Unicorn) | F (Egg & X F (Pillow & X F Cup))"
    table = two_room_home.containers[TABLE]
    containers = list(two_room_home.containers)
    containers[TABLE] = replace(table, objects=("Cup",))
    home = replace(two_room_home, containers=tuple(containers))
    result = run(planner, 0.4, formula, robots, home, ("Unicorn", "Egg", "Pillow", "Cup"))
    assert result.status == "accepted", result.error
    # Whoever comes by before its turn, each is interacted with in its turn; more may come before the egg.
    word = [letter.object for letter in result.trace.letters]
    assert word[-3:] == ["Egg", "Pillow", "Cup"]


def test_a_planner_that_goes_round_in_circles_is_stopped_and_named(run):
    for robots in (1, 2):
        result = run("tests.pipeline.own_planners.Pacing", 0.4, robots=robots)
        idle = IDLE_DECISIONS_PER_ROBOT * robots
        assert (result.status, result.cost_s) == ("failed", None)
        assert result.error.startswith(f"no progress for {idle} decisions: tests.pipeline.own_planners.Pacing ")
        # Before that it searched two containers, with both robots at once.
        assert result.decisions <= idle + 3
