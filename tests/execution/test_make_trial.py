"""A trial of one's own, and its episode stepped by hand."""

from dataclasses import replace

import numpy as np
import pytest

from mrtask import (
    Episode,
    FunctionModel,
    InputError,
    RobotSpec,
    make_planner,
    make_trial,
    run_episode,
    run_experiment,
)
from mrtask.execution.perception import Perception, Rates
from mrtask.planning.planners import PLANNERS

PROBS = np.array([[0.6, 0.1], [0.3, 0.2], [0.2, 0.7]])
OPTIONS = {"pouct": {"samples": 50}, "known": {"samples": 50}, "pouct_paper": {"samples": 50}}
TASK = "F Egg & F Pillow"


def untimed(result):
    return replace(result, planning_s=0.0)


@pytest.mark.parametrize("name", PLANNERS)
@pytest.mark.parametrize(("robots", "perception"), [(1, Perception()), (2, Perception(Rates(0.6, 0.1)))])
def test_an_episode_stepped_by_hand_is_that_of_run_episode(two_room_home, two_room_map, name, robots, perception):
    spec = RobotSpec(0.7, 1.5, 2.5, perception)
    trial = make_trial(two_room_home, two_room_map, TASK, robots, robot=spec)
    planner = make_planner(name, OPTIONS.get(name))
    expected = run_episode(trial, two_room_home, two_room_map, PROBS, planner)
    episode = Episode(trial, two_room_home, two_room_map, PROBS, name, known=planner.knows_contents)
    times = []
    while not episode.done:
        times.append(episode.time_s)
        episode.step(planner.plan(episode.problem, episode.seed))
    assert untimed(episode.result()) == untimed(expected)
    assert expected.planner == name and expected.status == "accepted"
    assert times[0] == 0.0 and times == sorted(times) and len(times) == expected.decisions > 1


def test_a_failed_episode_stepped_by_hand_says_why(two_room_home, two_room_map):
    trial = replace(make_trial(two_room_home, two_room_map, TASK), formula="F Unicorn", objects=("Unicorn",))
    greedy = make_planner("greedy")
    episode = Episode(trial, two_room_home, two_room_map, PROBS[:, :1])
    with pytest.raises(ValueError, match="the episode is not done after 0 decisions; step it until `done` is true"):
        episode.result()
    while not episode.done:
        episode.step(greedy.plan(episode.problem, episode.seed))
    result = episode.result()
    assert (result.planner, result.status, result.cost_s) == ("by_hand", "failed", None)
    assert result.error == episode.error == "found in no container that can be reached: Unicorn"
    with pytest.raises(ValueError, match=r"the episode is done .*Unicorn.*; make a new Episode to go on"):
        episode.step(greedy.plan(episode.problem, 0))


class Cautious:
    """A planner of a user's own: only `plan`."""

    def plan(self, problem, seed):
        return make_planner("greedy").plan(problem, seed)


def test_a_planner_of_a_users_own_is_named_by_its_import_path(two_room_home, two_room_map):
    trial = make_trial(two_room_home, two_room_map, TASK)
    result = run_episode(trial, two_room_home, two_room_map, PROBS, Cautious())
    assert result.planner == f"{__name__}.Cautious"
    greedy = run_episode(trial, two_room_home, two_room_map, PROBS, make_planner("greedy"))
    assert (greedy.planner, greedy.trace) == ("greedy", result.trace)


def test_a_planners_seeds_depend_on_its_name(two_room_home, two_room_map):
    class Noting:
        def __init__(self):
            self.seeds = []

        def plan(self, problem, seed):
            self.seeds.append(seed)
            return make_planner("greedy").plan(problem, seed)

    trial, seeds = make_trial(two_room_home, two_room_map, TASK), []
    for name in ("a", "a", "b"):
        planner = Noting()
        run_episode(trial, two_room_home, two_room_map, PROBS, planner, name)
        seeds.append(planner.seeds)
    assert seeds[0] == seeds[1]
    assert not set(seeds[0]) & set(seeds[2])


def test_a_planners_name_stands_for_the_planner(two_room_home, two_room_map):
    trial = make_trial(two_room_home, two_room_map, TASK)
    named = run_episode(trial, two_room_home, two_room_map, PROBS, "greedy")
    assert untimed(named) == untimed(run_episode(trial, two_room_home, two_room_map, PROBS, make_planner("greedy")))


def test_a_likelihood_that_is_no_model_is_refused(two_room_home, two_room_map):
    trial = make_trial(two_room_home, two_room_map, TASK)
    with pytest.raises(InputError, match=r"method predict\(names\), not a dict; fit_on_homes\(homes\) makes one"):
        run_episode(trial, two_room_home, two_room_map, {"Egg": 0.5}, "greedy")


def test_an_experiment_takes_one_planner_and_one_team_without_lists(two_room_home):
    likely = FunctionModel(lambda obj, container, room: 0.3)

    def rows(planners, robots):
        return run_experiment([two_room_home], planners, likely, robots=robots, trials_per_cell=1).drop(
            columns=["planning_s", "trace"]
        )

    expected = rows(["greedy"], [2])
    assert list(expected["robots"]) == [2]
    assert rows("greedy", 2).equals(expected) and rows({"greedy": "greedy"}, (2,)).equals(expected)
    with pytest.raises(InputError, match=r"method predict\(names\), not a dict"):
        run_experiment([two_room_home], "greedy", {"Egg": 0.5}, robots=2)


def test_an_episode_asks_a_likelihood_model(two_room_home, two_room_map):
    def likely(obj, container, room):
        return 0.9 if (obj, container) == ("Egg", "Bed") else 0.1

    trial = make_trial(two_room_home, two_room_map, TASK)
    episode = Episode(trial, two_room_home, two_room_map, FunctionModel(likely))
    beds = [one.type == "Bed" for one in two_room_home.containers]
    assert sum(beds) == 1
    np.testing.assert_allclose(episode.problem.presence_prob[:, 0], np.where(beds, 0.9, 0.1))
    np.testing.assert_allclose(episode.problem.presence_prob[:, 1], 0.1)


def test_a_trial_has_the_task_team_and_start_that_were_asked_for(two_room_home, two_room_map):
    spec = RobotSpec(search_time_s=3.0)
    trial = make_trial(two_room_home, two_room_map, "egg, then pillow", 3, start_m=(2.02, 1.52), robot=spec)
    assert (trial.team.robots, trial.team.spec) == (3, spec)
    assert trial.formula == "(!Pillow U Egg) & F Pillow" and trial.objects == ("Egg", "Pillow")
    assert trial.start_cell == two_room_map.cell_of((2.02, 1.52))
    middle = make_trial(two_room_home, two_room_map, TASK)
    assert two_room_map.free[middle.start_cell]
    other = make_trial(two_room_home, two_room_map, TASK, seed=1)
    assert replace(other, seed=middle.seed) == middle and other.seed != middle.seed


@pytest.mark.parametrize(
    ("task", "options", "error"),
    [
        ("F Pilow", {}, "unknown object 'Pilow', did you mean 'Pillow'?; allowed: "),
        ("F (Egg", {}, "F \\(Egg"),
        ("G Egg", {}, "not co-safe|G"),
        (TASK, {"start_m": (50.0, 50.0)}, r"\(50, 50\) is more than 0.5 m from where a robot fits; the nearest"),
    ],
)
def test_what_cannot_be_a_trial_is_refused(two_room_home, two_room_map, task, options, error):
    with pytest.raises(InputError, match=error.replace("?;", r"\?;")):
        make_trial(two_room_home, two_room_map, task, **options)


def test_a_start_inside_a_wall_is_refused(two_room_home, two_room_map):
    blocked = replace(two_room_map, free=two_room_map.free.copy())
    row, col = two_room_map.cell_of((2.02, 1.52))
    blocked.free[row - 15 : row + 16, col - 15 : col + 16] = False
    with pytest.raises(InputError, match=r"\(2, 1.5\) is more than 0.5 m from where a robot fits"):
        make_trial(two_room_home, blocked, TASK, start_m=(2.0, 1.5))
