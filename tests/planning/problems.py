"""Small planning problems, random and by hand."""

import numpy as np

from mrtask.planning.problem import PlanningProblem, RobotStatus
from mrtask.tasks.automaton import build_automaton
from mrtask.tasks.templates import TEMPLATES, make_formula

NAMES = ("a", "b", "c", "d")


def random_problem(seed, *, template="and2", robots=1, containers=3, search_time_s=0.0, interact_time_s=0.0):
    """Containers and a common start on a 10 m square, likelihoods skewed towards 0."""
    rng = np.random.default_rng(seed)
    names = NAMES[: TEMPLATES[template].arity]
    return make_problem(
        make_formula(template, names),
        names,
        points=rng.random((containers, 2)) * 10,
        starts=np.repeat(rng.random((1, 2)) * 10, robots, axis=0),
        prob=np.clip(rng.beta(0.5, 1.0, (containers, len(names))), 0.05, 0.95),
        search_time_s=search_time_s,
        interact_time_s=interact_time_s,
    )


def make_problem(formula, names, points, starts, prob, *, searched=(), **times):
    """A problem on the plane: containers at ``points`` [C, 2], free robots at ``starts`` [R, 2]."""
    points, starts = np.asarray(points, dtype=float), np.asarray(starts, dtype=float)
    automaton = build_automaton(formula, names)
    done = np.zeros(len(points), dtype=bool)
    done[list(searched)] = True
    travel_s = np.hypot(*(points[:, None] - points).transpose(2, 0, 1))
    robots = []
    for start in starts:
        away_s = np.hypot(*(points - start).T)
        at = np.flatnonzero(away_s == 0)
        robots.append(RobotStatus(away_s, place=int(at[0]) if len(at) else -1))
    return PlanningProblem(
        automaton, automaton.initial, np.asarray(prob, dtype=float), done, travel_s, tuple(robots), **times
    )
