"""The actions <container, object> of a robot in `pouct_paper`'s search, and the order in which a node tries them.

Every action makes progress: it looks for an object that is needed, interacts with one that is due, or takes a robot
that does not stand ready to the known place of an object for later. A team of R robots therefore takes at most 2 R
decisions in a row in which it learns and does nothing: between two pieces of news, each robot arrives at most once at a
place that the first of them made useless, and once to stand ready.

Legend: R robots, C containers, O objects, M tree nodes. Sets of objects are bit masks.
"""

from typing import NamedTuple

import numpy as np

from mrtask.arrays import Floats, Ints
from mrtask.planning.compiled import Records, called, inlined
from mrtask.planning.paper.belief_kernel import (
    LOCATED,
    PaperBelief,
    PaperModel,
    distance_s,
    presence_prob,
)
from mrtask.planning.shared_kernel import AUTOMATON, NONE
from mrtask.planning.tree import Tree


class ActionRules(NamedTuple):
    """The rules that leave out some of the actions that make progress; see `PaperOptions`."""

    max_actions: int
    avoid_targets: bool
    advance_when_alone: bool


LIMIT = np.dtype(
    [
        ("least_prob", np.float64),  # an action must be likelier than this
        ("last_tie", np.int64),  # or equally likely and no later than this action
        ("advancing_only", np.int64),
        ("free_only", np.int64),  # 1: without containers that other robots head for
    ],
    align=True,
)


class ActionLimits(NamedTuple):
    """The actions that the rules leave at each node, computed at its first visit."""

    nodes: Records  # [M] of LIMIT
    ranked_prob: Floats  # [max_actions] scratch: the likeliest actions so far
    ranked: Ints  # [max_actions]


@inlined
def _stands_ready(model: PaperModel, belief: PaperBelief, r: int) -> bool:
    """Return whether a robot stands where an object for later is known to be."""
    place = belief.robots[r].place
    if place == NONE or belief.robots[r].under_way:
        return False
    z = belief.state[AUTOMATON]
    return (belief.containers[place].present & model.states[z].needed & ~model.states[z].worth) != 0


@inlined
def useful_objects(model: PaperModel, belief: PaperBelief, r: int) -> tuple[int, int]:
    """Return two masks: the objects that a robot may look for, and those whose known place it may go to.

    A robot never looks elsewhere for an object whose place is known. It looks for objects for later, or waits at them,
    only once all objects worth an interaction now are located.
    """
    z = belief.state[AUTOMATON]
    now, located = model.states[z].worth, belief.state[LOCATED]
    if now & ~located:
        return now & ~located, now
    if _stands_ready(model, belief, r):
        return model.states[z].needed & ~located, now
    return model.states[z].needed & ~located, model.states[z].needed


@inlined
def _objects_at(model: PaperModel, belief: PaperBelief, r: int, c: int, sought: int, fetched: int) -> int:
    """Return the mask of the objects that make going to a container an action: unclaimed ones within reach."""
    mask = (sought & model.possible[c] & ~belief.containers[c].absent) | (fetched & belief.containers[c].present)
    if mask == 0:
        return 0
    for other in range(belief.robots.size):
        if other != r and belief.robots[other].obj != NONE and belief.robots[other].place == c:
            mask &= ~(1 << belief.robots[other].obj)
    if mask and distance_s(model, belief, r, c) == np.inf:
        return 0
    return mask


@inlined
def _headed_for(belief: PaperBelief, r: int, c: int) -> bool:
    """Return whether another robot goes to a container or acts there."""
    for other in range(belief.robots.size):
        if other != r and belief.robots[other].obj != NONE and belief.robots[other].place == c:
            return True
    return False


@inlined
def _is_alone(belief: PaperBelief, r: int) -> bool:
    """Return whether all other robots wait."""
    for other in range(belief.robots.size):
        if other != r and (belief.robots[other].undecided or belief.robots[other].obj != NONE):
            return False
    return True


@called
def set_limits(
    model: PaperModel, belief: PaperBelief, rules: ActionRules, limits: ActionLimits, node: int, r: int
) -> None:
    """Compute which of a robot's actions the rules leave. At least one remains if the robot has any."""
    limit, containers = limits.nodes[node], belief.containers.size
    now = model.states[belief.state[AUTOMATON]].worth
    sought, fetched = useful_objects(model, belief, r)
    limit.advancing_only = 0
    if rules.advance_when_alone and _is_alone(belief, r):
        for c in range(containers):
            if _objects_at(model, belief, r, c, sought & now, fetched & now):
                limit.advancing_only = 1
        if limit.advancing_only:
            sought, fetched = sought & now, fetched & now
    limit.free_only = 0
    if rules.avoid_targets and belief.robots.size > 1:
        count, left = 0, 0
        for c in range(containers):
            mask = _objects_at(model, belief, r, c, sought, fetched)
            free = not _headed_for(belief, r, c)
            while mask:
                count += 1
                if free:
                    left += 1
                mask &= mask - 1
        if count >= belief.robots.size and left > 0:
            limit.free_only = 1
    _rank(model, belief, limits, node, r, sought, fetched)


@inlined
def _rank(
    model: PaperModel, belief: PaperBelief, limits: ActionLimits, node: int, r: int, sought: int, fetched: int
) -> None:
    """Set the likelihood that an action needs to be among the likeliest ones.

    Of equally likely actions, the first ones stay.
    """
    limit = limits.nodes[node]
    containers, objects = model.prob.shape
    most, count, dropped = limits.ranked.size, 0, False
    for c in range(containers):
        mask = _objects_at(model, belief, r, c, sought, fetched)
        if mask == 0 or (limit.free_only and _headed_for(belief, r, c)):
            continue
        for obj in range(objects):
            if (mask >> obj) & 1 == 0:
                continue
            prob = presence_prob(model, belief, c, obj)
            if count == most:
                dropped = True
                if prob <= limits.ranked_prob[most - 1]:
                    continue
            else:
                count += 1
            spot = count - 1
            while spot > 0 and limits.ranked_prob[spot - 1] < prob:
                limits.ranked_prob[spot], limits.ranked[spot] = limits.ranked_prob[spot - 1], limits.ranked[spot - 1]
                spot -= 1
            limits.ranked_prob[spot], limits.ranked[spot] = prob, c * objects + obj
    limit.least_prob, limit.last_tie = -1.0, NONE
    if dropped:
        limit.least_prob, limit.last_tie = limits.ranked_prob[most - 1], limits.ranked[most - 1]


@inlined
def _passes(model: PaperModel, belief: PaperBelief, limits: ActionLimits, node: int, r: int, c: int, obj: int) -> bool:
    """Return whether an action is among those that the rules leave at a node."""
    limit = limits.nodes[node]
    if limit.free_only and _headed_for(belief, r, c):
        return False
    if limit.least_prob < 0.0:
        return True
    prob = presence_prob(model, belief, c, obj)
    if prob == limit.least_prob:
        return c * model.prob.shape[1] + obj <= limit.last_tie
    return prob > limit.least_prob


@inlined
def next_action(
    model: PaperModel, belief: PaperBelief, rules: ActionRules, limits: ActionLimits, tree: Tree, node: int
) -> int:
    """Return the next action that a node has not tried, or C * O once it has tried all."""
    containers, objects = model.prob.shape
    r, first = tree.nodes[node].robot, tree.nodes[node].next_untried
    limited = rules.avoid_targets or rules.advance_when_alone or limits.ranked.size < model.prob.size
    if limited and first == 0:
        set_limits(model, belief, rules, limits, node, r)
    sought, fetched = useful_objects(model, belief, r)
    if limited and limits.nodes[node].advancing_only:
        now = model.states[belief.state[AUTOMATON]].worth
        sought, fetched = sought & now, fetched & now
    for c in range(first // objects, containers):
        mask = _objects_at(model, belief, r, c, sought, fetched)
        for obj in range(objects):
            action = c * objects + obj
            if (mask >> obj) & 1 == 0 or action < first:
                continue
            if not limited or _passes(model, belief, limits, node, r, c, obj):
                tree.nodes[node].next_untried = action + 1
                return action
    tree.nodes[node].next_untried = containers * objects + 1
    return containers * objects


@inlined
def first_action(model: PaperModel, belief: PaperBelief, r: int) -> int:
    """Return a robot's first action, or NONE if it has none."""
    objects = model.prob.shape[1]
    sought, fetched = useful_objects(model, belief, r)
    for c in range(model.prob.shape[0]):
        mask = _objects_at(model, belief, r, c, sought, fetched)
        for obj in range(objects):
            if (mask >> obj) & 1:
                return c * objects + obj
    return NONE
