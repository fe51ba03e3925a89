"""What planners do with problems at the edge, and which problems are refused."""

from dataclasses import replace

import numpy as np
import pytest

from mrtask.planning.planners import PLANNERS, make_planner
from mrtask.planning.problem import WAIT, RobotKind
from tests.planning.problems import make_problem, random_problem

SEARCHES = {"samples": 200}
OPTIONS = {"pouct": SEARCHES, "known": SEARCHES, "pouct_paper": SEARCHES}


def plan(name, problem):
    return make_planner(name, OPTIONS.get(name)).plan(problem, seed=0)


@pytest.mark.parametrize("name", PLANNERS)
def test_a_task_already_done_means_waiting(name):
    problem = random_problem(1, template="and2", robots=2, containers=4)
    done = replace(problem, state=problem.automaton.run(["a", "b"]))
    assert {assignment.container for assignment in plan(name, done).assignments.values()} == {WAIT}


@pytest.mark.parametrize("name", PLANNERS)
def test_nothing_in_reach_means_waiting(name):
    problem = random_problem(1, template="and2", robots=2, containers=3)
    cut_off = tuple(replace(robot, travel_s=np.full(3, np.inf)) for robot in problem.robots)
    assert {a.container for a in plan(name, replace(problem, robots=cut_off)).assignments.values()} == {WAIT}


@pytest.mark.parametrize("name", PLANNERS)
def test_an_object_that_should_be_nowhere_is_looked_for_all_the_same(name):
    prob = np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    problem = make_problem(
        "F a & F b", ["a", "b"], [[0, 0], [3, 0], [5, 0]], [[0, 0]], prob, searched=[0], search_time_s=1.0
    )
    done = replace(problem, state=problem.automaton.run(["b"]))
    assert plan(name, done).assignments[0].container == 1


@pytest.mark.parametrize("name", PLANNERS)
def test_a_container_that_only_one_robot_reaches_is_left_to_it(name):
    problem = make_problem("F a", ["a"], [[3, 0], [4, 0]], [[0, 0], [1, 0]], [[0.9], [0.2]])
    robots = (replace(problem.robots[0], travel_s=np.array([3.0, np.inf])), problem.robots[1])
    assignments = plan(name, replace(problem, robots=robots)).assignments
    assert assignments[0].container != 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"presence_prob": np.full((3, 2), 1.5)}, r"presence_prob must lie in \[0, 1\]"),
        ({"presence_prob": np.full((3, 2), np.nan)}, r"presence_prob must lie in \[0, 1\]"),
        ({"presence_prob": np.full((3, 5), 0.5)}, "presence_prob has 5 objects, the automaton 2"),
        ({"searched": np.zeros(4, dtype=bool)}, "must be .* with the C = 3"),
        ({"kinds": (RobotKind(np.zeros((2, 2))),)}, "must be .* with the C = 3"),
        ({"kinds": (RobotKind(np.zeros((3, 3)), handles=np.ones(3, dtype=bool)),)}, "handles .* O = 2"),
        ({"kinds": ()}, "one of the 0 kinds"),
        ({"robots": ()}, "at least one robot"),
    ],
)
def test_problems_that_make_no_sense_are_refused(change, message):
    problem = random_problem(1, template="and2", robots=1, containers=3)
    with pytest.raises(ValueError, match=message):
        replace(problem, **change)


@pytest.mark.parametrize("seconds", [-1.0, np.nan])
def test_ways_that_take_no_time_at_all_are_refused(seconds):
    with pytest.raises(ValueError, match="travel_s must be >= 0"):
        RobotKind(np.full((3, 3), seconds))
