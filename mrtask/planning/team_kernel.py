"""Simulate how a team's concurrent actions unfold in time: the compiled simulation inside every sample of `pouct`.

Contents are drawn when a container is searched, conditioned on what the sample has seen so far and on every object
existing somewhere. This gives the same distribution as drawing the whole hidden world first, at a fraction of the cost.

Legend: R robots, C containers, O objects, Z automaton states. Sets of objects are bit masks.
"""

from typing import NamedTuple

import numpy as np

from mrtask.arrays import Floats, Ints, UInt64s
from mrtask.planning.compiled import Records, inlined, random_unit
from mrtask.planning.problem import SAME_INSTANT_S, WAIT
from mrtask.planning.shared_kernel import AUTOMATON, NONE, copy_team

FREE, MOVING, SEARCHING, INTERACTING = 0, 1, 2, 3
DECIDE, DONE, STUCK = 0, 1, 2
FOUND, HISTORY, NEWS = 1, 2, 3
"""Indices of `World.state`, after AUTOMATON."""
HISTORY_FACTOR = 0x9E3779B97F4A7C15 - 2**64
"""2**64 over the golden ratio. Its multiples by numbers below 2**31 are more than 2**31 apart. Two histories of up to
two reveals therefore never share a 64-bit hash, and longer ones do so with negligible probability."""


CONTAINER = np.dtype(
    [
        ("holds", np.int64),  # mask of the objects known to be in a searched container
        ("targeted", np.int64),  # number of robots that go there or are busy there
        ("searched", np.int64),
    ],
    align=True,
)
ROBOT = np.dtype(
    [
        ("until_s", np.float64),  # time of the robot's next event
        ("since_s", np.float64),  # time of departure of a robot under way
        ("mode", np.int64),
        ("place", np.int64),  # container at which a robot stands or to which it moves, NONE anywhere else
        ("want", np.int64),  # object of a named interaction, NONE to make every automatic one
        ("doing", np.int64),  # object being interacted with
        ("origin", np.int64),  # container of departure, or NONE if `World.away` holds the times
        ("undecided", np.int64),
    ],
    align=True,
)


class Model(NamedTuple):
    """The data that do not change while planning."""

    travel_s: Floats  # [C, C]
    prob: Floats  # [C, O], strictly inside (0, 1); rows of searched containers are not read
    transitions: Ints  # [Z, O]
    states: Records  # [Z] of STATE
    search_time_s: float
    interact_time_s: float
    penalty_s: float  # added to the cost of a sample that cannot finish
    max_decisions: int  # a rollout with more decision instants than this goes round in circles


class World(NamedTuple):
    """The state of one sample. The root's world is kept aside and copied."""

    clock: Floats  # [1] seconds since the root
    state: Ints  # [4] AUTOMATON state, mask of FOUND objects, HISTORY hash of all reveals, NEWS 1 after any news
    containers: Records  # [C] of CONTAINER
    nowhere: Floats  # [O] probability that no unsearched container holds the object
    robots: Records  # [R] of ROBOT
    away: Floats  # [R, C] travel times from a place that is not a container


@inlined
def copy_world(source: World, target: World) -> None:
    """Overwrite the target with the source."""
    copy_team(source, target)
    for r in range(source.robots.size):
        if source.robots[r].origin == NONE:
            for c in range(source.containers.size):
                target.away[r, c] = source.away[r, c]


@inlined
def distance_s(model: Model, world: World, r: int, c: int) -> float:
    """Return the seconds from a robot's position to a container. A robot under way continues or turns back."""
    robot = world.robots[r]
    origin = robot.origin
    start = world.away[r, c] if origin == NONE else model.travel_s[origin, c]
    if robot.mode != MOVING:
        return start
    ahead = robot.until_s - world.clock[0] + model.travel_s[robot.place, c]
    back = world.clock[0] - robot.since_s + start
    return min(ahead, back)


@inlined
def nearest_holding(model: Model, world: World, r: int, obj: int) -> int:
    """Return the nearest container known to hold an object, or NONE if no such container is in reach."""
    best, best_s = NONE, np.inf
    for c in range(world.containers.size):
        if (world.containers[c].holds >> obj) & 1:
            here_s = distance_s(model, world, r, c)
            if here_s < best_s:
                best, best_s = c, here_s
    return best


@inlined
def act(model: Model, world: World, r: int, action: int) -> None:
    """Let a robot begin an action: a container to go to, WAIT, or C + object."""
    robot = world.robots[r]
    containers = world.containers.size
    robot.undecided = 0
    target, want = action, NONE
    if action >= containers:
        want = action - containers
        target = nearest_holding(model, world, r, want)
    if robot.mode == MOVING:
        if target == robot.place:
            world.containers[target].targeted += 1
            robot.want = want
            return
        for c in range(containers):
            world.away[r, c] = distance_s(model, world, r, c)
        robot.origin = NONE
        robot.place = NONE
    robot.mode = FREE
    robot.want = want
    robot.until_s = np.inf
    if target == WAIT:
        return
    world.containers[target].targeted += 1
    start = world.away[r, target] if robot.origin == NONE else model.travel_s[robot.origin, target]
    robot.mode = MOVING
    robot.since_s = world.clock[0]
    robot.until_s = world.clock[0] + start
    robot.place = target


@inlined
def history_after(history: int, held: int, c: int, containers: int) -> int:
    """Return the hash of a history followed by a reveal of what a container holds."""
    return (history + held * containers + c + 1) * HISTORY_FACTOR


@inlined
def _reveal(model: Model, world: World, rng: UInt64s, c: int) -> None:
    """Draw a container's contents, given all that was seen and that every object still needed exists somewhere."""
    needed, found, held = model.states[world.state[AUTOMATON]].needed, world.state[FOUND], 0
    for o in range(model.prob.shape[1]):
        if (needed >> o) & 1:
            prob = model.prob[c, o]
            exists = 1.0 if (found >> o) & 1 else 1.0 - world.nowhere[o]
            if random_unit(rng) * exists < prob:
                held |= 1 << o
        world.nowhere[o] = min(world.nowhere[o] / (1.0 - model.prob[c, o]), 1.0)
    world.containers[c].searched = 1
    world.containers[c].holds = held
    if held & ~found:
        world.state[NEWS] = 1
    world.state[FOUND] = found | held
    world.state[HISTORY] = history_after(world.state[HISTORY], held, c, world.containers.size)


@inlined
def _begin_interaction(model: Model, world: World, r: int) -> bool:
    """Start the interaction nearest to acceptance that a robot's action allows here, and return whether it began."""
    robot = world.robots[r]
    z = world.state[AUTOMATON]
    here = world.containers[robot.place].holds
    if robot.want == NONE:
        here &= model.states[z].automatic
    else:
        here &= model.states[z].advancing & (1 << robot.want)
    best, obj = NONE, 0
    while here:
        if here & 1 and (
            best == NONE
            or model.states[model.transitions[z, obj]].steps < model.states[model.transitions[z, best]].steps
        ):
            best = obj
        here >>= 1
        obj += 1
    if best == NONE:
        return False
    robot.mode = INTERACTING
    robot.doing = best
    robot.until_s = world.clock[0] + model.interact_time_s
    return True


@inlined
def _release(world: World, r: int) -> None:
    """End a robot's action: it stands at its place and is free."""
    robot = world.robots[r]
    robot.mode = FREE
    robot.until_s = np.inf
    world.containers[robot.place].targeted -= 1


@inlined
def _finish_event(model: Model, world: World, rng: UInt64s, r: int) -> bool:
    """Handle one robot's due event, and return whether it frees the robot."""
    robot = world.robots[r]
    if robot.mode == MOVING:
        robot.origin = robot.place
        if world.containers[robot.place].searched == 0:
            robot.mode = SEARCHING
            robot.until_s += model.search_time_s
            if model.search_time_s > 0.0:
                return False
    if robot.mode == SEARCHING:
        if world.containers[robot.place].searched == 0:
            _reveal(model, world, rng, robot.place)
    elif robot.mode == INTERACTING:
        z, obj = world.state[AUTOMATON], robot.doing
        if (model.states[z].advancing >> obj) & 1:
            world.state[AUTOMATON] = model.transitions[z, obj]
            world.state[NEWS] = 1
        if robot.want != NONE:
            robot.want = NONE
            _release(world, r)
            return True
    if _begin_interaction(model, world, r):
        return False
    _release(world, r)
    return True


@inlined
def _mark_deciders(world: World) -> bool:
    """Make the robots undecided that are free, or under way after news. Return whether there are any."""
    found = False
    for r in range(world.robots.size):
        if world.robots[r].mode == FREE:
            world.robots[r].undecided = 1
            found = True
        elif world.robots[r].mode == MOVING and world.state[NEWS]:
            reconsider(world, r)
            found = True
    return found


@inlined
def advance(model: Model, world: World, rng: UInt64s) -> int:
    """Let time run to the next decision instant. Return DECIDE with `undecided` set, DONE, or STUCK."""
    robots = world.robots.size
    world.state[NEWS] = 0
    freed = False
    while True:
        due = 0
        for r in range(1, robots):
            if world.robots[r].until_s < world.robots[due].until_s:
                due = r
        if not freed and world.robots[due].until_s == np.inf:
            return STUCK
        if freed and world.robots[due].until_s > world.clock[0] + SAME_INSTANT_S:
            if _mark_deciders(world):
                return DECIDE
            freed = False  # every robot that was freed has begun an interaction since then
        world.clock[0] = max(world.clock[0], world.robots[due].until_s)
        z = world.state[AUTOMATON]
        if _finish_event(model, world, rng, due):
            freed = True
        if world.state[AUTOMATON] != z:
            if model.states[world.state[AUTOMATON]].accepting:
                return DONE
            for r in range(robots):  # robots that waited at an object may interact with it now
                robot = world.robots[r]
                if robot.mode == FREE and robot.place != NONE and world.containers[robot.place].searched:
                    robot.want = NONE
                    if _begin_interaction(model, world, r):
                        world.containers[robot.place].targeted += 1


@inlined
def reconsider(world: World, r: int) -> None:
    """Make a robot under way undecided."""
    robot = world.robots[r]
    robot.undecided = 1
    world.containers[robot.place].targeted -= 1


@inlined
def may_wait(world: World, r: int) -> bool:
    """Return whether a robot may wait: another robot must be acting, or still undecided."""
    for other in range(world.robots.size):
        if other != r and (world.robots[other].undecided or world.robots[other].mode != FREE):
            return True
    return False
