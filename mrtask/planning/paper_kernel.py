"""The compiled search of `mrtask.planning.paper`: PO-UCT over actions <container, object> and Algorithm 1's outcomes.

Legend: R robots, C containers, O objects, Z automaton states, S object sets, M tree nodes. Sets of objects are bit
masks. An action is ``container * O + object``.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrtask.planning.compiled import compiled, random_unit
from mrtask.planning.tree import EDGES, NODES, NONE, Tree, add_edge, add_node, attach, back_up, child_of, least_bound

F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
I8 = NDArray[np.int64]
U1 = NDArray[np.uint8]
U8 = NDArray[np.uint64]

WAIT = -1
UNKNOWN, PRESENT, ABSENT = 0, 1, 2
AUTOMATON, LOCATED = 0, 1
"""Indices of `PaperBelief.state`."""
NEGLIGIBLE_PROB = 1e-12
"""Below this the lower bound no longer follows what is improbable."""


class PaperModel(NamedTuple):
    """What does not change while planning."""

    travel_s: F8  # [C, C]
    away_s: F8  # [R, C] from where the robots are now
    prob: F8  # [C, O]
    transitions: I4  # [Z, O]
    accepting: U1  # [Z]
    advancing: I8  # [Z] mask
    needed: I8  # [Z] mask
    sufficient: I8  # [Z, S] minimal sets of objects that complete the task, padded by NONE
    search_time_s: float
    interact_time_s: float
    penalty_s: float


class PaperBelief(NamedTuple):
    """One sample's team belief."""

    clock: F8  # [1]
    state: I8  # [2] AUTOMATON state, mask of the LOCATED objects: known to be in some container
    known: U1  # [C, O] UNKNOWN, PRESENT or ABSENT
    searched: U1  # [C]
    place: I4  # [R] container a robot stands at or goes to, NONE at its starting place
    obj: I4  # [R] object of its action, NONE while free or waiting
    arrive_s: F8  # [R] the action's failure event, in the past once the object is found
    done_s: F8  # [R] the action's success event
    undecided: U1  # [R]


class Scratch(NamedTuple):
    """Work space of the lower bound."""

    nearest_s: F8  # [C]
    order: I4  # [C]
    mean_s: F8  # [O]


@compiled
def copy_belief(source: PaperBelief, target: PaperBelief) -> None:
    """Overwrites target."""
    target.clock[0] = source.clock[0]
    target.state[AUTOMATON] = source.state[AUTOMATON]
    target.state[LOCATED] = source.state[LOCATED]
    for c in range(source.searched.size):
        target.searched[c] = source.searched[c]
        for o in range(source.known.shape[1]):
            target.known[c, o] = source.known[c, o]
    for r in range(source.place.size):
        target.place[r] = source.place[r]
        target.obj[r] = source.obj[r]
        target.arrive_s[r] = source.arrive_s[r]
        target.done_s[r] = source.done_s[r]
        target.undecided[r] = source.undecided[r]


@compiled
def _distance_s(model: PaperModel, belief: PaperBelief, r: int, c: int) -> float:
    """Seconds from a standing robot to a container."""
    place = belief.place[r]
    return model.away_s[r, c] if place == NONE else model.travel_s[place, c]


@compiled
def act(model: PaperModel, belief: PaperBelief, r: int, action: int) -> None:
    """Lets a robot begin an action, or wait."""
    belief.undecided[r] = 0
    if action == WAIT:
        belief.obj[r] = NONE
        return
    objects = model.prob.shape[1]
    container, obj = action // objects, action % objects
    arrive_s = belief.clock[0] + _distance_s(model, belief, r, container)
    if belief.searched[container] == 0:
        arrive_s += model.search_time_s
    belief.place[r] = container
    belief.obj[r] = obj
    belief.arrive_s[r] = arrive_s
    belief.done_s[r] = arrive_s + model.interact_time_s


@compiled
def sample_outcome(model: PaperModel, belief: PaperBelief, rng: U8) -> int:
    """Draws one outcome of Algorithm 1; returns 2 * robot + (1 if found), or NONE if nobody acts."""
    robots = belief.place.size
    z = belief.state[AUTOMATON]
    last_s, last_order = -np.inf, -1
    while True:
        # The next event after the last one, by time, then robot, then failure before success.
        event_s, order = np.inf, -1
        for r in range(robots):
            if belief.obj[r] == NONE:
                continue
            advances = (model.advancing[z] >> belief.obj[r]) & 1
            for success in range(2):
                time_s = belief.done_s[r] if success and advances else belief.arrive_s[r]
                here = 2 * r + success
                if (time_s > last_s or (time_s == last_s and here > last_order)) and (
                    time_s < event_s or (time_s == event_s and here < order)
                ):
                    event_s, order = time_s, here
        if order < 0:
            return NONE
        last_s, last_order = event_s, order
        r = order // 2
        c, obj = belief.place[r], belief.obj[r]
        if order % 2 == 0:
            belief.searched[c] = 1
            if belief.known[c, obj] == UNKNOWN:
                belief.known[c, obj] = PRESENT if random_unit(rng) < model.prob[c, obj] else ABSENT
            if belief.known[c, obj] == PRESENT:
                belief.state[LOCATED] |= 1 << obj
                continue
        elif (model.advancing[z] >> obj) & 1:
            belief.state[AUTOMATON] = model.transitions[z, obj]
        belief.clock[0] = max(belief.clock[0], event_s)
        belief.obj[r] = NONE
        return order


@compiled
def _mark_undecided(belief: PaperBelief) -> None:
    """The freed robot and those that waited decide."""
    for r in range(belief.place.size):
        if belief.obj[r] == NONE:
            belief.undecided[r] = 1


@compiled
def _allowed(model: PaperModel, belief: PaperBelief, r: int, action: int) -> bool:
    """Whether an action can help: its object may be there, is still needed and nobody's yet, and it is no mere wait.

    An object known to be somewhere is not looked for elsewhere, and objects for later are looked for, or waited at,
    once all those that advance the task now (W(z)) are located.
    """
    objects = model.prob.shape[1]
    c, obj = action // objects, action % objects
    z = belief.state[AUTOMATON]
    located = belief.state[LOCATED]
    if (model.needed[z] >> obj) & 1 == 0 or belief.known[c, obj] == ABSENT:
        return False
    if (located >> obj) & 1 and belief.known[c, obj] != PRESENT:
        return False
    if (model.advancing[z] >> obj) & 1 == 0 and model.advancing[z] & ~located:
        return False
    if belief.known[c, obj] == UNKNOWN and model.prob[c, obj] <= 0.0:
        return False
    if belief.known[c, obj] == PRESENT and belief.place[r] == c and (model.advancing[z] >> obj) & 1 == 0:
        return False
    for other in range(belief.place.size):
        if other != r and belief.obj[other] == obj and belief.place[other] == c:
            return False
    return _distance_s(model, belief, r, c) < np.inf


@compiled
def _next_action(model: PaperModel, belief: PaperBelief, tree: Tree, node: int) -> int:
    """The next action a node has not tried, or C * O once it has tried all."""
    actions = model.prob.size
    action = tree.next_untried[node]
    while action < actions and not _allowed(model, belief, tree.robot[node], action):
        action += 1
    tree.next_untried[node] = action + 1
    return action


@compiled
def _may_wait(belief: PaperBelief, r: int) -> bool:
    """Waiting makes sense while somebody else acts or is still to be decided."""
    for other in range(belief.place.size):
        if other != r and (belief.undecided[other] or belief.obj[other] != NONE):
            return True
    return False


@compiled
def _sort_by_distance(model: PaperModel, belief: PaperBelief, scratch: Scratch) -> None:
    """Fills ``nearest_s`` with each container's time from the nearest robot, and ``order`` by it (insertion sort)."""
    for c in range(belief.searched.size):
        nearest_s = np.inf
        for r in range(belief.place.size):
            ready_s = 0.0 if belief.obj[r] == NONE else max(belief.arrive_s[r] - belief.clock[0], 0.0)
            nearest_s = min(nearest_s, ready_s + _distance_s(model, belief, r, c))
        scratch.nearest_s[c] = nearest_s
        spot = c
        while spot > 0 and scratch.nearest_s[scratch.order[spot - 1]] > nearest_s:
            scratch.order[spot] = scratch.order[spot - 1]
            spot -= 1
        scratch.order[spot] = c


@compiled
def _mean_distances(model: PaperModel, belief: PaperBelief, scratch: Scratch) -> None:
    """Fills ``mean_s`` with each object's mean time to its nearest container, given that it exists."""
    containers = belief.searched.size
    for obj in range(model.prob.shape[1]):
        nowhere, mean_s = 1.0, 0.0
        for spot in range(containers):
            c = scratch.order[spot]
            if nowhere < NEGLIGIBLE_PROB or scratch.nearest_s[c] == np.inf:
                break
            if belief.known[c, obj] != ABSENT:
                prob = 1.0 if belief.known[c, obj] == PRESENT else model.prob[c, obj]
                mean_s += nowhere * prob * scratch.nearest_s[c]
                nowhere *= 1.0 - prob
        scratch.mean_s[obj] = mean_s / (1.0 - nowhere) if nowhere < 1.0 else np.inf


@compiled
def lower_bound_s(model: PaperModel, belief: PaperBelief, scratch: Scratch) -> float:
    """The expected time to acceptance if the contents were told now and all objects were fetched at once.

    Each object is worth the mean distance, over what may be where given that it exists, from its nearest container to
    the nearest robot; a set of objects its farthest member; the task its cheapest sufficient set.
    """
    z = belief.state[AUTOMATON]
    if model.accepting[z]:
        return 0.0
    _sort_by_distance(model, belief, scratch)
    _mean_distances(model, belief, scratch)
    best_s = np.inf
    for s in range(model.sufficient.shape[1]):
        members = model.sufficient[z, s]
        if members == NONE:
            break
        farthest_s = 0.0
        for obj in range(model.prob.shape[1]):
            if (members >> obj) & 1 and scratch.mean_s[obj] > farthest_s:
                farthest_s = scratch.mean_s[obj]
        best_s = min(best_s, farthest_s)
    return best_s if best_s < np.inf else model.penalty_s


@compiled
def decision_node(belief: PaperBelief, tree: Tree, key: int) -> int:
    """Adds a node for the lowest undecided robot."""
    chosen = NONE
    for r in range(belief.place.size):
        if belief.undecided[r]:
            chosen = r
            break
    return add_node(tree, chosen, key)


@compiled
def _select(model: PaperModel, belief: PaperBelief, tree: Tree, node: int, exploration: float) -> int:
    """The edge to follow: an action not tried yet, else the best by UCB1; NONE if the robot can do nothing."""
    actions = model.prob.size
    if tree.next_untried[node] <= actions and tree.size[EDGES] < tree.action.size:
        action = _next_action(model, belief, tree, node)
        if action < actions or _may_wait(belief, tree.robot[node]) or tree.first_edge[node] == NONE:
            return add_edge(tree, node, action if action < actions else WAIT)
    return least_bound(tree, node, exploration)


@compiled
def _any_undecided(belief: PaperBelief) -> bool:
    for r in range(belief.place.size):
        if belief.undecided[r]:
            return True
    return False


@compiled
def run_samples(
    model: PaperModel,
    root: PaperBelief,
    belief: PaperBelief,
    tree: Tree,
    exploration: float,
    rng: U8,
    samples: int,
    scratch: Scratch,
) -> None:
    """Runs samples from node 0, which must exist; ``belief`` is overwritten.

    A full tree grows no further: samples then leave it at its fringe.
    """
    for _ in range(samples):
        copy_belief(root, belief)
        node, depth, rest_s = 0, 0, 0.0
        while True:
            edge = _select(model, belief, tree, node, exploration)
            tree.visits[node] += 1
            if edge == NONE:
                rest_s = lower_bound_s(model, belief, scratch)
                break
            tree.path[depth] = edge
            depth += 1
            act(model, belief, tree.robot[node], tree.action[edge])
            key = NONE
            if not _any_undecided(belief):
                key = sample_outcome(model, belief, rng)
                if key == NONE:
                    rest_s = model.penalty_s
                    break
                if model.accepting[belief.state[AUTOMATON]]:
                    break
                for r in range(belief.place.size):  # finds on the way tell histories apart
                    if belief.obj[r] != NONE:
                        key = 3 * key + belief.known[belief.place[r], belief.obj[r]]
                _mark_undecided(belief)
            child = child_of(tree, edge, key)
            if child == NONE or depth == tree.path.size:
                if child == NONE and tree.size[NODES] < tree.visits.size:
                    attach(tree, edge, decision_node(belief, tree, key))
                rest_s = lower_bound_s(model, belief, scratch)
                break
            node = child
        back_up(tree, depth, belief.clock[0] + rest_s)
