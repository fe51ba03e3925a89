"""First decisions with the shipped options against the exact optimum, and the compiled solver that finds it."""

import numpy as np
import pytest

from mrtask.planning.planners import make_planner
from tests.planning.exact_solver import ExactSolver
from tests.planning.exactness import first_actions
from tests.planning.fast_solver import FastSolver
from tests.planning.problems import tiny_problem
from tests.planning.regret import regret_problem

HARD = (28, 255, 271)
"""Problems of two robots whose best joint action looks bad until both of its parts were tried together."""


@pytest.mark.parametrize("first", range(0, 24, 6))
def test_the_compiled_solver_equals_the_plain_one(first):
    for number in range(first, first + 6):
        problem = tiny_problem(number)
        if len(problem.robots) * len(problem.searched) > (2 if problem.interact_time_s else 4):
            continue  # plain Python would take too long
        fast, slow = FastSolver(problem, problem.presence_prob), ExactSolver(problem, problem.presence_prob)
        assert fast.optimum() == pytest.approx(slow.optimum(), rel=1e-12)
        joint = first_actions("pouct", make_planner("pouct", {"samples": 50}).plan(problem, number))
        assert fast.value(joint) == pytest.approx(slow.value(joint), rel=1e-12)


@pytest.mark.parametrize("number", HARD)
def test_the_search_does_not_lock_in_to_its_first_impression(number):
    problem = regret_problem(number)
    solver = FastSolver(problem, problem.presence_prob)
    optimum_s = solver.optimum()
    plans = [make_planner("pouct").plan(problem, seed) for seed in range(3)]
    worse = np.array([solver.value(first_actions("pouct", plan)) / optimum_s - 1 for plan in plans])
    assert (worse < 0.02).all()
