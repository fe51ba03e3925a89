"""Small planning problems, random and by hand."""

from dataclasses import replace

import numpy as np

from mrtask.planning.problem import PlanningProblem, RobotKind, RobotStatus
from mrtask.tasks.automaton import build_automaton
from mrtask.tasks.templates import PAPER_TEMPLATES, TEMPLATES, make_formula

NAMES = ("a", "b", "c", "d")
SHAPES = {
    "and2": ((1, 4), (2, 2), (3, 1), (1, 3), (2, 3), (3, 2), (1, 2)),
    "and3": ((1, 2), (2, 2), (3, 1), (1, 3), (2, 1)),
    "and_or": ((1, 3), (2, 2), (3, 1), (1, 4), (2, 1), (1, 2)),
    "seq2": ((3, 2), (1, 4), (2, 2), (1, 3), (3, 1), (2, 3)),
    "seq3": ((2, 2), (1, 3), (3, 1), (1, 4), (2, 1)),
    "or_seq": ((1, 2), (2, 1), (1, 3), (2, 2), (3, 1)),
}
"""Robots and containers of `tiny_problem`: what plain Python solves exactly in seconds."""


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
    kind = RobotKind(np.hypot(*(points[:, None] - points).transpose(2, 0, 1)), **times)
    robots = []
    for start in starts:
        away_s = np.hypot(*(points - start).T)
        at = np.flatnonzero(away_s == 0)
        robots.append(RobotStatus(away_s, place=int(at[0]) if len(at) else -1))
    return PlanningProblem(automaton, automaton.initial, np.asarray(prob, dtype=float), done, (kind,), tuple(robots))


def tiny_problem(number):
    """The ``number``-th of endless random problems of all six templates: 1 to 3 robots, up to 4 containers.

    In about half of them searches take time, in half interactions do, in half the robots start apart. In some a
    container was searched before; in some the last robot is under way.
    """
    rng = np.random.default_rng([number, 20260320])
    template = PAPER_TEMPLATES[number % len(PAPER_TEMPLATES)]
    robots, containers = SHAPES[template][number // len(PAPER_TEMPLATES) % len(SHAPES[template])]
    names = NAMES[: TEMPLATES[template].arity]
    prob = np.clip(rng.beta(0.5, 1.0, (containers, len(names))), 0.05, 0.95)
    searched = [0] if containers > 1 and rng.random() < 0.3 else []
    prob[searched] = rng.random((len(searched), len(names))) < 0.5
    starts = rng.random((robots, 2)) * 10
    if rng.random() < 0.5:
        starts[:] = starts[0]
    problem = make_problem(
        make_formula(template, names),
        names,
        rng.random((containers, 2)) * 10,
        starts,
        prob,
        searched=searched,
        search_time_s=float(rng.choice([0.0, 2.0])) * rng.random(),
        interact_time_s=float(rng.choice([0.0, 2.0])) * rng.random(),
    )
    if robots > 1 and rng.random() < 0.3:
        last, target = problem.robots[-1], containers - 1
        under_way = replace(last, free=False, target=target, remaining_s=float(last.travel_s[target]))
        problem = replace(problem, robots=(*problem.robots[:-1], under_way))
    return problem


def unlike(problem, seed, *, abilities=True):
    """The problem with a kind for each robot: other speeds and times and, with ``abilities``, other ways and skills.

    Each object can be touched by a robot that gets to every container.
    """
    rng = np.random.default_rng([seed, 20261201])
    containers, objects = problem.presence_prob.shape
    able = int(rng.integers(len(problem.robots)))
    kinds, robots = [], []
    for index, robot in enumerate(problem.robots):
        slower = float(rng.choice([0.5, 1.0, 2.0, 3.0]))
        barred = (rng.random(containers) < 0.3) & (abilities and index != able)
        if robot.place >= 0:
            barred[robot.place] = False
        if robot.target >= 0:
            barred[robot.target] = False
        like = problem.kinds[robot.kind]
        travel_s = np.where(barred | barred[:, None], np.inf, like.travel_s * slower)
        handles = rng.random(objects) < 0.5 if abilities and index != able else None
        times = {"search_time_s": like.search_time_s * slower, "interact_time_s": like.interact_time_s / slower}
        kinds.append(RobotKind(travel_s, handles=handles, **times))
        away_s = np.where(barred, np.inf, robot.travel_s * slower)
        robots.append(replace(robot, travel_s=away_s, kind=index, remaining_s=robot.remaining_s * slower))
    return replace(problem, kinds=tuple(kinds), robots=tuple(robots))
