"""Translate a planning problem into the terms of `pouct_paper`'s compiled search."""

from typing import Any

import numpy as np

from mrtask.arrays import Floats, Ints
from mrtask.planning.greedy import LATER_WEIGHT, policy
from mrtask.planning.paper import belief_kernel as kernel
from mrtask.planning.paper.leaf_kernel import Bound, Rollouts
from mrtask.planning.problem import ANY_SAFE, PlanningProblem, RobotKind, needed
from mrtask.planning.shared_kernel import AUTOMATON, NONE
from mrtask.planning.team_model import (
    blank_records,
    blank_world,
    kind_fields,
    masks,
    state_records,
    stuck_penalty_s,
    team_model,
    ways_s,
)
from mrtask.tasks.automaton import Automaton

MAX_OBJECTS = 30
MAX_SETS = 4096
MIN_PROB = 1e-6
"""The least likelihood of an object in a container that may be searched: where all likelihoods say that the object is
nowhere, and where rounding would rule a container out."""


def paper_model(
    problem: PlanningProblem, *, exists: bool = False, redirect: bool = False, round_decimals: int | None = None
) -> kernel.PaperModel:
    """Return the data that do not change while planning; for the options see `PaperOptions`.

    Raises:
        ValueError: the task has more objects than the kernel's bit masks hold, or a robot cannot touch all of them.
    """
    if not problem.handles.all():
        raise ValueError(
            "pouct_paper knows robots that differ in their speed, times and ways, not in what they can touch; leave "
            "out `handles`, or the planner"
        )
    objects = problem.presence_prob.shape[1]
    if objects > MAX_OBJECTS:
        raise ValueError(f"pouct_paper handles tasks of up to {MAX_OBJECTS} objects, this one has {objects}")
    automaton = problem.automaton
    prob = _search_prob(problem, round_decimals)
    return kernel.PaperModel(
        travel_s=ways_s(problem),
        prob=prob,
        possible=masks(prob > 0),
        transitions=automaton.transitions.astype(np.int64),
        states=state_records(automaton, problem.obtainable()),
        sufficient=sufficient_sets(automaton),
        least_interact_time_s=min(problem.kinds[robot.kind].interact_time_s for robot in problem.robots),
        penalty_s=stuck_penalty_s(problem),
        exists=exists,
        redirect=redirect,
    )


def root_belief(problem: PlanningProblem, model: kernel.PaperModel) -> kernel.PaperBelief:
    """Return what the team knows and does now.

    With ``model.redirect``, robots under way decide where the problem allows it.
    """
    there = problem.presence_prob > 0
    root = blank_belief(problem)
    root.containers.present[:] = masks(there & problem.searched[:, None])
    root.containers.absent[:] = masks(~there & problem.searched[:, None])
    root.containers.searched[:] = problem.searched
    root.nowhere[:] = np.prod(1.0 - model.prob, axis=0)
    root.state[AUTOMATON] = problem.state
    root.state[kernel.LOCATED] = masks(problem.found()[None])[0]
    for index, robot in enumerate(problem.robots):
        record = root.robots[index]
        kind = problem.kinds[robot.kind]
        record.place = robot.place
        record.origin = NONE if robot.place < 0 else record.rows + robot.place
        if robot.free:
            record.undecided = 1
        elif robot.target >= 0:
            searching_s = 0.0 if problem.searched[robot.target] else kind.search_time_s
            _put(record, robot.target, robot.interaction, robot.remaining_s + searching_s, problem, kind)
            record.reach_s, record.origin = robot.remaining_s, NONE
            if model.redirect and problem.may_redirect:
                record.obj, record.undecided, record.under_way = NONE, 1, 1
        elif robot.interacting >= 0:
            _put(record, robot.place, robot.interacting, robot.remaining_s - kind.interact_time_s, problem, kind)
        else:
            _put(record, robot.place, robot.interaction, robot.remaining_s, problem, kind)
    return root


def blank_belief(problem: PlanningProblem) -> kernel.PaperBelief:
    """Return a belief of the problem's size, to be overwritten.

    Only the robots' distances from their present positions are filled in.
    """
    (containers, objects), robots = problem.presence_prob.shape, len(problem.robots)
    return kernel.PaperBelief(
        clock=np.zeros(1),
        state=np.zeros(3, dtype=np.int64),
        containers=blank_records(containers, kernel.CONTAINER),
        nowhere=np.ones(objects),
        robots=blank_records(robots, kernel.ROBOT, place=NONE, obj=NONE, origin=NONE, **kind_fields(problem)),
        away=np.array([robot.travel_s for robot in problem.robots], dtype=np.float64),
    )


def bound_of(problem: PlanningProblem, kind: int) -> Bound:
    """Return the bound ZERO, NEAREST or REVEALED of `mrtask.planning.paper.leaf_kernel`, with its scratch space."""
    containers, objects = problem.presence_prob.shape
    return Bound(
        kind=kind,
        nearest_s=np.empty(containers),
        order=np.empty(containers, dtype=np.int64),
        nowhere=np.empty(objects),
        rest_s=np.empty(objects),
    )


def rollouts_of(problem: PlanningProblem) -> Rollouts:
    """Return the greedy policy and its world for the problem."""
    return Rollouts(team_model(problem), blank_world(problem), policy(problem, LATER_WEIGHT))


def _search_prob(problem: PlanningProblem, round_decimals: int | None) -> Floats:
    """Return the likelihoods [C, O] in unsearched containers.

    An object whose likelihoods are all 0 is looked for nevertheless.
    """
    unsearched = ~problem.searched & problem.reach.any(axis=0)
    prob = np.where(unsearched[:, None], problem.presence_prob, 0.0)
    if round_decimals is not None:
        prob = np.where(prob > 0.0, np.maximum(prob.round(round_decimals), MIN_PROB), 0.0)
    nowhere = ~problem.found() & (prob == 0.0).all(axis=0)
    return np.ascontiguousarray(np.where(unsearched[:, None] & nowhere, MIN_PROB, prob))


def sufficient_sets(automaton: Automaton) -> Ints:
    """Return, for each state, the minimal sets of objects along which advancing steps accept.

    They are bit masks, [Z, S], padded with -1.

    Raises:
        ValueError: a state has more than `MAX_SETS` minimal sets.
    """
    sets: list[set[int]] = [{0} if accepting else set() for accepting in automaton.accepting]
    changed = True
    while changed:
        changed = False
        for state, advancing in enumerate(automaton.advancing):
            grown = set(sets[state])
            for obj in np.flatnonzero(advancing):
                grown |= {members | (1 << int(obj)) for members in sets[automaton.transitions[state, obj]]}
            minimal = {one for one in grown if not any(other != one and other & one == other for other in grown)}
            if len(minimal) > MAX_SETS:
                raise ValueError(f"more than {MAX_SETS} ways to complete the task; simplify the formula")
            if minimal != sets[state]:
                sets[state], changed = minimal, True
    table = np.full((len(sets), max(1, *map(len, sets))), NONE, dtype=np.int64)
    for state, members in enumerate(sets):
        table[state, : len(members)] = sorted(members)
    return table


def _put(record: Any, place: int, obj: int, arrive_s: float, problem: PlanningProblem, kind: RobotKind) -> None:
    """Set a robot's action under way.

    An action of another planner may name no object; it counts as one for the first needed object.
    """
    record.place = place
    record.obj = obj if obj != ANY_SAFE else int(np.argmax(needed(problem.automaton)[problem.state]))
    record.arrive_s = arrive_s
    record.done_s = arrive_s + kind.interact_time_s
