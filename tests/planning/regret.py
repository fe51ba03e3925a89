"""How much worse than the optimum `pouct`'s first decisions are, on many small problems and with the shipped options.

    python -m tests.planning.regret [--problems 1000] [--samples 10000 100000] [--seeds 0 1 2] [--closed]

A problem's regret is how much longer than the optimum the task takes, in expectation, after the planner's first joint
action if all that follows is optimal; with ``--closed``, if the planner makes all decisions that follow. Optima come
from `fast_solver` and are kept in ``--cache``.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from mrtask.execution.trials import key_seed
from mrtask.planning.planners import make_planner
from mrtask.planning.problem import ANY_SAFE, RobotStatus
from mrtask.tasks.templates import PAPER_TEMPLATES, TEMPLATES, make_formula
from tests.planning.exact_solver import ExactSolver
from tests.planning.exactness import first_actions
from tests.planning.fast_solver import FastSolver
from tests.planning.problems import NAMES, make_problem

ORDERED = (
    "F (a & X b)",
    "F (a & X (b & X c))",
    "F (a & X (b | c))",
    "F (a & X b) | F (c & X b)",
    "F a & (F (b & X c))",
    "(!a U b) & F a & F c",
    "F (a & F (b & F c))",
    "F (a & X F b)",
    "(F a) U (b & F c)",
)
"""Tasks in which the order of interactions matters."""
TASKS = [(make_formula(name, NAMES[: TEMPLATES[name].arity]), TEMPLATES[name].arity) for name in PAPER_TEMPLATES]
TASKS += [(formula, 1 + max(NAMES.index(letter) for letter in formula if letter in NAMES)) for formula in ORDERED]
SHAPES = {2: ((1, 3), (2, 3), (2, 4), (2, 2), (1, 4)), 3: ((1, 3), (2, 2), (2, 3), (1, 4)), 4: ((1, 3), (2, 2))}
"""Robots and containers by the number of objects: what is solved exactly in seconds."""


def regret_problem(number):
    """The ``number``-th of endless random problems; in half of those with two robots, the last one is under way."""
    rng = np.random.default_rng([number, 20260401])
    formula, arity = TASKS[number % len(TASKS)]
    shapes = SHAPES[arity]
    robots, containers = shapes[number // len(TASKS) % len(shapes)]
    prob = np.clip(rng.beta(0.5, 1.0, (containers, arity)), 0.05, 0.95)
    searched = [0] if rng.random() < 0.3 else []
    prob[searched] = rng.random((len(searched), arity)) < 0.5
    starts = rng.random((robots, 2)) * 10
    if rng.random() < 0.5:
        starts[:] = starts[0]
    points = rng.random((containers, 2)) * 10
    search_time_s = float(rng.choice([0.0, 2.0])) * rng.random()
    problem = make_problem(formula, NAMES[:arity], points, starts, prob, searched=searched, search_time_s=search_time_s)
    if robots > 1 and rng.random() < 0.5:
        last, target = problem.robots[-1], containers - 1
        under_way = replace(last, free=False, target=target, remaining_s=float(last.travel_s[target]))
        problem = replace(problem, robots=(*problem.robots[:-1], under_way))
    return problem


class Optima:
    """The exact values of problems' first joint actions, kept in a file."""

    def __init__(self, path):
        self.path = Path(path)
        self.known = json.loads(self.path.read_text()) if self.path.exists() else {}

    def value(self, number, problem, joint=None):
        key = f"{number} {sorted(joint.items()) if joint else ''}"
        if key not in self.known:
            solver = FastSolver(problem, problem.presence_prob)
            self.known[key] = solver.value(joint) if joint else solver.optimum()
        return self.known[key]

    def save(self):
        self.path.write_text(json.dumps(self.known))


class ClosedLoop(ExactSolver):
    """The expected makespan when a planner makes all decisions, over every outcome of every search.

    As in an episode, each decision has a seed of its own.
    """

    def __init__(self, problem, planner, seed):
        super().__init__(problem, problem.presence_prob)
        self.planner, self.seed, self.decisions = planner, seed, 0

    def _decide(self, state):
        self.decisions += 1
        plan = self.planner.plan(self._seen(state), key_seed(self.seed, self.decisions))
        for robot, action in first_actions("pouct", plan).items():
            state = self._act(state, robot, action)
        return self._expected(replace(state, undecided=frozenset()))

    def _seen(self, state):
        """A state as the planner sees it."""
        searched = np.array([held is not None for held in state.held])
        prob = self.prob.copy()
        for c in np.flatnonzero(searched):
            prob[c] = [o in state.held[c] for o in range(prob.shape[1])]
        return replace(
            self.problem,
            state=state.z,
            presence_prob=prob,
            searched=searched,
            robots=tuple(self._status(state, r) for r in range(len(state.robots))),
            may_redirect=any(state.robots[r].moving for r in state.undecided),
        )

    def _status(self, state, r):
        robot = state.robots[r]
        away_s = np.array([self._distance(state, r, c) for c in range(len(state.held))])
        if robot.action is None:
            return RobotStatus(away_s, place=-1 if robot.place is None else robot.place)
        container, named = robot.action
        busy = not robot.moving
        return RobotStatus(
            away_s,
            place=container if busy else -1,
            free=False,
            target=-1 if busy else container,
            interaction=ANY_SAFE if named is None else named,
            remaining_s=robot.until - state.clock,
            interacting=robot.busy if isinstance(robot.busy, int) else -1,
        )


def regret(number, optima, samples, seed, closed=False):
    problem, planner = regret_problem(number), make_planner("pouct", {"samples": samples})
    best_s = optima.value(number, problem)
    if closed:
        return ClosedLoop(problem, planner, seed).optimum() / best_s - 1, np.nan
    plan = planner.plan(problem, seed)
    return optima.value(number, problem, first_actions("pouct", plan)) / best_s - 1, plan.info.value_s / best_s


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--samples", type=int, nargs="+", default=[10_000, 100_000])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--closed", action="store_true")
    parser.add_argument("--cache", default="optima.json")
    arguments = parser.parse_args()
    optima = Optima(arguments.cache)
    for samples in arguments.samples:
        for seed in arguments.seeds:
            found = np.array(
                [
                    regret(number, optima, samples, 1000 * seed + number, arguments.closed)
                    for number in range(arguments.first, arguments.first + arguments.problems)
                ]
            )
            optima.save()
            regrets, values = found.T
            worst = {int(i) + arguments.first: round(float(regrets[i]), 4) for i in np.argsort(-regrets)[:12]}
            print(
                f"{samples} samples, seed {seed}: mean {regrets.mean():.3%}, above 2 %: {(regrets > 0.02).mean():.2%}, "
                f"above 5 %: {(regrets > 0.05).mean():.2%}; value over optimum {values.mean():.4f}; worst {worst}",
                flush=True,
            )


if __name__ == "__main__":
    main()
