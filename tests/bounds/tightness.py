"""How far the lower bounds are below the exact optimum on small problems, and that they are never above it.

    python -m tests.bounds.tightness [--problems 300] [--first 0]

Bounds are means over all worlds of the belief, so there is no sampling error; the optimum is that of `exact_solver`.
"""

import argparse
import sys
import time
from collections import defaultdict

import numpy as np

from tests.bounds.enumeration import mean_bounds
from tests.planning.fast_solver import FastSolver
from tests.planning.problems import tiny_problem

ROUNDING = 1e-9


def gaps(problem):
    """(bound, clairvoyant bound) as shares of the optimum, and whether the bound should be the optimum."""
    bound_s, clairvoyant_s, exact = mean_bounds(problem)
    optimum_s = FastSolver(problem, problem.presence_prob).optimum()
    return bound_s / optimum_s, clairvoyant_s / optimum_s, exact


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=300)
    parser.add_argument("--first", type=int, default=0, help="number of the first problem")
    arguments = parser.parse_args()
    sys.setrecursionlimit(100_000)
    found, above, bounding_s = defaultdict(list), [], 0.0
    for number in range(arguments.first, arguments.first + arguments.problems):
        problem = tiny_problem(number)
        before_s = time.process_time()
        mean_bounds(problem)
        bounding_s += time.process_time() - before_s
        bound, clairvoyant, exact = gaps(problem)
        team = "1 robot, no waiting" if exact else "1 robot" if len(problem.robots) == 1 else "2 and 3 robots"
        found[team].append((1 - bound, 1 - clairvoyant))
        if max(bound, clairvoyant) > 1 + ROUNDING:
            above.append(number)
            print(f"problem {number} ({problem.automaton.formula}): bound {bound:.6f}, clairvoyant {clairvoyant:.6f}")
    print(f"{arguments.problems} problems, bounds above the optimum: {len(above)}; {bounding_s:.0f} CPU s for bounds")
    print(f"{'':22} {'n':>4} | gap to the optimum: {'mean':>6} {'median':>6} {'max':>6} | clairvoyant: {'mean':>6} "
          f"{'median':>6} {'max':>6}")  # fmt: skip
    for team, values in sorted(found.items()):
        own, clairvoyant = np.array(values).T
        print(
            f"{team:22} {len(values):4} | {'':20}{own.mean():6.3f} {np.median(own):6.3f} {own.max():6.3f} | {'':13}"
            f"{clairvoyant.mean():6.3f} {np.median(clairvoyant):6.3f} {clairvoyant.max():6.3f}"
        )


if __name__ == "__main__":
    main()
