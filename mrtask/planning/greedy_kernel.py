"""The greedy policy: least travel time over the probability of advancing, for the robot and action where it is least.

It is a planner by itself (`greedy`), finishes the task from each leaf of `pouct`'s tree, and gives the order in which
actions enter that tree.

Legend: R robots, C containers, O objects. Sets of objects are bit masks.
"""

from typing import NamedTuple

import numpy as np

from mrtask.arrays import Floats, Ints, UInt8s, UInt64s
from mrtask.planning.compiled import inlined
from mrtask.planning.shared_kernel import AUTOMATON, NONE
from mrtask.planning.team_kernel import (
    DECIDE,
    FOUND,
    INTERACTING,
    MOVING,
    STUCK,
    Model,
    World,
    act,
    advance,
    distance_s,
    nearest_holding,
)

MIN_TRAVEL_S = 1e-9
"""Travel times count at least this much, so that likelihood decides between containers at no distance."""
EVERYWHERE, NOWHERE = -2, -3
"""Beside containers, the places to which robots meant to go that must look round again."""
DETOUR_FACTOR = 1e3
"""Interactions that may hurt and lead no nearer to acceptance come after all others."""


class GreedyPolicy(NamedTuple):
    """The policy's one parameter, a direct-mapped cache of what searches are worth, and scratch space.

    A container's worth is kept as 1 / (weighted probability that a search finds something), by state and found objects.
    """

    later_weight: float  # what finding an object for later counts against finding one for now
    tag: Ints  # [K] key of the cached row, NONE if empty
    inverse: Floats  # [K, C] inf where a search is useless
    skip: UInt8s  # [C + O] actions to pass over: zeros between calls
    action: Ints  # [R] best actions of undecided robots, NONE (to wait) if there is none
    score: Floats  # [R] their scores


@inlined
def _inverse_prob(model: Model, world: World, greedy: GreedyPolicy) -> int:
    """The row of ``greedy.inverse`` for what a world knows, filled if need be."""
    objects = model.prob.shape[1]
    z, found = world.state[AUTOMATON], world.state[FOUND]
    key = (z << objects) | found
    row = key % greedy.tag.size
    if greedy.tag[row] == key:
        return row
    greedy.tag[row] = key
    now = model.states[z].nearer & ~found
    later = model.states[z].needed & ~found & ~now
    for c in range(model.prob.shape[0]):
        missed = 1.0
        for o in range(objects):
            if (now >> o) & 1:
                missed *= 1.0 - model.prob[c, o]
            elif (later >> o) & 1:
                missed *= 1.0 - greedy.later_weight * model.prob[c, o]
        greedy.inverse[row, c] = 1.0 / (1.0 - missed) if missed < 1.0 else np.inf
    return row


@inlined
def _fetching(model: Model, world: World) -> int:
    """Mask of the objects that robots are on their way to, or busy with, at places known to hold them."""
    mask = 0
    for r in range(world.robots.size):
        robot = world.robots[r]
        if robot.mode == INTERACTING:
            mask |= 1 << robot.doing
        elif robot.mode == MOVING and robot.undecided == 0 and world.containers[robot.place].searched:
            mask |= world.containers[robot.place].holds
    return mask


@inlined
def _all_fetched(model: Model, world: World, fetching: int) -> bool:
    """Whether every object that brings acceptance nearer is being fetched, so that others may prepare for later."""
    return (model.states[world.state[AUTOMATON]].nearer & ~fetching) == 0


@inlined
def _stands_ready(model: Model, world: World, r: int) -> bool:
    """Whether a robot stands where an object is that is needed later."""
    robot = world.robots[r]
    place = robot.place
    if robot.mode == MOVING or place == NONE or world.containers[place].searched == 0:
        return False
    state = model.states[world.state[AUTOMATON]]
    return (world.containers[place].holds & state.needed & ~state.nearer) != 0


@inlined
def _score(
    model: Model, world: World, greedy: GreedyPolicy, row: int, fetching: int, ahead: bool, r: int, c: int
) -> float:
    """Travel time over the probability of advancing: the lower the better, inf for a container of no use now.

    A place known to hold an object for later counts only with ``ahead``, and not for a robot that is at one already.
    """
    container = world.containers[c]
    if container.targeted > 0:
        return np.inf
    if container.searched == 0:
        weight = greedy.inverse[row, c]
    else:
        state = model.states[world.state[AUTOMATON]]
        useful = container.holds & state.needed
        if useful & state.safe & ~fetching:
            weight = 1.0
        elif ahead and useful & ~state.nearer and not _stands_ready(model, world, r):
            weight = 1.0 / greedy.later_weight
        else:
            return np.inf
    if weight == np.inf:
        return np.inf
    return max(distance_s(model, world, r, c), MIN_TRAVEL_S) * weight


@inlined
def _disturbed(model: Model, world: World, obj: int) -> bool:
    """Whether interactions under way may keep one with ``obj`` from bringing acceptance nearer.

    At most one that may hurt is under way at a time: of two, the second could undo what the first has done.
    """
    z = world.state[AUTOMATON]
    for r in range(world.robots.size):
        robot, other = world.robots[r], NONE
        if robot.mode == INTERACTING:
            other = robot.doing
        elif robot.mode == MOVING and robot.undecided == 0:
            other = robot.want
        if other != NONE and (model.states[z].advancing >> other) & 1:
            after = model.states[model.transitions[z, other]]
            if (model.states[z].safe >> other) & 1 == 0 or (after.nearer >> obj) & 1 == 0:
                return True
    return False


@inlined
def _best(
    model: Model, world: World, greedy: GreedyPolicy, row: int, fetching: int, ahead: bool, detours: bool, r: int
) -> tuple[int, float]:
    """A robot's action of least score that is not in ``greedy.skip``; NONE and inf if there is none.

    With ``detours``, interactions that may hurt and lead no nearer to acceptance are actions too.
    """
    containers = world.containers.size
    best, best_score = NONE, np.inf
    for early in range(2):  # with nothing to do now, be where an object is that is needed later
        for c in range(containers):
            if greedy.skip[c] == 0:
                score = _score(model, world, greedy, row, fetching, ahead or early == 1, r, c)
                if score < best_score:
                    best, best_score = c, score
        if best != NONE or ahead:
            break
    z = world.state[AUTOMATON]
    state = model.states[z]
    named = (state.worth if detours else state.nearer) & ~state.safe & world.state[FOUND] & ~fetching
    obj = 0
    while named:
        if named & 1 and greedy.skip[containers + obj] == 0:
            c = nearest_holding(model, world, r, obj)
            if c != NONE and (detours or not _disturbed(model, world, obj)):
                factor = 1.0 if (state.nearer >> obj) & 1 else DETOUR_FACTOR
                score = max(distance_s(model, world, r, c), MIN_TRAVEL_S) * factor
                if score < best_score:
                    best, best_score = containers + obj, score
        named >>= 1
        obj += 1
    return best, best_score


@inlined
def next_action(model: Model, world: World, greedy: GreedyPolicy, r: int) -> int:
    """A robot's best action that is not in ``greedy.skip``: NONE if there is none.

    Last comes what the policy leaves out: being early, or going where another robot goes too.
    """
    row = _inverse_prob(model, world, greedy)
    fetching = _fetching(model, world)
    ahead, action = _all_fetched(model, world, fetching), NONE
    for _ in range(2):
        action, _ = _best(model, world, greedy, row, fetching, ahead, True, r)
        if action != NONE:
            break
        fetching, ahead = 0, True
    return action


@inlined
def _least(world: World, greedy: GreedyPolicy) -> int:
    """The undecided robot of least ``greedy.score``; NONE if nobody is undecided."""
    chosen = NONE
    for r in range(world.robots.size):
        if world.robots[r].undecided and (chosen == NONE or greedy.score[r] < greedy.score[chosen]):
            chosen = r
    return chosen


@inlined
def _look_round(model: Model, world: World, greedy: GreedyPolicy, row: int, place: int) -> None:
    """Fills ``greedy.action`` and ``greedy.score`` for the undecided robots that meant to go to a place, or for all."""
    fetching = _fetching(model, world)
    ahead = _all_fetched(model, world, fetching)
    for r in range(world.robots.size):
        if world.robots[r].undecided and (place == EVERYWHERE or greedy.action[r] == place):
            greedy.action[r], greedy.score[r] = _best(model, world, greedy, row, fetching, ahead, False, r)


@inlined
def first_to_decide(model: Model, world: World, greedy: GreedyPolicy) -> int:
    """The undecided robot whose best action scores least; NONE if nobody is undecided."""
    _look_round(model, world, greedy, _inverse_prob(model, world, greedy), EVERYWHERE)
    return _least(world, greedy)


@inlined
def assign(model: Model, world: World, greedy: GreedyPolicy) -> None:
    """Lets all undecided robots begin actions, each time the robot and action of least score over all."""
    row, taken = _inverse_prob(model, world, greedy), EVERYWHERE
    while True:
        _look_round(model, world, greedy, row, taken)
        robot = _least(world, greedy)
        if robot == NONE:
            break
        act(model, world, robot, greedy.action[robot])
        taken = NOWHERE
        if world.robots[robot].mode == MOVING:
            place = world.robots[robot].place
            fetches = world.containers[place].searched  # what others then need not fetch
            taken = EVERYWHERE if fetches else place


@inlined
def rollout(model: Model, world: World, greedy: GreedyPolicy, rng: UInt64s) -> int:
    """Finish the task greedily: DONE or STUCK.

    This ends because each search, and each interaction that the policy makes, happens a bounded number of times: safe
    interactions take nothing away from what finishes the task, and all others lead nearer to acceptance. The bound on
    decisions backs up this argument.
    """
    for _ in range(model.max_decisions):
        assign(model, world, greedy)
        outcome = advance(model, world, rng)
        if outcome != DECIDE:
            return outcome
    return STUCK
