"""`pouct_paper` against the exact optimum of its own abstraction.

``python -m tests.planning.exactness`` does it on hundreds of problems, for `pouct` too, and prints the table.
"""

import numpy as np
import pytest

from tests.planning.exact_paper_solver import ExactPaperSolver
from tests.planning.exactness import EXACT, errors, exact_solver
from tests.planning.problems import make_problem, tiny_problem


def test_the_exact_solver_agrees_with_cases_by_hand():
    # One robot between two containers 1 and 2 away, 3 apart; `a` is in each with 0.5; if in none, 100 on top.
    problem = make_problem("F a", ["a"], [[-1, 0], [2, 0]], [[0, 0]], [[0.5], [0.5]])
    solver = ExactPaperSolver(problem, penalty_s=100.0)
    assert solver.value({0: (0, 0)}) == pytest.approx(1 + 0.5 * (3 + 0.5 * 100))
    assert solver.value({0: (1, 0)}) == pytest.approx(2 + 0.5 * (3 + 0.5 * 100))
    assert solver.optimum() == pytest.approx(1 + 0.5 * (3 + 0.5 * 100))
    # Two robots, `a` at 3 for certain and `b` at 4: both at once, each interaction takes 2 s.
    problem = make_problem(
        "F a & F b",
        ["a", "b"],
        [[3, 0], [-4, 0]],
        [[0, 0], [0, 0]],
        [[1, 0], [0, 1]],
        searched=[0, 1],
        interact_time_s=2.0,
    )
    solver = ExactPaperSolver(problem, penalty_s=100.0)
    assert solver.optimum() == pytest.approx(4 + 2)
    assert solver.value({0: (0, 0), 1: -1}) == pytest.approx(3 + 2 + 4 + 2)
    # A search of 1 s is paid once: the second object is looked for where the robot stands.
    problem = make_problem("F a & F b", ["a", "b"], [[3, 0]], [[0, 0]], [[0.5, 0.25]], search_time_s=1.0)
    solver = ExactPaperSolver(problem, penalty_s=100.0)
    assert solver.optimum() == pytest.approx(4 + (1 - 0.5 * 0.25) * 100)


def test_pouct_paper_comes_to_the_exact_optimum_and_more_samples_err_less():
    found = {30: [], 1_000_000: []}
    for number in range(8):
        problem = tiny_problem(number)
        solver = exact_solver("pouct_paper", problem)
        for samples, seen in found.items():
            seen.append(errors("pouct_paper", problem, solver, samples))
    few, many = (np.array(seen) for seen in found.values())
    assert (many < EXACT).all()
    assert (many.mean(axis=0) < few.mean(axis=0)).all()


@pytest.mark.parametrize("options", [{"leaf": "zero"}, {"exists": True}, {"leaf": "greedy", "exists": True}], ids=str)
def test_other_leaf_values_and_likelihoods_come_to_the_optimum_too(options):
    for number in (3, 9):
        problem = tiny_problem(number)
        solver = exact_solver("pouct_paper", problem, exists=options.get("exists", False))
        assert max(errors("pouct_paper", problem, solver, 400_000, options=options)) < EXACT
