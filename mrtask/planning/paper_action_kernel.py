"""Which actions <container, object> a robot has in `pouct_paper`'s search, and the order in which a node tries them.

Every action makes progress: it looks for an object that is needed, interacts with one that is due, or takes a robot
that does not stand ready to where an object for later is known to be. So a team of R robots takes at most 2 R decisions
in a row in which nothing is learned or done: between two pieces of news each robot arrives at most once at a place that
the first of them made useless, and once to stand ready.

Legend: R robots, C containers, O objects, M tree nodes. Sets of objects are bit masks.
"""

from typing import NamedTuple

import numpy as np

from mrtask.planning.compiled import compiled, compiled_apart
from mrtask.planning.paper_belief_kernel import (
    AUTOMATON,
    F8,
    I4,
    LOCATED,
    U1,
    PaperBelief,
    PaperModel,
    distance_s,
    presence_prob,
)
from mrtask.planning.tree import NONE, Tree


class ActionRules(NamedTuple):
    """Which of the actions that make progress are left out, see `PaperOptions`."""

    max_actions: int
    avoid_targets: bool
    advance_when_alone: bool


class ActionLimits(NamedTuple):
    """What the rules leave at each node, worked out at its first visit."""

    advancing_only: U1  # [M]
    free_only: U1  # [M] no containers that other robots head for
    least_prob: F8  # [M] an action must be likelier than this,
    last_tie: I4  # [M] or equal and no later than this action
    ranked_prob: F8  # [max_actions] work space: the likeliest actions so far
    ranked: I4  # [max_actions]


@compiled
def _stands_ready(model: PaperModel, belief: PaperBelief, r: int) -> bool:
    """Whether a robot stands where an object for later is known to be."""
    place = belief.place[r]
    if place == NONE or belief.under_way[r]:
        return False
    z = belief.state[AUTOMATON]
    return (belief.present[place] & model.needed[z] & ~model.advancing[z]) != 0


@compiled
def useful_objects(model: PaperModel, belief: PaperBelief, r: int) -> tuple[int, int]:
    """Masks of the objects that a robot may look for, and of those that it may go to where they are known to be.

    An object known to be somewhere is not looked for elsewhere, and objects for later are looked for, or waited at,
    once all those that advance the task now (W(z)) are located.
    """
    z = belief.state[AUTOMATON]
    now, located = model.advancing[z], belief.state[LOCATED]
    if now & ~located:
        return now & ~located, now
    if _stands_ready(model, belief, r):
        return model.needed[z] & ~located, now
    return model.needed[z] & ~located, model.needed[z]


@compiled
def _objects_at(model: PaperModel, belief: PaperBelief, r: int, c: int, sought: int, fetched: int) -> int:
    """Mask of the objects that make going to a container an action: nobody's yet, and in reach."""
    mask = (sought & model.possible[c] & ~belief.absent[c]) | (fetched & belief.present[c])
    if mask == 0:
        return 0
    for other in range(belief.place.size):
        if other != r and belief.obj[other] != NONE and belief.place[other] == c:
            mask &= ~(1 << belief.obj[other])
    if mask and distance_s(model, belief, r, c) == np.inf:
        return 0
    return mask


@compiled
def _headed_for(belief: PaperBelief, r: int, c: int) -> bool:
    """Whether another robot goes to a container or acts there."""
    for other in range(belief.place.size):
        if other != r and belief.obj[other] != NONE and belief.place[other] == c:
            return True
    return False


@compiled
def _is_alone(belief: PaperBelief, r: int) -> bool:
    """Whether all other robots wait."""
    for other in range(belief.place.size):
        if other != r and (belief.undecided[other] or belief.obj[other] != NONE):
            return False
    return True


@compiled_apart
def set_limits(
    model: PaperModel, belief: PaperBelief, rules: ActionRules, limits: ActionLimits, node: int, r: int
) -> None:
    """Works out what the rules leave of a robot's actions: one at least, if there is any."""
    containers = belief.searched.size
    now = model.advancing[belief.state[AUTOMATON]]
    sought, fetched = useful_objects(model, belief, r)
    limits.advancing_only[node] = 0
    if rules.advance_when_alone and _is_alone(belief, r):
        for c in range(containers):
            if _objects_at(model, belief, r, c, sought & now, fetched & now):
                limits.advancing_only[node] = 1
        if limits.advancing_only[node]:
            sought, fetched = sought & now, fetched & now
    limits.free_only[node] = 0
    if rules.avoid_targets and belief.place.size > 1:
        count, left = 0, 0
        for c in range(containers):
            mask = _objects_at(model, belief, r, c, sought, fetched)
            free = not _headed_for(belief, r, c)
            while mask:
                count += 1
                if free:
                    left += 1
                mask &= mask - 1
        if count >= belief.place.size and left > 0:
            limits.free_only[node] = 1
    _rank(model, belief, limits, node, r, sought, fetched)


@compiled
def _rank(
    model: PaperModel, belief: PaperBelief, limits: ActionLimits, node: int, r: int, sought: int, fetched: int
) -> None:
    """Sets the likelihood that an action needs to be among the likeliest ones; of equals the first stay."""
    containers, objects = model.prob.shape
    most, count, dropped = limits.ranked.size, 0, False
    for c in range(containers):
        mask = _objects_at(model, belief, r, c, sought, fetched)
        if mask == 0 or (limits.free_only[node] and _headed_for(belief, r, c)):
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
    limits.least_prob[node], limits.last_tie[node] = -1.0, NONE
    if dropped:
        limits.least_prob[node], limits.last_tie[node] = limits.ranked_prob[most - 1], limits.ranked[most - 1]


@compiled
def _passes(model: PaperModel, belief: PaperBelief, limits: ActionLimits, node: int, r: int, c: int, obj: int) -> bool:
    """Whether an action is among those that the rules leave at a node."""
    if limits.free_only[node] and _headed_for(belief, r, c):
        return False
    if limits.least_prob[node] < 0.0:
        return True
    prob = presence_prob(model, belief, c, obj)
    if prob == limits.least_prob[node]:
        return c * model.prob.shape[1] + obj <= limits.last_tie[node]
    return prob > limits.least_prob[node]


@compiled
def next_action(
    model: PaperModel, belief: PaperBelief, rules: ActionRules, limits: ActionLimits, tree: Tree, node: int
) -> int:
    """The next action that a node has not tried, or C * O once it has tried all."""
    containers, objects = model.prob.shape
    r, first = tree.robot[node], tree.next_untried[node]
    limited = rules.avoid_targets or rules.advance_when_alone or limits.ranked.size < model.prob.size
    if limited and first == 0:
        set_limits(model, belief, rules, limits, node, r)
    sought, fetched = useful_objects(model, belief, r)
    if limited and limits.advancing_only[node]:
        now = model.advancing[belief.state[AUTOMATON]]
        sought, fetched = sought & now, fetched & now
    for c in range(first // objects, containers):
        mask = _objects_at(model, belief, r, c, sought, fetched)
        for obj in range(objects):
            action = c * objects + obj
            if (mask >> obj) & 1 == 0 or action < first:
                continue
            if not limited or _passes(model, belief, limits, node, r, c, obj):
                tree.next_untried[node] = action + 1
                return action
    tree.next_untried[node] = containers * objects + 1
    return containers * objects


@compiled
def first_action(model: PaperModel, belief: PaperBelief, r: int) -> int:
    """A robot's first action, NONE if it has none."""
    objects = model.prob.shape[1]
    sought, fetched = useful_objects(model, belief, r)
    for c in range(model.prob.shape[0]):
        mask = _objects_at(model, belief, r, c, sought, fetched)
        for obj in range(objects):
            if (mask >> obj) & 1:
                return c * objects + obj
    return NONE
