"""The compiled search of `mrtask.planning.paper`: PO-UCT over actions <container, object> and Algorithm 1's outcomes.

Legend: R robots, C containers, O objects, Z automaton states, S object sets, M tree nodes. Sets of objects are bit
masks. An action is ``container * O + object``.
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

NONE = -1
WAIT = -1
UNKNOWN, PRESENT, ABSENT = 0, 1, 2
DECIDE, DONE, STUCK = 0, 1, 2


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
    state: I8  # [1]
    known: U1  # [C, O] UNKNOWN, PRESENT or ABSENT
    searched: U1  # [C]
    place: I4  # [R] container a robot stands at or goes to, NONE at its starting place
    obj: I4  # [R] object of its action, NONE while free or waiting
    arrive_s: F8  # [R] the action's failure event, in the past once the object is found
    done_s: F8  # [R] the action's success event
    undecided: U1  # [R]


class PaperTree(NamedTuple):
    """Nodes and edges as in `pouct_kernel.Tree`; ``next_try`` is the first action a node has not tried."""

    size: I8
    visits: I4
    robot: I4
    next_try: I4
    first_edge: I4
    key: I8
    sibling: I4
    action: I4
    next_edge: I4
    first_child: I4
    tries: I4
    total_s: F8


@compiled
def copy_belief(source: PaperBelief, target: PaperBelief) -> None:
    """Overwrites target."""
    target.clock[0] = source.clock[0]
    target.state[0] = source.state[0]
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
    z = belief.state[0]
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
                continue
        elif (model.advancing[z] >> obj) & 1:
            belief.state[0] = model.transitions[z, obj]
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
    """Whether an action can help: its object may be there, is still needed and nobody's yet, and it is no mere wait."""
    objects = model.prob.shape[1]
    c, obj = action // objects, action % objects
    z = belief.state[0]
    if (model.needed[z] >> obj) & 1 == 0 or belief.known[c, obj] == ABSENT:
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
def _next_action(model: PaperModel, belief: PaperBelief, tree: PaperTree, node: int) -> int:
    """The next action a node has not tried, or C * O once it has tried all."""
    actions = model.prob.size
    action = tree.next_try[node]
    while action < actions and not _allowed(model, belief, tree.robot[node], action):
        action += 1
    tree.next_try[node] = action + 1
    return action


@compiled
def _may_wait(belief: PaperBelief, r: int) -> bool:
    """Waiting makes sense while somebody else acts or is still to be decided."""
    for other in range(belief.place.size):
        if other != r and (belief.undecided[other] or belief.obj[other] != NONE):
            return True
    return False


@compiled
def lower_bound_s(model: PaperModel, belief: PaperBelief, soonest_s: F8) -> float:
    """The least time to acceptance if every object were at its nearest possible container for its nearest robot.

    The maximum over the objects of the best sufficient set: robots share objects, and visits of one robot add nothing.
    ``soonest_s`` [O] is scratch.
    """
    z = belief.state[0]
    if model.accepting[z]:
        return 0.0
    for obj in range(soonest_s.size):
        soonest_s[obj] = np.inf
    for r in range(belief.place.size):
        ready_s = 0.0
        if belief.obj[r] != NONE:
            ready_s = max(belief.arrive_s[r] - belief.clock[0], 0.0)
        for c in range(belief.searched.size):
            reach_s = ready_s + _distance_s(model, belief, r, c)
            for obj in range(soonest_s.size):
                possible = belief.known[c, obj] == PRESENT or (
                    belief.known[c, obj] == UNKNOWN and model.prob[c, obj] > 0.0
                )
                if possible and reach_s < soonest_s[obj]:
                    soonest_s[obj] = reach_s
    best_s = np.inf
    for s in range(model.sufficient.shape[1]):
        members = model.sufficient[z, s]
        if members == NONE:
            break
        worst_s = 0.0
        for obj in range(soonest_s.size):
            if (members >> obj) & 1 and soonest_s[obj] > worst_s:
                worst_s = soonest_s[obj]
        best_s = min(best_s, worst_s)
    return best_s if best_s < np.inf else model.penalty_s


@compiled
def new_node(belief: PaperBelief, tree: PaperTree, key: int) -> int:
    """Adds a node for the lowest undecided robot."""
    chosen = NONE
    for r in range(belief.place.size):
        if belief.undecided[r]:
            chosen = r
            break
    node = tree.size[0]
    tree.size[0] = node + 1
    tree.visits[node] = 0
    tree.robot[node] = chosen
    tree.next_try[node] = 0
    tree.first_edge[node] = NONE
    tree.key[node] = key
    tree.sibling[node] = NONE
    return node


@compiled
def _select(model: PaperModel, belief: PaperBelief, tree: PaperTree, node: int, exploration_s: float) -> int:
    """The edge to follow: an action not tried yet, else the best by UCB1; NONE if the robot can do nothing."""
    actions = model.prob.size
    if tree.next_try[node] <= actions and tree.size[1] < tree.action.size:
        action = _next_action(model, belief, tree, node)
        if action < actions or _may_wait(belief, tree.robot[node]) or tree.first_edge[node] == NONE:
            edge = tree.size[1]
            tree.size[1] = edge + 1
            tree.action[edge] = action if action < actions else WAIT
            tree.next_edge[edge] = tree.first_edge[node]
            tree.first_child[edge] = NONE
            tree.tries[edge] = 0
            tree.total_s[edge] = 0.0
            tree.first_edge[node] = edge
            return edge
    log_visits = np.log(tree.visits[node] + 1.0)
    best, best_bound = NONE, np.inf
    edge = tree.first_edge[node]
    while edge != NONE:
        tries = tree.tries[edge]
        bound = tree.total_s[edge] / tries - exploration_s * np.sqrt(log_visits / tries)
        if bound < best_bound:
            best, best_bound = edge, bound
        edge = tree.next_edge[edge]
    return best


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
    tree: PaperTree,
    exploration: float,
    rng: U8,
    samples: int,
    moments: F8,
    path: I4,
    soonest_s: F8,
) -> None:
    """Runs samples from node 0, which must exist; arguments as in `pouct_kernel.run_samples`."""
    for _ in range(samples):
        copy_belief(root, belief)
        spread_s = np.sqrt(moments[2] / moments[0]) if moments[0] > 1 else 1.0
        node, depth, rest_s = 0, 0, 0.0
        while True:
            edge = _select(model, belief, tree, node, exploration * spread_s)
            tree.visits[node] += 1
            if edge == NONE:
                rest_s = lower_bound_s(model, belief, soonest_s)
                break
            path[depth] = edge
            depth += 1
            act(model, belief, tree.robot[node], tree.action[edge])
            key = NONE
            if not _any_undecided(belief):
                key = sample_outcome(model, belief, rng)
                if key == NONE:
                    rest_s = model.penalty_s
                    break
                if model.accepting[belief.state[0]]:
                    break
                for r in range(belief.place.size):  # finds on the way tell histories apart
                    if belief.obj[r] != NONE:
                        key = 3 * key + belief.known[belief.place[r], belief.obj[r]]
                _mark_undecided(belief)
            child, last = tree.first_child[edge], NONE
            while child != NONE and tree.key[child] != key:
                last = child
                child = tree.sibling[child]
            if child == NONE or depth == path.size:
                if child == NONE and tree.size[0] < tree.visits.size:
                    child = new_node(belief, tree, key)
                    if last == NONE:
                        tree.first_child[edge] = child
                    else:
                        tree.sibling[last] = child
                rest_s = lower_bound_s(model, belief, soonest_s)
                break
            node = child
        cost_s = belief.clock[0] + rest_s
        moments[0] += 1
        delta = cost_s - moments[1]
        moments[1] += delta / moments[0]
        moments[2] += delta * (cost_s - moments[1])
        for step in range(depth):
            tree.tries[path[step]] += 1
            tree.total_s[path[step]] += cost_s
