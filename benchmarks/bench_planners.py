"""Measure the search planners on one core: samples per second by team size and number of containers, and memory.

    python benchmarks/bench_planners.py [samples]

The problems are random, on a square of 12 m, with three objects in any order. CPU time counts, so other load on the
machine matters less. Only compare figures from the same run.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np

from mrtask.planning.planners import make_planner
from mrtask.planning.problem import PlanningProblem, RobotKind, RobotStatus
from mrtask.tasks.automaton import build_automaton
from mrtask.tasks.templates import make_formula

ROBOTS = (1, 2, 3)
CONTAINERS = (10, 20, 30, 50)
OBJECTS = ("a", "b", "c")
PLANNERS = ("pouct", "pouct_paper")
ONE_PLAN = (
    "import time; began = time.process_time(); import sys; sys.path.insert(0, 'benchmarks');"
    "from bench_planners import make_planner, random_problem; imported = time.process_time();"
    "make_planner('{planner}', {{'samples': 1}}).plan(random_problem(2, 10), 0);"
    "print(time.process_time() - imported)"
)


def random_problem(robots: int, containers: int, seed: int = 0) -> PlanningProblem:
    """Draw a problem on the plane with skewed likelihoods and all robots at one start."""
    rng = np.random.default_rng(seed)
    automaton = build_automaton(make_formula("and3", OBJECTS), OBJECTS)
    points, start = rng.random((containers, 2)) * 12, rng.random(2) * 12
    kinds = (RobotKind(np.hypot(*(points[:, None] - points).transpose(2, 0, 1))),)
    away_s = np.hypot(*(points - start).T)
    likelihood = rng.beta(0.3, 3.0, (containers, len(OBJECTS)))
    team = tuple(RobotStatus(away_s) for _ in range(robots))
    return PlanningProblem(automaton, automaton.initial, likelihood, np.zeros(containers, dtype=bool), kinds, team)


def samples_per_second(planner_name: str, problem: PlanningProblem, samples: int) -> float:
    """Return the number of samples that a plan took, divided by its CPU time."""
    planner = make_planner(planner_name, {"samples": samples})
    began_s = time.process_time()
    plan = planner.plan(problem, seed=0)
    return plan.info.samples / (time.process_time() - began_s)


def compile_seconds(planner_name: str, cache_dir: str) -> float:
    """Return the CPU seconds of a process's first plan."""
    command = [sys.executable, "-c", ONE_PLAN.format(planner=planner_name)]
    environment = os.environ | {"NUMBA_CACHE_DIR": cache_dir}
    return float(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)


def main() -> None:
    """Print the tables."""
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    print(f"thousand samples per CPU second, {samples} samples at most, {len(OBJECTS)} objects")
    print(f"{'planner':12} {'robots':>6} " + " ".join(f"{containers:>4} containers" for containers in CONTAINERS))
    for name in PLANNERS:
        make_planner(name, {"samples": 10}).plan(random_problem(1, 5), 0)
        for robots in ROBOTS:
            row = [samples_per_second(name, random_problem(robots, count), samples) for count in CONTAINERS]
            print(f"{name:12} {robots:6} " + " ".join(f"{speed / 1e3:15.0f}" for speed in row))
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of this process {peak_mb:.0f} MB")
    for name in PLANNERS:
        with tempfile.TemporaryDirectory() as cache_dir:
            cold_s, warm_s = compile_seconds(name, cache_dir), compile_seconds(name, cache_dir)
        print(f"{name}: first plan of a process {cold_s:.1f} s without cached kernels, {warm_s:.1f} s with them")


if __name__ == "__main__":
    main()
