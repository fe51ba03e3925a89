from dataclasses import replace

import numpy as np
import pytest

from mrtask.planning.planners import make_planner
from mrtask.planning.problem import WAIT, Assignment, needed, safe
from mrtask.tasks.automaton import build_automaton
from tests.planning.problems import make_problem


def line_problem(**changes):
    """Containers at 2, 4 and 20 m; robots at 0 and 3 m; `a` and `b` wanted in any order."""
    problem = make_problem(
        "F a & F b",
        ["a", "b"],
        [[2, 0], [4, 0], [20, 0]],
        [[0, 0], [3, 0]],
        [[0.1, 0.1], [0.2, 0.1], [0.9, 0.8]],
        searched=changes.pop("searched", ()),
    )
    return replace(problem, **changes)


def test_nonlearned_takes_the_nearest_with_the_least_summed_travel():
    plan = make_planner("nonlearned_myopic").plan(line_problem(), 0)
    # 0 -> 2 and 3 -> 4 sum to 3; 0 -> 4 and 3 -> 2 would sum to 5.
    assert plan.assignments == {0: Assignment(0), 1: Assignment(1)}


def test_learned_takes_the_likeliest_and_divides_them_with_the_least_travel():
    plan = make_planner("learned_myopic").plan(line_problem(), 0)
    # The two likeliest are at 20 m (1.7) and 4 m (0.3): 0 -> 4 and 3 -> 20 sum to 21, the other way round too; ties
    # aside, the container at 2 m is left out.
    assert {assignment.container for assignment in plan.assignments.values()} == {1, 2}


def test_learned_counts_only_objects_still_needed_and_not_found():
    prob = np.array([[1.0, 0.0], [0.9, 0.0], [0.0, 0.1]])
    problem = line_problem(presence_prob=prob, searched=[0])
    plan = make_planner("learned_myopic").plan(replace(problem, robots=problem.robots[:1]), 0)
    assert plan.assignments == {0: Assignment(0, 0)}  # fetch the known `a` first
    done = replace(problem, robots=problem.robots[:1], state=problem.automaton.run(["a"]))
    assert make_planner("learned_myopic").plan(done, 0).assignments == {0: Assignment(2)}


def test_baselines_send_the_nearest_robot_to_a_known_object():
    prob = np.array([[1.0, 0.0], [0.5, 0.5], [0.5, 0.5]])
    for name in ("nonlearned_myopic", "learned_myopic"):
        plan = make_planner(name).plan(line_problem(presence_prob=prob, searched=[0]), 0)
        assert plan.assignments[1] == Assignment(0, 0)
        assert plan.assignments[0].container in (1, 2)


def test_baselines_remember_an_object_until_its_turn():
    problem = make_problem(
        "(!b U a) & F b", ["a", "b"], [[2, 0], [4, 0]], [[2, 0]], [[0.0, 1.0], [0.5, 0.0]], searched=[0]
    )
    assert make_planner("nonlearned_myopic").plan(problem, 0).assignments == {0: Assignment(1)}
    later = replace(problem, state=problem.automaton.run(["a"]))
    assert make_planner("nonlearned_myopic").plan(later, 0).assignments == {0: Assignment(0, 1)}


@pytest.mark.parametrize("name", ["nonlearned_myopic", "learned_myopic"])
def test_an_interaction_that_can_hurt_is_made_while_no_other_is_under_way(name):
    # After `a`, the next letter is `b` or `c`, and then `d`: of `b` and `c`, the second would undo the first.
    names, prob = ["a", "b", "c", "d"], np.eye(4)
    points = [[0, 0], [2, 0], [9, 0], [5, 5]]
    problem = make_problem("F (a & X ((b | c) & X d))", names, points, [[1, 0], [7, 0]], prob, searched=range(4))
    problem = replace(problem, state=problem.automaton.run(["a"]))
    assert make_planner(name).plan(problem, 0).assignments == {0: Assignment(1, 1), 1: Assignment(WAIT)}
    kept = replace(problem.robots[0], free=False, target=1, interaction=1, remaining_s=1.0)
    under_way = replace(problem, robots=(kept, problem.robots[1]), may_redirect=False)
    assert make_planner(name).plan(under_way, 0).assignments == {1: Assignment(WAIT)}


def test_robots_without_a_container_wait():
    problem = line_problem(searched=[0, 1], presence_prob=np.array([[0, 0], [0, 0], [0.5, 0.5]]))
    plan = make_planner("nonlearned_myopic").plan(problem, 0)
    assert sorted(a.container for a in plan.assignments.values()) == [WAIT, 2]


def test_safe_interactions_leave_every_way_open():
    automaton = build_automaton("(F a & F b) | (!a U c)", ["a", "b", "c"])
    flags = dict(zip(automaton.propositions, safe(automaton)[automaton.initial], strict=True))
    # Doing `a` gives up `!a U c`; `b` costs nothing, and `c` completes the task.
    assert flags == {"a": False, "b": True, "c": True}


def test_needed_looks_ahead_through_the_order():
    automaton = build_automaton("((!c & !b) U a) & (!c U b) & F c", ["a", "b", "c"])
    assert needed(automaton)[automaton.initial].all()
    assert list(needed(automaton)[automaton.run(["a"])]) == [False, True, True]
    assert not needed(automaton)[automaton.run(["a", "b", "c"])].any()


BASELINES = ("nonlearned_myopic", "learned_myopic")
TEAM_PLANNERS = {"nonlearned_myopic": {}, "learned_myopic": {}, "greedy": {}, "pouct": {"samples": 200}}


def under_way(robot, target):
    return replace(robot, free=False, target=target, remaining_s=float(robot.travel_s[target]))


@pytest.mark.parametrize("name", TEAM_PLANNERS)
def test_a_container_that_a_robot_is_searching_is_taken(name):
    problem = make_problem(
        "F a & F b", ["a", "b"], [[0, 0], [9, 0]], [[0, 0], [1, 0]], [[0.5, 0.5], [0.4, 0.4]], search_time_s=40.0
    )
    searching = replace(problem.robots[0], free=False, remaining_s=30.0)
    problem = replace(problem, robots=(searching, problem.robots[1]))
    assert make_planner(name, TEAM_PLANNERS[name]).plan(problem, 0).assignments == {1: Assignment(1)}


@pytest.mark.parametrize("name", BASELINES)
def test_robots_under_way_are_assigned_anew_after_news(name):
    # Robot 0 is free at 0 m, robot 1 is at 3 m on its way to 20 m: the containers at 2 and 4 m are left to it.
    problem = line_problem(presence_prob=np.array([[0.9, 0.5], [0.8, 0.5], [0.1, 0.1]]))
    problem = replace(problem, robots=(problem.robots[0], under_way(problem.robots[1], 2)))
    assert make_planner(name).plan(problem, 0).assignments == {0: Assignment(0), 1: Assignment(1)}
    for kept in (
        make_planner(name, {"reassign": "free"}).plan(problem, 0),
        make_planner(name).plan(replace(problem, may_redirect=False), 0),
    ):
        assert kept.assignments == {0: Assignment(0)}


@pytest.mark.parametrize("name", BASELINES)
def test_a_robot_that_is_redirected_leaves_its_container_to_others(name):
    # An object was found at 20 m, where robot 0 stands free; robot 1, on its way there, has nothing left to look for.
    problem = line_problem(searched=[0, 1, 2], presence_prob=np.array([[0, 0], [0, 0], [1, 1]]))
    robots = (replace(problem.robots[0], travel_s=problem.travel_s[2], place=2), under_way(problem.robots[1], 2))
    plan = make_planner(name).plan(replace(problem, robots=robots), 0)
    assert plan.assignments[0].container == 2
    assert plan.assignments[1] == Assignment(WAIT)


def test_greedy_redirects_only_where_it_may():
    problem = line_problem(presence_prob=np.array([[0.9, 0.5], [0.8, 0.5], [0.1, 0.1]]))
    problem = replace(problem, robots=(problem.robots[0], under_way(problem.robots[1], 2)))
    assert make_planner("greedy").plan(problem, 0).assignments.keys() == {0, 1}
    assert make_planner("greedy", {"reassign": "free"}).plan(problem, 0).assignments.keys() == {0}


@pytest.mark.parametrize("name", BASELINES)
def test_known_containers_are_left_alone_until_all_that_was_found_completes_the_task(name):
    patient = make_planner(name, {"return_to_known": "when_complete"})
    half = line_problem(searched=[0], presence_prob=np.array([[1, 0], [0.5, 0.5], [0.4, 0.4]]))
    assert {a.container for a in patient.plan(half, 0).assignments.values()} == {1, 2}
    whole = line_problem(searched=[0, 2], presence_prob=np.array([[1, 0], [0.4, 0.4], [0, 1]]))
    # The robot at 3 m is nearest to the container at 2 m; nobody goes on searching.
    assert patient.plan(whole, 0).assignments == {1: Assignment(0, 0), 0: Assignment(2, 1)}
    ordered = make_problem(
        "(!b U a) & F b", ["a", "b"], [[2, 0], [4, 0], [20, 0]], [[3, 0]], [[1, 0], [0, 1], [0.4, 0.4]], searched=[0, 1]
    )
    assert patient.plan(ordered, 0).assignments == {0: Assignment(0, 0)}


@pytest.mark.parametrize("name", BASELINES)
def test_the_long_way_is_taken_when_the_short_one_is_gone(name):
    formula = "(!b U a) | F (b & X F c)"
    prob = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.5, 0.5]]
    points, start = [[2, 0], [4, 0], [20, 0]], [[0, 0]]
    open_yet = make_problem(formula, ["a", "b", "c"], points, start, prob, searched=[0, 1])
    assert make_planner(name).plan(open_yet, 0).assignments == {0: Assignment(2)}
    gone = make_problem(formula, ["a", "b", "c"], points, start, [*prob[:2], [0, 0, 0]], searched=[0, 1, 2])
    assert make_planner(name).plan(gone, 0).assignments == {0: Assignment(0, 1)}
    patient = make_planner(name, {"return_to_known": "when_complete"})
    assert patient.plan(open_yet, 0).assignments == {0: Assignment(0, 1)}  # b and c would complete the task
