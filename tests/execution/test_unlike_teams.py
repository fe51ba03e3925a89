"""Teams of robots that differ: planners keep to what each robot can do, and what nobody can do is said."""

from dataclasses import replace

import numpy as np
import pytest

from mrtask.errors import InputError
from mrtask.execution.episode import run_episode
from mrtask.execution.make_trial import make_trial
from mrtask.execution.team_checks import check_doable, check_types
from mrtask.execution.team_spec import RobotSpec, Team
from mrtask.execution.trials import TrialOptions, home_order, sample_trial
from mrtask.maps.home_map import build_map
from mrtask.planning.planners import make_planner
from mrtask.tasks.templates import PAPER_TEMPLATES
from tests.execution.trace_check import check_trace

SCOUT, ARM = RobotSpec(1.5, 1.0, 2.0, handles=(), name="scout"), RobotSpec(0.6, 2.0, 3.0, name="arm")
TEAMS = {
    "scout and arm": Team((SCOUT, ARM), "scout and arm"),
    "wide and slim": Team((replace(ARM, radius_m=0.3), RobotSpec(1.1, radius_m=0.15)), "wide and slim"),
    "one opens little": Team((RobotSpec(opens=("Bed", "Fridge", "DiningTable")), RobotSpec(0.8)), "one opens little"),
}
PLANNERS = {"nonlearned_myopic": {}, "learned_myopic": {}, "greedy": {}, "pouct": {"samples": 50}, "known": {}}


@pytest.fixture(scope="module")
def mapped(generated_homes):
    maps = {}

    def map_of(home):
        if home.id not in maps:
            maps[home.id] = build_map(home)
        return maps[home.id]

    return {home.id: home for home in generated_homes}, map_of


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("team", TEAMS)
def test_every_planner_keeps_to_what_each_robot_can_do(mapped, generated_homes, team, planner):
    homes, map_of = mapped
    order = home_order(generated_homes, "small", 2, 0)
    accepted = 0
    for number, template in enumerate(PAPER_TEMPLATES):
        options = TrialOptions(templates=(template,), team=TEAMS[team])
        trial = sample_trial("small", 2, number, order, map_of, seed=0, options=options)
        home = homes[trial.home_id]
        likelihood = np.random.default_rng(number).beta(0.3, 2.0, (len(home.containers), len(trial.objects)))
        result = run_episode(trial, home, map_of(home), likelihood, make_planner(planner, PLANNERS[planner]), planner)
        check_trace(trial, home, map_of(home), result, known=planner == "known")
        assert (result.cost_cells is None) == (result.cost_s is None or TEAMS[team].speed_m_per_s is None)
        accepted += result.status == "accepted"
    assert accepted


def test_a_trial_is_the_same_for_every_team(mapped, generated_homes):
    _, map_of = mapped
    order = home_order(generated_homes, "small", 2, 0)
    trials = [
        sample_trial("small", 2, 3, order, map_of, seed=0, options=TrialOptions(team=team))
        for team in (None, *TEAMS.values())
    ]
    assert all(replace(trial, team=trials[0].team) == trials[0] for trial in trials)


def test_a_team_that_lacks_an_ability_fails_and_says_what_would_help(mapped):
    homes, map_of = mapped
    home = next(home for home in homes.values() if home.size_class == "small")
    held = next(container for container in home.containers if container.objects)
    obj = held.objects[0]
    holding = {container.type for container in home.containers if obj in container.objects}
    others = tuple({container.type for container in home.containers} - holding)
    trial = make_trial(home, map_of(home), f"F {obj}")

    def error(*members):
        return run_episode(
            replace(trial, team=Team(members, "mine")), home, map_of(home), flat(home), make_planner("greedy")
        ).error

    assert error(replace(SCOUT, opens=None)) == (
        f"nobody in team 'mine' can do the task; scout could if it handled {obj}"
    )
    assert error(SCOUT, RobotSpec(opens=others)).endswith(f"; scout could if it handled {obj}")
    said = error(RobotSpec(opens=others))
    assert any(said.endswith(f"; robot 1 could if it opened {kind}") for kind in holding)
    with pytest.raises(InputError, match=f"nobody handles {obj}; scout could if it handled {obj}"):
        check_doable(Team((replace(SCOUT, handles=("Nothing",)),), "mine"), f"F {obj}", (obj,))


def flat(home):
    return np.full((len(home.containers), 1), 0.3)


def test_unknown_types_and_a_start_in_a_wall_are_refused(mapped):
    homes, map_of = mapped
    home = next(iter(homes.values()))
    with pytest.raises(InputError, match=r"handles: no type 'Mugg'; did you mean Mug\?"):
        check_types(Team((RobotSpec(handles=("Mugg",)),), "mine"))
    with pytest.raises(InputError, match=r"opens: no type 'Frige'; did you mean Fridge\?"):
        check_types(Team((RobotSpec(opens=("Frige",)),), "mine"))
    obj = next(container.objects[0] for container in home.containers if container.objects)
    trial = make_trial(home, map_of(home), f"F {obj}")
    outside = Team((RobotSpec(start_m=(-9.0, -9.0), name="r7"),), "mine")
    with pytest.raises(InputError, match=r"team 'mine', r7: start: in the home .* is more than 0\.5 m from"):
        run_episode(replace(trial, team=outside), home, map_of(home), flat(home), make_planner("greedy"))
