"""How a team's concurrent actions unfold in time: the compiled simulation inside every sample of `pouct`.

Contents are drawn when a container is searched, each given what the sample has seen so far and that every object exists
somewhere: the same distribution as drawing the whole hidden world first, at a fraction of the cost.

Legend: R robots, C containers, O objects, Z automaton states. Sets of objects are bit masks.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrtask.planning.compiled import compiled, random_unit

F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]
U8 = NDArray[np.uint64]

FREE, MOVING, SEARCHING, INTERACTING = 0, 1, 2, 3
DECIDE, DONE, STUCK = 0, 1, 2
WAIT = -1
NONE = -1
SAME_INSTANT_S = 1e-9
AUTOMATON, FOUND, HISTORY, NEWS = 0, 1, 2, 3
"""Indices of `World.state`."""
HISTORY_FACTOR = 0x9E3779B97F4A7C15 - 2**64
"""2**64 over the golden ratio. Its multiples by numbers below 2**31 are more than 2**31 apart, so that no two histories
of up to two reveals meet in 64 bits, and longer ones do with negligible probability."""


class Model(NamedTuple):
    """What does not change while planning."""

    travel_s: F8  # [C, C]
    prob: F8  # [C, O], strictly inside (0, 1); rows of searched containers are not read
    transitions: I4  # [Z, O]
    accepting: U1  # [Z]
    advancing: I8  # [Z] mask
    safe: I8  # [Z] mask: interactions taken without a decision
    needed: I8  # [Z] mask: advancing now or later
    steps: I4  # [Z] interactions to acceptance
    search_time_s: float
    interact_time_s: float
    penalty_s: float  # added to the cost of a sample that can't finish


class World(NamedTuple):
    """One sample's state; the root's is kept aside and copied."""

    clock: F8  # [1] seconds since the root
    state: I8  # [4] AUTOMATON state, mask of FOUND objects, HISTORY hash of what was revealed, NEWS 1 if there was any
    searched: U1  # [C]
    holds: I8  # [C] mask of the objects known to be in searched containers
    targeted: I4  # [C] robots on the way to a container or busy there
    nowhere: F8  # [O] probability that no unsearched container holds the object
    mode: I4  # [R]
    place: I4  # [R] container a robot stands at or moves to, NONE at a place of its own
    want: I4  # [R] object of a named interaction, NONE for every safe one
    doing: I4  # [R] object being interacted with
    until_s: F8  # [R] time of the robot's next event
    since_s: F8  # [R] departure of a robot under way
    origin: I4  # [R] container departed from, or NONE: then `away` counts
    away: F8  # [R, C] travel times from the place that is no container
    undecided: U1  # [R]


@compiled
def copy_world(source: World, target: World) -> None:
    """Overwrites target."""
    target.clock[0] = source.clock[0]
    for i in range(4):
        target.state[i] = source.state[i]
    for c in range(source.searched.size):
        target.searched[c] = source.searched[c]
        target.holds[c] = source.holds[c]
        target.targeted[c] = source.targeted[c]
    for o in range(source.nowhere.size):
        target.nowhere[o] = source.nowhere[o]
    for r in range(source.mode.size):
        target.mode[r] = source.mode[r]
        target.place[r] = source.place[r]
        target.want[r] = source.want[r]
        target.doing[r] = source.doing[r]
        target.until_s[r] = source.until_s[r]
        target.since_s[r] = source.since_s[r]
        target.origin[r] = source.origin[r]
        target.undecided[r] = source.undecided[r]
        if source.origin[r] == NONE:
            for c in range(source.searched.size):
                target.away[r, c] = source.away[r, c]


@compiled
def distance_s(model: Model, world: World, r: int, c: int) -> float:
    """Seconds from where a robot is now to a container; a robot under way goes on or turns back."""
    origin = world.origin[r]
    start = world.away[r, c] if origin == NONE else model.travel_s[origin, c]
    if world.mode[r] != MOVING:
        return start
    ahead = world.until_s[r] - world.clock[0] + model.travel_s[world.place[r], c]
    back = world.clock[0] - world.since_s[r] + start
    return min(ahead, back)


@compiled
def nearest_holding(model: Model, world: World, r: int, obj: int) -> int:
    """The nearest container known to hold an object, NONE if there is none in reach."""
    best, best_s = NONE, np.inf
    for c in range(world.searched.size):
        if (world.holds[c] >> obj) & 1:
            here_s = distance_s(model, world, r, c)
            if here_s < best_s:
                best, best_s = c, here_s
    return best


@compiled
def act(model: Model, world: World, r: int, action: int) -> None:
    """Lets a robot begin an action: a container to go to, WAIT, or C + object."""
    containers = world.searched.size
    world.undecided[r] = 0
    target, want = action, NONE
    if action >= containers:
        want = action - containers
        target = nearest_holding(model, world, r, want)
    if world.mode[r] == MOVING:
        if target == world.place[r]:
            world.targeted[target] += 1
            world.want[r] = want
            return
        for c in range(containers):
            world.away[r, c] = distance_s(model, world, r, c)
        world.origin[r] = NONE
        world.place[r] = NONE
    world.mode[r] = FREE
    world.want[r] = want
    world.until_s[r] = np.inf
    if target == WAIT:
        return
    world.targeted[target] += 1
    start = world.away[r, target] if world.origin[r] == NONE else model.travel_s[world.origin[r], target]
    world.mode[r] = MOVING
    world.since_s[r] = world.clock[0]
    world.until_s[r] = world.clock[0] + start
    world.place[r] = target


@compiled
def history_after(history: int, held: int, c: int, containers: int) -> int:
    """The hash of a history and the reveal of what a container holds."""
    return (history + held * containers + c + 1) * HISTORY_FACTOR


@compiled
def _reveal(model: Model, world: World, rng: U8, c: int) -> None:
    """Draws what a container holds, given all that was seen and that every object still needed exists somewhere."""
    z, found = world.state[AUTOMATON], world.state[FOUND]
    held = 0
    for o in range(model.prob.shape[1]):
        if (model.needed[z] >> o) & 1:
            prob = model.prob[c, o]
            exists = 1.0 if (found >> o) & 1 else 1.0 - world.nowhere[o]
            if random_unit(rng) * exists < prob:
                held |= 1 << o
        world.nowhere[o] = min(world.nowhere[o] / (1.0 - model.prob[c, o]), 1.0)
    world.searched[c] = 1
    world.holds[c] = held
    if held & ~found:
        world.state[NEWS] = 1
    world.state[FOUND] = found | held
    world.state[HISTORY] = history_after(world.state[HISTORY], held, c, world.searched.size)


@compiled
def _begin_interaction(model: Model, world: World, r: int) -> bool:
    """Starts the interaction that a robot's action allows where it stands; the one nearest to acceptance."""
    z = world.state[AUTOMATON]
    here = world.holds[world.place[r]]
    if world.want[r] == NONE:
        here &= model.safe[z]
    else:
        here &= model.advancing[z] & (1 << world.want[r])
    best, obj = NONE, 0
    while here:
        if here & 1 and (
            best == NONE or model.steps[model.transitions[z, obj]] < model.steps[model.transitions[z, best]]
        ):
            best = obj
        here >>= 1
        obj += 1
    if best == NONE:
        return False
    world.mode[r] = INTERACTING
    world.doing[r] = best
    world.until_s[r] = world.clock[0] + model.interact_time_s
    return True


@compiled
def _release(world: World, r: int) -> None:
    """A robot's action is over: it stands at its place, free."""
    world.mode[r] = FREE
    world.until_s[r] = np.inf
    world.targeted[world.place[r]] -= 1


@compiled
def _finish_event(model: Model, world: World, rng: U8, r: int) -> bool:
    """Handles one robot's due event; True if that frees it."""
    if world.mode[r] == MOVING:
        world.origin[r] = world.place[r]
        if world.searched[world.place[r]] == 0:
            world.mode[r] = SEARCHING
            world.until_s[r] += model.search_time_s
            if model.search_time_s > 0.0:
                return False
    if world.mode[r] == SEARCHING:
        if world.searched[world.place[r]] == 0:
            _reveal(model, world, rng, world.place[r])
    elif world.mode[r] == INTERACTING:
        z, obj = world.state[AUTOMATON], world.doing[r]
        if (model.advancing[z] >> obj) & 1:
            world.state[AUTOMATON] = model.transitions[z, obj]
            world.state[NEWS] = 1
        if world.want[r] != NONE:
            world.want[r] = NONE
            _release(world, r)
            return True
    if _begin_interaction(model, world, r):
        return False
    _release(world, r)
    return True


@compiled
def advance(model: Model, world: World, rng: U8) -> int:
    """Lets time run to the next decision instant: DECIDE with `undecided` set, DONE, or STUCK."""
    robots = world.mode.size
    world.state[NEWS] = 0
    freed = False
    while True:
        due = 0
        for r in range(1, robots):
            if world.until_s[r] < world.until_s[due]:
                due = r
        if world.until_s[due] == np.inf:
            if not freed:
                return STUCK
            break
        if freed and world.until_s[due] > world.clock[0] + SAME_INSTANT_S:
            break
        world.clock[0] = max(world.clock[0], world.until_s[due])
        z = world.state[AUTOMATON]
        if _finish_event(model, world, rng, due):
            freed = True
        if world.state[AUTOMATON] != z:
            if model.accepting[world.state[AUTOMATON]]:
                return DONE
            for r in range(robots):  # robots waiting at an object whose time has come
                if world.mode[r] == FREE and world.place[r] != NONE and world.searched[world.place[r]]:
                    world.want[r] = NONE
                    if _begin_interaction(model, world, r):
                        world.targeted[world.place[r]] += 1
    for r in range(robots):
        if world.mode[r] == FREE:
            world.undecided[r] = 1
        elif world.mode[r] == MOVING and world.state[NEWS]:
            reconsider(world, r)
    return DECIDE


@compiled
def reconsider(world: World, r: int) -> None:
    """Puts a robot under way up for decision."""
    world.undecided[r] = 1
    world.targeted[world.place[r]] -= 1


@compiled
def any_undecided(world: World) -> bool:
    """Whether some robot is still to be assigned at this instant."""
    for r in range(world.mode.size):
        if world.undecided[r]:
            return True
    return False


@compiled
def may_wait(world: World, r: int) -> bool:
    """Waiting makes sense while somebody else acts or is still to be decided."""
    for other in range(world.mode.size):
        if other != r and (world.undecided[other] or world.mode[other] != FREE):
            return True
    return False
