"""The paper's belief-state abstraction, compiled: concurrent actions <container, object>, outcomes of Algorithm 1.

Legend: R robots, C containers, O objects, Z automaton states, S object sets. Sets of objects are bit masks. An action
is ``container * O + object``.
"""

from typing import NamedTuple

import numpy as np

from mrtask.arrays import Floats, Ints, UInt64s
from mrtask.planning.compiled import Records, inlined, random_unit
from mrtask.planning.problem import SAME_INSTANT_S, WAIT
from mrtask.planning.shared_kernel import AUTOMATON, NONE, copy_team

LOCATED, NEWS = 1, 2
"""Indices of `PaperBelief.state`, after AUTOMATON."""


CONTAINER = np.dtype(
    [
        ("present", np.int64),  # mask of the objects known to be there
        ("absent", np.int64),  # mask of the objects known not to be there
        ("searched", np.int64),
    ],
    align=True,
)
ROBOT = np.dtype(
    [
        ("arrive_s", np.float64),  # time of the action's failure event, in the past once the object is found
        ("done_s", np.float64),  # time of the action's success event
        ("reach_s", np.float64),  # time at which the robot reaches its container, before the search
        ("since_s", np.float64),  # time of departure
        ("search_time_s", np.float64),
        ("interact_time_s", np.float64),
        ("place", np.int64),  # container at which a robot stands or to which it goes, NONE anywhere else
        ("obj", np.int64),  # object of the robot's action, NONE while it is free or waits
        ("origin", np.int64),  # row of `PaperModel.travel_s` of the place of departure, NONE: see `PaperBelief.away`
        ("undecided", np.int64),
        ("under_way", np.int64),  # 1 for a robot that decides again in mid-path
        ("rows", np.int64),  # the first row of the robot's kind in `PaperModel.travel_s`
    ],
    align=True,
)


class PaperModel(NamedTuple):
    """The data that do not change while planning."""

    travel_s: Floats  # [K * C, C] of all kinds of robots, one below the other
    prob: Floats  # [C, O]
    possible: Ints  # [C] mask of the objects whose likelihood is above 0
    transitions: Ints  # [Z, O]
    states: Records  # [Z] of `shared_kernel.STATE`
    sufficient: Ints  # [Z, S] minimal sets of objects that complete the task, padded with NONE
    least_interact_time_s: float
    penalty_s: float  # added to the cost of a sample that cannot finish
    exists: bool  # whether likelihoods are conditioned on every object being somewhere
    redirect: bool  # whether robots under way decide again after news


class PaperBelief(NamedTuple):
    """The team's belief in one sample."""

    clock: Floats  # [1] seconds since the root
    state: Ints  # [3] AUTOMATON state, mask of LOCATED objects (known to be somewhere), NEWS 1 if the last step had any
    containers: Records  # [C] of CONTAINER
    nowhere: Floats  # [O] probability that no container of unknown contents holds the object
    robots: Records  # [R] of ROBOT
    away: Floats  # [R, C] travel times from a place that is not a container


@inlined
def copy_belief(model: PaperModel, source: PaperBelief, target: PaperBelief) -> None:
    """Overwrite the target with the source. Rows of ``away`` change only with ``model.redirect``."""
    copy_team(source, target)
    for r in range(source.robots.size):
        if model.redirect and source.robots[r].origin == NONE:
            for c in range(source.containers.size):
                target.away[r, c] = source.away[r, c]


@inlined
def distance_s(model: PaperModel, belief: PaperBelief, r: int, c: int) -> float:
    """Return the seconds from a robot's place, or from its position in mid-path if it decides there, to a container."""
    robot = belief.robots[r]
    place = robot.place
    if robot.under_way:
        origin = robot.origin
        start_s = belief.away[r, c] if origin == NONE else model.travel_s[origin, c]
        ahead_s = robot.reach_s - belief.clock[0] + model.travel_s[robot.rows + place, c]
        return min(ahead_s, belief.clock[0] - robot.since_s + start_s)
    return belief.away[r, c] if place == NONE else model.travel_s[robot.rows + place, c]


@inlined
def _leave_path(model: PaperModel, belief: PaperBelief, r: int) -> None:
    """Let a robot in mid-path stand where it is."""
    robot = belief.robots[r]
    for c in range(belief.containers.size):
        belief.away[r, c] = distance_s(model, belief, r, c)
    robot.under_way = 0
    robot.place = NONE
    robot.origin = NONE


@inlined
def act(model: PaperModel, belief: PaperBelief, r: int, action: int) -> None:
    """Let a robot begin an action, or wait."""
    robot = belief.robots[r]
    robot.undecided = 0
    objects = model.prob.shape[1]
    container, obj = action // objects, action % objects
    if robot.under_way:
        if action != WAIT and container == robot.place:
            robot.under_way = 0
            _go(model, belief, r, container, obj, robot.reach_s)
            return
        _leave_path(model, belief, r)
    if action == WAIT:
        robot.obj = NONE
        return
    reach_s = belief.clock[0] + distance_s(model, belief, r, container)
    robot.origin = NONE if robot.place == NONE else robot.rows + robot.place
    robot.since_s = belief.clock[0]
    _go(model, belief, r, container, obj, reach_s)


@inlined
def _go(model: PaperModel, belief: PaperBelief, r: int, container: int, obj: int, reach_s: float) -> None:
    robot = belief.robots[r]
    arrive_s = reach_s
    if belief.containers[container].searched == 0:
        arrive_s += robot.search_time_s
    robot.place = container
    robot.obj = obj
    robot.reach_s = reach_s
    robot.arrive_s = arrive_s
    robot.done_s = arrive_s + robot.interact_time_s


@inlined
def presence_prob(model: PaperModel, belief: PaperBelief, c: int, obj: int) -> float:
    """Return P_S, the likelihood of an object in a container: 0 or 1 where the contents are known."""
    if (belief.containers[c].present >> obj) & 1:
        return 1.0
    if (belief.containers[c].absent >> obj) & 1:
        return 0.0
    prob = model.prob[c, obj]
    if model.exists and (belief.state[LOCATED] >> obj) & 1 == 0 and belief.nowhere[obj] < 1.0:
        return min(prob / (1.0 - belief.nowhere[obj]), 1.0)
    return prob


@inlined
def _look(model: PaperModel, belief: PaperBelief, rng: UInt64s, c: int, obj: int) -> bool:
    """Let a robot that has searched a container look for an object there, and return whether it finds it."""
    belief.containers[c].searched = 1
    if ((belief.containers[c].present | belief.containers[c].absent) >> obj) & 1 == 0:
        belief.state[NEWS] = 1
        if random_unit(rng) < presence_prob(model, belief, c, obj):
            belief.containers[c].present |= 1 << obj
            belief.state[LOCATED] |= 1 << obj
        else:
            belief.containers[c].absent |= 1 << obj
            belief.nowhere[obj] = min(belief.nowhere[obj] / (1.0 - model.prob[c, obj]), 1.0)
    return bool((belief.containers[c].present >> obj) & 1)


@inlined
def sample_outcome(model: PaperModel, belief: PaperBelief, rng: UInt64s) -> int:
    """Draw one outcome of Algorithm 1. Return 2 * robot + (1 if found), or NONE if no robot acts.

    The walk visits failure events in the order of time and robot, up to the first success event, which ends it.
    """
    robots = belief.robots.size
    z = belief.state[AUTOMATON]
    belief.state[NEWS] = 0
    success_s, winner = np.inf, NONE
    for r in range(robots):
        if belief.robots[r].obj != NONE:
            advances = (model.states[z].advancing >> belief.robots[r].obj) & 1
            time_s = belief.robots[r].done_s if advances else belief.robots[r].arrive_s
            if winner == NONE or time_s < success_s:
                success_s, winner = time_s, r
    if winner == NONE:
        return NONE
    last_s, last = -np.inf, NONE
    while True:
        event_s, r = np.inf, NONE
        for other in range(robots):
            if belief.robots[other].obj == NONE:
                continue
            time_s = belief.robots[other].arrive_s
            if (time_s > last_s or (time_s == last_s and other > last)) and (time_s < event_s or r == NONE):
                event_s, r = time_s, other
        if r == NONE or event_s > success_s or (event_s == success_s and r > winner):
            break
        last_s, last = event_s, r
        if not _look(model, belief, rng, belief.robots[r].place, belief.robots[r].obj):
            belief.clock[0] = max(belief.clock[0], event_s)
            belief.robots[r].obj = NONE
            return 2 * r
    obj = belief.robots[winner].obj
    if (model.states[z].advancing >> obj) & 1:
        belief.state[AUTOMATON] = model.transitions[z, obj]
        belief.state[NEWS] = 1
    belief.clock[0] = max(belief.clock[0], success_s)
    belief.robots[winner].obj = NONE
    return 2 * winner + 1


@inlined
def mark_undecided(model: PaperModel, belief: PaperBelief) -> None:
    """Let the freed robot and those that waited decide; with ``redirect``, also those in mid-path after news."""
    for r in range(belief.robots.size):
        if belief.robots[r].obj == NONE:
            belief.robots[r].undecided = 1
        elif model.redirect and belief.state[NEWS] and belief.robots[r].reach_s > belief.clock[0] + SAME_INSTANT_S:
            belief.robots[r].obj = NONE
            belief.robots[r].undecided = 1
            belief.robots[r].under_way = 1


@inlined
def may_wait(belief: PaperBelief, r: int) -> bool:
    """Return whether a robot may wait: another robot must be acting, or still undecided."""
    for other in range(belief.robots.size):
        if other != r and (belief.robots[other].undecided or belief.robots[other].obj != NONE):
            return True
    return False
