"""The greedy policy: choose the robot and action with the least travel time over the probability of advancing.

It is a planner by itself (`greedy`), finishes the task from each leaf of `pouct`'s tree, and sets the order in which
actions enter that tree.

Legend: R robots, C containers, O objects. Sets of objects are bit masks.
"""

from typing import NamedTuple

import numpy as np

from mrtask.arrays import Floats, Ints, UInt8s, UInt64s
from mrtask.planning.compiled import called, inlined
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
"""Every travel time counts as at least this much, so that the likelihood decides between containers at no distance."""
EVERYWHERE, NOWHERE = -2, -3
"""Values beside container numbers that say which undecided robots must choose again: all of them, or none."""
DETOUR_FACTOR = 1e3
"""This factor puts interactions that may hurt and lead no nearer to acceptance after all others."""


class GreedyPolicy(NamedTuple):
    """The policy's one parameter, a direct-mapped cache of the worth of searches, and scratch space.

    The cache keeps a container's worth as 1 / (weighted probability that a search finds something), by automaton state
    and found objects.
    """

    later_weight: float  # the weight of finding an object for later, relative to one for now
    tag: Ints  # [K] key of the cached row, NONE if it is empty
    inverse: Floats  # [K, C] inf where a search is useless
    skip: UInt8s  # [C + O] actions to skip; all zero between calls
    action: Ints  # [R] best actions of undecided robots; NONE means to wait
    score: Floats  # [R] the scores of these actions


@inlined
def _inverse_prob(model: Model, world: World, greedy: GreedyPolicy) -> int:
    """Return the row of ``greedy.inverse`` for what a world knows, and fill that row if necessary."""
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
    """Return the mask of the objects at known places that robots are on their way to or busy with."""
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
    """Return whether every object that brings acceptance nearer is being fetched; others may then prepare for later."""
    return (model.states[world.state[AUTOMATON]].nearer & ~fetching) == 0


@inlined
def _stands_ready(model: Model, world: World, r: int) -> bool:
    """Return whether a robot stands at an object that is needed later."""
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
    """Return the travel time over the probability of advancing: lower is better, and inf marks a useless container.

    A place known to hold an object for later counts only with ``ahead``, and only for a robot that does not stand at
    such a place already.
    """
    container = world.containers[c]
    if container.targeted > 0:
        return np.inf
    if container.searched == 0:
        weight = greedy.inverse[row, c]
    else:
        state = model.states[world.state[AUTOMATON]]
        useful = container.holds & state.needed
        if useful & state.automatic & ~fetching:
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
    """Return whether interactions under way may keep an interaction with ``obj`` from bringing acceptance nearer.

    At most one interaction that may hurt is under way at a time: of two, the second could undo the first.
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


@called
def _best_named(
    model: Model, world: World, greedy: GreedyPolicy, named: int, detours: bool, r: int
) -> tuple[int, float]:
    """Return a robot's best interaction by name with one of the ``named`` objects, and its score, as `_best` does."""
    containers = world.containers.size
    best, best_score, obj = NONE, np.inf, 0
    while named:
        if named & 1 and greedy.skip[containers + obj] == 0:
            c = nearest_holding(model, world, r, obj)
            if c != NONE and (detours or not _disturbed(model, world, obj)):
                nearer = (model.states[world.state[AUTOMATON]].nearer >> obj) & 1
                score = max(distance_s(model, world, r, c), MIN_TRAVEL_S) * (1.0 if nearer else DETOUR_FACTOR)
                if score < best_score:
                    best, best_score = containers + obj, score
        named >>= 1
        obj += 1
    return best, best_score


@inlined
def _best(
    model: Model, world: World, greedy: GreedyPolicy, row: int, fetching: int, ahead: bool, detours: bool, r: int
) -> tuple[int, float]:
    """Return a robot's action of least score that is not in ``greedy.skip``, or NONE and inf if it has no such action.

    With ``detours``, the actions include interactions that may hurt and lead no nearer to acceptance.
    """
    containers = world.containers.size
    best, best_score = NONE, np.inf
    for early in range(2):  # with nothing to do now, go to an object that is needed later
        for c in range(containers):
            if greedy.skip[c] == 0:
                score = _score(model, world, greedy, row, fetching, ahead or early == 1, r, c)
                if score < best_score:
                    best, best_score = c, score
        if best != NONE or ahead:
            break
    state = model.states[world.state[AUTOMATON]]
    named = (state.worth if detours else state.nearer) & ~state.automatic & world.state[FOUND] & ~fetching
    if named:
        action, score = _best_named(model, world, greedy, named, detours, r)
        if score < best_score:
            return action, score
    return best, best_score


@inlined
def next_action(model: Model, world: World, greedy: GreedyPolicy, r: int) -> int:
    """Return a robot's best action that is not in ``greedy.skip``, or NONE if it has no such action.

    The actions that the policy leaves out come last: being early, and going where another robot goes too.
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
    """Return the undecided robot with the least ``greedy.score``, or NONE if no robot is undecided."""
    chosen = NONE
    for r in range(world.robots.size):
        if world.robots[r].undecided and (chosen == NONE or greedy.score[r] < greedy.score[chosen]):
            chosen = r
    return chosen


@inlined
def _look_round(model: Model, world: World, greedy: GreedyPolicy, row: int, place: int) -> None:
    """Fill ``greedy.action`` and ``greedy.score`` for the undecided robots that chose ``place``, or for all of them."""
    fetching = _fetching(model, world)
    ahead = _all_fetched(model, world, fetching)
    for r in range(world.robots.size):
        if world.robots[r].undecided and (place == EVERYWHERE or greedy.action[r] == place):
            greedy.action[r], greedy.score[r] = _best(model, world, greedy, row, fetching, ahead, False, r)


@inlined
def first_to_decide(model: Model, world: World, greedy: GreedyPolicy) -> int:
    """Return the undecided robot whose best action has the least score, or NONE if no robot is undecided."""
    _look_round(model, world, greedy, _inverse_prob(model, world, greedy), EVERYWHERE)
    return _least(world, greedy)


@inlined
def assign(model: Model, world: World, greedy: GreedyPolicy, looked: bool = False) -> None:
    """Let all undecided robots begin actions, in each round the robot and action of least score overall.

    With ``looked``, `first_to_decide` has just been called for this world and has left what each robot would do.
    """
    row, taken = _inverse_prob(model, world, greedy), NOWHERE if looked else EVERYWHERE
    while True:
        _look_round(model, world, greedy, row, taken)
        robot = _least(world, greedy)
        if robot == NONE:
            break
        act(model, world, robot, greedy.action[robot])
        taken = NOWHERE
        if world.robots[robot].mode == MOVING:
            place = world.robots[robot].place
            fetches = world.containers[place].searched  # other robots no longer need to fetch what lies there
            taken = EVERYWHERE if fetches else place


@inlined
def rollout(model: Model, world: World, greedy: GreedyPolicy, rng: UInt64s, looked: bool = False) -> int:
    """Finish the task greedily, and return DONE or STUCK. See `assign` for ``looked``.

    The rollout ends because each search, and each interaction that the policy makes, happens a bounded number of times:
    a safe interaction keeps every way to finish the task open, and all others lead nearer to acceptance. The limit on
    decisions backs up this argument.
    """
    for _ in range(model.max_decisions):
        assign(model, world, greedy, looked)
        looked = False
        outcome = advance(model, world, rng)
        if outcome != DECIDE:
            return outcome
    return STUCK
