"""First decisions with the shipped options against the exact optimum, and the compiled solver that finds it."""

from dataclasses import replace

import numpy as np
import pytest

from mrtask.planning.planners import make_planner
from tests.planning.exact_solver import ExactSolver
from tests.planning.exactness import first_actions
from tests.planning.fast_solver import FastSolver
from tests.planning.problems import random_problem, tiny_problem, unlike
from tests.planning.regret import regret_problem
from tests.planning.test_known import random_truth

HARD = (28, 255, 271)
"""Problems of two robots whose best joint action looks bad until both of its parts were tried together."""
UNLIKE = (17, 33, 48, 63)
"""Problems of two robots that are small enough to be solved in a moment."""


@pytest.mark.parametrize("first", range(0, 24, 6))
def test_the_compiled_solver_equals_the_plain_one(first):
    for number in range(first, first + 6):
        problem = tiny_problem(number)
        problem = unlike(problem, number) if number % 2 else problem
        if len(problem.robots) * len(problem.searched) > (2 if problem.interacting_takes_time else 4):
            continue  # plain Python would take too long
        fast, slow = FastSolver(problem, problem.presence_prob), ExactSolver(problem, problem.presence_prob)
        assert fast.optimum() == pytest.approx(slow.optimum(), rel=1e-12)
        joint = first_actions("pouct", make_planner("pouct", {"samples": 50}).plan(problem, number))
        assert fast.value(joint) == pytest.approx(slow.value(joint), rel=1e-12)


@pytest.mark.parametrize("number", UNLIKE)
def test_robots_that_differ_decide_nearly_as_well_as_can_be(number):
    problem = unlike(regret_problem(number), number)
    solver = FastSolver(problem, problem.presence_prob)
    plan = make_planner("pouct", {"samples": 20_000}).plan(problem, number)
    assert solver.value(first_actions("pouct", plan)) <= solver.optimum() * 1.02


@pytest.mark.parametrize("number", HARD)
def test_the_search_does_not_lock_in_to_its_first_impression(number):
    problem = regret_problem(number)
    solver = FastSolver(problem, problem.presence_prob)
    optimum_s = solver.optimum()
    plans = [make_planner("pouct").plan(problem, seed) for seed in range(3)]
    worse = np.array([solver.value(first_actions("pouct", plan)) / optimum_s - 1 for plan in plans])
    assert (worse < 0.02).all()


def known_problem(number):
    """A problem that `known` must search: what is where is told, and searches of two robots take time."""
    problem = random_problem(number, template="and2", robots=2, containers=3, search_time_s=1.0)
    return replace(problem, presence_prob=random_truth(number, problem.presence_prob.shape).astype(float))


@pytest.mark.parametrize(
    ("name", "problem_of"), [("pouct", regret_problem), ("pouct", tiny_problem), ("known", known_problem)]
)
def test_the_expected_time_to_go_is_the_time_of_the_best_decisions(name, problem_of):
    # The mean over all samples, with those that explore, would be more than one percent too long.
    said = []
    for number in range(30):
        problem = problem_of(number)
        plan = make_planner(name, {"samples": 3000}).plan(problem, number)
        assert plan.info.samples > 0
        said.append(plan.info.value_s / FastSolver(problem, problem.presence_prob).optimum())
    assert np.mean(said) == pytest.approx(1.0, abs=0.005)
