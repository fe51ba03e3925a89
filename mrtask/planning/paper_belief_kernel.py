"""The paper's belief-state abstraction, compiled: concurrent actions <container, object> and Algorithm 1's outcomes.

Legend: R robots, C containers, O objects, Z automaton states, S object sets. Sets of objects are bit masks. An action
is ``container * O + object``.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrtask.planning.compiled import compiled, random_unit
from mrtask.planning.tree import NONE

F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]
U8 = NDArray[np.uint64]

WAIT = -1
AUTOMATON, LOCATED, NEWS = 0, 1, 2
"""Indices of `PaperBelief.state`."""
SAME_INSTANT_S = 1e-9


class PaperModel(NamedTuple):
    """What does not change while planning."""

    travel_s: F8  # [C, C]
    prob: F8  # [C, O]
    possible: I8  # [C] mask of the objects whose likelihood is above 0
    transitions: I4  # [Z, O]
    accepting: U1  # [Z]
    advancing: I8  # [Z] mask
    needed: I8  # [Z] mask
    sufficient: I8  # [Z, S] minimal sets of objects that complete the task, padded by NONE
    search_time_s: float
    interact_time_s: float
    penalty_s: float  # added to the cost of a sample that can't finish
    exists: bool  # likelihoods are conditioned on every object being somewhere
    redirect: bool  # robots under way decide anew after news


class PaperBelief(NamedTuple):
    """One sample's team belief."""

    clock: F8  # [1] seconds since the root
    state: I8  # [3] AUTOMATON state, mask of LOCATED objects (known to be somewhere), NEWS 1 if the last step had any
    present: I8  # [C] mask of the objects known to be there
    absent: I8  # [C] mask of the objects known not to be there
    searched: U1  # [C]
    nowhere: F8  # [O] probability that the object is in no container where that is unknown
    place: I4  # [R] container a robot stands at or goes to, NONE at a place of its own
    obj: I4  # [R] object of its action, NONE while free or waiting
    arrive_s: F8  # [R] the action's failure event, in the past once the object is found
    done_s: F8  # [R] the action's success event
    reach_s: F8  # [R] when a robot is at its container, before the search
    undecided: U1  # [R]
    under_way: U1  # [R] 1 for a robot up for decision in mid-path
    origin: I4  # [R] container departed from, or NONE: then `away` counts
    since_s: F8  # [R] departure
    away: F8  # [R, C] travel times from the place that is no container


@compiled
def copy_belief(model: PaperModel, source: PaperBelief, target: PaperBelief) -> None:
    """Overwrites target; rows of ``away`` change only with ``model.redirect``."""
    target.clock[0] = source.clock[0]
    for i in range(3):
        target.state[i] = source.state[i]
    for c in range(source.searched.size):
        target.searched[c] = source.searched[c]
    for c in range(source.searched.size):
        target.present[c] = source.present[c]
    for c in range(source.searched.size):
        target.absent[c] = source.absent[c]
    for o in range(source.nowhere.size):
        target.nowhere[o] = source.nowhere[o]
    for r in range(source.place.size):
        target.place[r] = source.place[r]
        target.obj[r] = source.obj[r]
        target.arrive_s[r] = source.arrive_s[r]
        target.done_s[r] = source.done_s[r]
        target.reach_s[r] = source.reach_s[r]
        target.undecided[r] = source.undecided[r]
        target.under_way[r] = source.under_way[r]
        target.origin[r] = source.origin[r]
        target.since_s[r] = source.since_s[r]
        if model.redirect and source.origin[r] == NONE:
            for c in range(source.searched.size):
                target.away[r, c] = source.away[r, c]


@compiled
def distance_s(model: PaperModel, belief: PaperBelief, r: int, c: int) -> float:
    """Seconds from a robot's place to a container; for a robot up for decision in mid-path from where it is."""
    place = belief.place[r]
    if belief.under_way[r]:
        origin = belief.origin[r]
        start_s = belief.away[r, c] if origin == NONE else model.travel_s[origin, c]
        ahead_s = belief.reach_s[r] - belief.clock[0] + model.travel_s[place, c]
        return min(ahead_s, belief.clock[0] - belief.since_s[r] + start_s)
    return belief.away[r, c] if place == NONE else model.travel_s[place, c]


@compiled
def _leave_path(model: PaperModel, belief: PaperBelief, r: int) -> None:
    """Lets a robot in mid-path stand where it is."""
    for c in range(belief.searched.size):
        belief.away[r, c] = distance_s(model, belief, r, c)
    belief.under_way[r] = 0
    belief.place[r] = NONE
    belief.origin[r] = NONE


@compiled
def act(model: PaperModel, belief: PaperBelief, r: int, action: int) -> None:
    """Lets a robot begin an action, or wait."""
    belief.undecided[r] = 0
    objects = model.prob.shape[1]
    container, obj = action // objects, action % objects
    if belief.under_way[r]:
        if action != WAIT and container == belief.place[r]:
            belief.under_way[r] = 0
            _go(model, belief, r, container, obj, belief.reach_s[r])
            return
        _leave_path(model, belief, r)
    if action == WAIT:
        belief.obj[r] = NONE
        return
    reach_s = belief.clock[0] + distance_s(model, belief, r, container)
    belief.origin[r] = belief.place[r]
    belief.since_s[r] = belief.clock[0]
    _go(model, belief, r, container, obj, reach_s)


@compiled
def _go(model: PaperModel, belief: PaperBelief, r: int, container: int, obj: int, reach_s: float) -> None:
    arrive_s = reach_s
    if belief.searched[container] == 0:
        arrive_s += model.search_time_s
    belief.place[r] = container
    belief.obj[r] = obj
    belief.reach_s[r] = reach_s
    belief.arrive_s[r] = arrive_s
    belief.done_s[r] = arrive_s + model.interact_time_s


@compiled
def presence_prob(model: PaperModel, belief: PaperBelief, c: int, obj: int) -> float:
    """P_S: the likelihood of an object in a container, 0 or 1 where that is known."""
    if (belief.present[c] >> obj) & 1:
        return 1.0
    if (belief.absent[c] >> obj) & 1:
        return 0.0
    prob = model.prob[c, obj]
    if model.exists and (belief.state[LOCATED] >> obj) & 1 == 0 and belief.nowhere[obj] < 1.0:
        return min(prob / (1.0 - belief.nowhere[obj]), 1.0)
    return prob


@compiled
def _look(model: PaperModel, belief: PaperBelief, rng: U8, c: int, obj: int) -> bool:
    """A robot has searched a container for an object: whether it is there."""
    belief.searched[c] = 1
    if ((belief.present[c] | belief.absent[c]) >> obj) & 1 == 0:
        belief.state[NEWS] = 1
        if random_unit(rng) < presence_prob(model, belief, c, obj):
            belief.present[c] |= 1 << obj
            belief.state[LOCATED] |= 1 << obj
        else:
            belief.absent[c] |= 1 << obj
            belief.nowhere[obj] = min(belief.nowhere[obj] / (1.0 - model.prob[c, obj]), 1.0)
    return bool((belief.present[c] >> obj) & 1)


@compiled
def sample_outcome(model: PaperModel, belief: PaperBelief, rng: U8) -> int:
    """Draws one outcome of Algorithm 1; returns 2 * robot + (1 if found), or NONE if nobody acts.

    Failure events are walked in the order of time and robot up to the first success event, which ends the walk.
    """
    robots = belief.place.size
    z = belief.state[AUTOMATON]
    belief.state[NEWS] = 0
    success_s, winner = np.inf, NONE
    for r in range(robots):
        if belief.obj[r] != NONE:
            advances = (model.advancing[z] >> belief.obj[r]) & 1
            time_s = belief.done_s[r] if advances else belief.arrive_s[r]
            if winner == NONE or time_s < success_s:
                success_s, winner = time_s, r
    if winner == NONE:
        return NONE
    last_s, last = -np.inf, NONE
    while True:
        event_s, r = np.inf, NONE
        for other in range(robots):
            if belief.obj[other] == NONE:
                continue
            time_s = belief.arrive_s[other]
            if (time_s > last_s or (time_s == last_s and other > last)) and (time_s < event_s or r == NONE):
                event_s, r = time_s, other
        if r == NONE or event_s > success_s or (event_s == success_s and r > winner):
            break
        last_s, last = event_s, r
        if not _look(model, belief, rng, belief.place[r], belief.obj[r]):
            belief.clock[0] = max(belief.clock[0], event_s)
            belief.obj[r] = NONE
            return 2 * r
    obj = belief.obj[winner]
    if (model.advancing[z] >> obj) & 1:
        belief.state[AUTOMATON] = model.transitions[z, obj]
        belief.state[NEWS] = 1
    belief.clock[0] = max(belief.clock[0], success_s)
    belief.obj[winner] = NONE
    return 2 * winner + 1


@compiled
def mark_undecided(model: PaperModel, belief: PaperBelief) -> None:
    """The freed robot and those that waited decide; with ``redirect``, after news, those in mid-path too."""
    for r in range(belief.place.size):
        if belief.obj[r] == NONE:
            belief.undecided[r] = 1
        elif model.redirect and belief.state[NEWS] and belief.reach_s[r] > belief.clock[0] + SAME_INSTANT_S:
            belief.obj[r] = NONE
            belief.undecided[r] = 1
            belief.under_way[r] = 1


@compiled
def any_undecided(belief: PaperBelief) -> bool:
    """Whether some robot is still to be assigned at this instant."""
    for r in range(belief.place.size):
        if belief.undecided[r]:
            return True
    return False


@compiled
def may_wait(belief: PaperBelief, r: int) -> bool:
    """Waiting makes sense while somebody else acts or is still to be decided."""
    for other in range(belief.place.size):
        if other != r and (belief.undecided[other] or belief.obj[other] != NONE):
            return True
    return False
