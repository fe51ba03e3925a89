"""How far `pouct` and `pouct_paper` are from the exact optimum of their own abstraction, by number of samples.

    python -m tests.planning.exactness [--problems 300] [--samples 100 1000 10000 100000] [--planners pouct pouct_paper]

On the random problems of `tiny_problem`, each solved by the expectimax of `exact_solver` or `exact_paper_solver`. The
error of the value is |root value / optimum - 1|; that of the choice is how much worse than the optimum the chosen joint
action is when all that follows it is optimal.
"""

import argparse
import sys
import time

import numpy as np

from mrtask.planning.planners import make_planner
from mrtask.planning.problem import WAIT
from mrtask.planning.team_model import stuck_penalty_s
from tests.planning.exact_paper_solver import ExactPaperSolver
from tests.planning.fast_solver import FastSolver
from tests.planning.problems import tiny_problem

EXACT = 0.01
OPTIONS = {
    "pouct": {"exploration": 1.5, "widening_exponent": 0.5, "max_nodes": 4_000_000},
    "pouct_paper": {"max_nodes": 4_000_000, "max_actions": None, "exists": False},
}
"""A search that is to find the optimum must come to try every action and not be cut short."""


def exact_solver(name, problem, exists=False):
    """The solver of a planner's own abstraction."""
    if name == "pouct_paper":
        return ExactPaperSolver(problem, stuck_penalty_s(problem), exists)
    return FastSolver(problem, problem.presence_prob)


def first_actions(name, plan):
    """The plan's joint action in the solver's terms."""
    joint = {}
    for robot, (container, interaction) in plan.assignments.items():
        if container == WAIT:
            joint[robot] = WAIT
        elif name == "pouct" and interaction < 0:
            joint[robot] = container
        else:
            joint[robot] = (container, interaction)
    return joint


def errors(name, problem, solver, samples, seed=0, options=None):
    """(error of the root value, error of the chosen joint action), as shares of the optimum."""
    optimum_s = solver.optimum()
    plan = make_planner(name, {**OPTIONS[name], **(options or {}), "samples": samples}).plan(problem, seed)
    chosen_s = solver.value(first_actions(name, plan))
    assert chosen_s >= optimum_s * (1 - 1e-9), f"{name} took an action that the solver does not know"
    return abs(plan.info.value_s / optimum_s - 1), chosen_s / optimum_s - 1


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=300)
    parser.add_argument("--first", type=int, default=0, help="number of the first problem")
    parser.add_argument("--samples", type=int, nargs="+", default=[100, 1_000, 10_000, 100_000])
    parser.add_argument("--planners", nargs="+", default=list(OPTIONS), choices=list(OPTIONS))
    parser.add_argument("--defaults", action="store_true", help="the planners' own options instead of wide open ones")
    parser.add_argument(
        "--verbose", action="store_true", help="name every problem that is off by more than 1 %% at last"
    )
    arguments = parser.parse_args()
    sys.setrecursionlimit(100_000)
    for name in arguments.planners:
        if arguments.defaults:
            OPTIONS[name] = {}
        found = {samples: [] for samples in arguments.samples}
        solving_s, began_s = 0.0, time.process_time()
        for number in range(arguments.first, arguments.first + arguments.problems):
            problem = tiny_problem(number)
            solver = exact_solver(name, problem)
            before_s = time.process_time()
            solver.optimum()
            solving_s += time.process_time() - before_s
            for samples, seen in found.items():
                seen.append(errors(name, problem, solver, samples))
            if arguments.verbose and max(found[arguments.samples[-1]][-1]) > EXACT:
                value, choice = found[arguments.samples[-1]][-1]
                shape = f"{len(problem.robots)} robots, {len(problem.searched)} containers"
                print(
                    f"  problem {number} ({shape}, {problem.automaton.formula}): value {value:.4f} choice {choice:.4f}"
                )
        print(
            f"{name}: {arguments.problems} problems, {time.process_time() - began_s:.0f} CPU s, "
            f"{solving_s:.0f} of them to solve them exactly"
        )
        print(f"{'samples':>9} | {'root value: mean':>16} {'95 %':>7} {'max':>7} {'> 1 %':>5} | "
              f"{'choice: mean':>12} {'95 %':>7} {'max':>7} {'> 1 %':>5}")  # fmt: skip
        for samples, seen in found.items():
            cells = []
            for column, width in zip(np.array(seen).T, (16, 12), strict=True):
                p95 = np.percentile(column, 95)
                cells.append(f"{column.mean():{width}.4f} {p95:7.4f} {column.max():7.4f} {(column > EXACT).sum():5}")
            print(f"{samples:9} | " + " | ".join(cells), flush=True)


if __name__ == "__main__":
    main()
