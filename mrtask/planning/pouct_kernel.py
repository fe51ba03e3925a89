"""PO-UCT over concurrent robots: the compiled search of `mrtask.planning.pouct`.

One sample descends the tree of histories by UCB1, leaves it at the first new history, and finishes the task by the
greedy rollout. Contents are drawn when a container is searched, each given what the sample has seen so far and that
every object exists somewhere: the same distribution as drawing the whole hidden world first, at a fraction of the
cost. All kernels live in this one file because numba's cache does not notice edited callees elsewhere.

Legend: R robots, C containers, O objects, Z automaton states, M tree nodes. Sets of objects are bit masks.
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
WAIT_RANK = 2
"""Waiting is tried after this many containers at a tree node."""
LEAST_TRAVEL_S = 1e-9
"""Travel times count at least this much, so that likelihood decides between containers at no distance."""
SAME_INSTANT_S = 1e-9


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
    later_weight: float  # what finding an object for later counts against finding one for now
    penalty_s: float  # added to the cost of a sample that can't finish


class World(NamedTuple):
    """One sample's state; the root's is kept aside and copied."""

    clock: F8  # [1] seconds since the root
    state: I8  # [4] automaton state, mask of found objects, hash of what was revealed, 1 if there was news
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


class Usefulness(NamedTuple):
    """A direct-mapped cache: 1 / (weighted probability that a search finds something), by state and found objects."""

    tag: I8  # [K] key of the cached row, NONE if empty
    inverse: F8  # [K, C] inf where a search is useless


class Tree(NamedTuple):
    """Nodes hold a history and the robot to decide for; edges its actions; children what followed. NONE ends lists."""

    size: I8  # [2] nodes, edges in use
    visits: I4  # [M]
    robot: I4  # [M]
    first_edge: I4  # [M]
    edges: I4  # [M] number of edges
    key: I8  # [M] what was revealed on the way from the parent's edge
    sibling: I4  # [M] next child of the same edge
    action: I4  # [M] edge: container, WAIT, or C + object for a named interaction
    next_edge: I4  # [M]
    first_child: I4  # [M]
    tries: I4  # [M] edge visits
    total_s: F8  # [M] edge: summed makespan
    squares: F8  # [M] edge: summed squares of makespans


class Search(NamedTuple):
    """Options of the search."""

    exploration: float
    widening_factor: float
    widening_exponent: float


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
def _usefulness_row(model: Model, cache: Usefulness, z: int, found: int) -> int:
    """The cache row for a state and a set of found objects, filled if need be."""
    objects = model.prob.shape[1]
    key = (z << objects) | found
    row = key % cache.tag.size
    if cache.tag[row] == key:
        return row
    cache.tag[row] = key
    now = model.advancing[z] & ~found
    later = model.needed[z] & ~found & ~now
    for c in range(model.prob.shape[0]):
        missed = 1.0
        for o in range(objects):
            if (now >> o) & 1:
                missed *= 1.0 - model.prob[c, o]
            elif (later >> o) & 1:
                missed *= 1.0 - model.later_weight * model.prob[c, o]
        cache.inverse[row, c] = 1.0 / (1.0 - missed) if missed < 1.0 else np.inf
    return row


@compiled
def _distance_s(model: Model, world: World, r: int, c: int) -> float:
    """Seconds from where a robot is now to a container; a robot under way goes on or turns back."""
    origin = world.origin[r]
    start = world.away[r, c] if origin == NONE else model.travel_s[origin, c]
    if world.mode[r] != MOVING:
        return start
    ahead = world.until_s[r] - world.clock[0] + model.travel_s[world.place[r], c]
    back = world.clock[0] - world.since_s[r] + start
    return min(ahead, back)


@compiled
def _fetching(model: Model, world: World) -> int:
    """Mask of the objects that robots are on their way to, or busy with, at places known to hold them."""
    mask = 0
    for r in range(world.mode.size):
        if world.mode[r] == INTERACTING:
            mask |= 1 << world.doing[r]
        elif world.mode[r] == MOVING and world.undecided[r] == 0 and world.searched[world.place[r]]:
            mask |= world.holds[world.place[r]]
    return mask


@compiled
def _stands_ready(model: Model, world: World, r: int) -> bool:
    """Whether a robot stands where an object is that is needed later."""
    place = world.place[r]
    if world.mode[r] == MOVING or place == NONE or world.searched[place] == 0:
        return False
    z = world.state[0]
    return (world.holds[place] & model.needed[z] & ~model.advancing[z]) != 0


@compiled
def _score(model: Model, world: World, inverse: F8, fetching: int, ahead: bool, r: int, c: int) -> float:
    """Travel time over the probability of advancing: the lower the better, inf for a container of no use now.

    A place known to hold an object for later counts only with ``ahead``, and not for a robot that is at one already.
    """
    if world.targeted[c] > 0:
        return np.inf
    if world.searched[c] == 0:
        weight = inverse[c]
    else:
        z = world.state[0]
        useful = world.holds[c] & model.needed[z]
        if useful & model.safe[z] & ~fetching:
            weight = 1.0
        elif ahead and useful & ~model.advancing[z] and not _stands_ready(model, world, r):
            weight = 1.0 / model.later_weight
        else:
            return np.inf
    if weight == np.inf:
        return np.inf
    return max(_distance_s(model, world, r, c), LEAST_TRAVEL_S) * weight


@compiled
def _nearest_holding(model: Model, world: World, r: int, obj: int) -> int:
    """The nearest container known to hold an object, NONE if there is none in reach."""
    best, best_s = NONE, np.inf
    for c in range(world.searched.size):
        if (world.holds[c] >> obj) & 1:
            distance_s = _distance_s(model, world, r, c)
            if distance_s < best_s:
                best, best_s = c, distance_s
    return best


@compiled
def _best_action(
    model: Model, world: World, inverse: F8, r: int, fetching: int, ahead: bool, skip: U1
) -> tuple[int, float]:
    """The action of least score that is not in ``skip`` ([C + O]); NONE and inf if there is none."""
    containers = world.searched.size
    best, best_score = NONE, np.inf
    for early in range(2):  # with nothing to do now, be where an object is that is needed later
        for c in range(containers):
            if skip[c] == 0:
                score = _score(model, world, inverse, fetching, ahead or early == 1, r, c)
                if score < best_score:
                    best, best_score = c, score
        if best != NONE or ahead:
            break
    z = world.state[0]
    named = model.advancing[z] & ~model.safe[z] & world.state[1] & ~fetching
    obj = 0
    while named:
        if named & 1 and skip[containers + obj] == 0:
            c = _nearest_holding(model, world, r, obj)
            nearer = model.steps[model.transitions[z, obj]] < model.steps[z]
            if c != NONE:
                score = max(_distance_s(model, world, r, c), LEAST_TRAVEL_S) * (1.0 if nearer else 1e3)
                if score < best_score:
                    best, best_score = containers + obj, score
        named >>= 1
        obj += 1
    return best, best_score


@compiled
def act(model: Model, world: World, r: int, action: int) -> None:
    """Lets a robot begin an action: a container to go to, WAIT, or C + object."""
    containers = world.searched.size
    world.undecided[r] = 0
    target, want = action, NONE
    if action >= containers:
        want = action - containers
        target = _nearest_holding(model, world, r, want)
    if world.mode[r] == MOVING:
        if target == world.place[r]:
            world.targeted[target] += 1
            world.want[r] = want
            return
        for c in range(containers):
            world.away[r, c] = _distance_s(model, world, r, c)
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
def _reveal(model: Model, world: World, rng: U8, c: int) -> None:
    """Draws what a container holds, given all that was seen and that every object still needed exists somewhere."""
    z, found = world.state[0], world.state[1]
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
        world.state[3] = 1
    world.state[1] = found | held
    world.state[2] = (world.state[2] * 31 + 1) * 1048583 + (held + 1) * 64 + c


@compiled
def _begin_interaction(model: Model, world: World, r: int) -> bool:
    """Starts the interaction that a robot's action allows where it stands; the one nearest to acceptance."""
    z = world.state[0]
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
        z, obj = world.state[0], world.doing[r]
        if (model.advancing[z] >> obj) & 1:
            world.state[0] = model.transitions[z, obj]
            world.state[3] = 1
        if world.want[r] != NONE:
            world.want[r] = NONE
            _release(world, r)
            return True
    if _begin_interaction(model, world, r):
        return False
    _release(world, r)
    return True


@compiled
def _advance(model: Model, world: World, rng: U8) -> int:
    """Lets time run to the next decision instant: DECIDE with `undecided` set, DONE, or STUCK."""
    robots = world.mode.size
    world.state[3] = 0
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
        z = world.state[0]
        if _finish_event(model, world, rng, due):
            freed = True
        if world.state[0] != z:
            if model.accepting[world.state[0]]:
                return DONE
            for r in range(robots):  # robots waiting at an object whose time has come
                if world.mode[r] == FREE and world.place[r] != NONE and world.searched[world.place[r]]:
                    world.want[r] = NONE
                    if _begin_interaction(model, world, r):
                        world.targeted[world.place[r]] += 1
    for r in range(robots):
        if world.mode[r] == FREE:
            world.undecided[r] = 1
        elif world.mode[r] == MOVING and world.state[3]:
            reconsider(world, r)
    return DECIDE


@compiled
def reconsider(world: World, r: int) -> None:
    """Puts a robot under way up for decision."""
    world.undecided[r] = 1
    world.targeted[world.place[r]] -= 1


@compiled
def _all_fetched(model: Model, world: World, fetching: int) -> bool:
    """Whether every object that advances the task now is being fetched, so that others may prepare for later."""
    return (model.advancing[world.state[0]] & ~fetching) == 0


@compiled
def greedy_step(model: Model, world: World, cache: Usefulness, skip: U1) -> int:
    """Assigns the undecided robot with the least score over all; returns it, or NONE if nobody is undecided."""
    row = _usefulness_row(model, cache, world.state[0], world.state[1])
    inverse = cache.inverse[row]
    fetching = _fetching(model, world)
    ahead = _all_fetched(model, world, fetching)
    chosen, chosen_action, chosen_score = NONE, WAIT, np.inf
    for r in range(world.mode.size):
        if world.undecided[r]:
            action, score = _best_action(model, world, inverse, r, fetching, ahead, skip)
            if chosen == NONE or score < chosen_score:
                chosen, chosen_action, chosen_score = r, action, score
    if chosen != NONE:
        act(model, world, chosen, chosen_action)
    return chosen


@compiled
def _rollout(model: Model, world: World, cache: Usefulness, rng: U8, skip: U1) -> int:
    """Finishes the task greedily: DONE or STUCK."""
    while True:
        while greedy_step(model, world, cache, skip) != NONE:
            pass
        outcome = _advance(model, world, rng)
        if outcome != DECIDE:
            return outcome


@compiled
def _new_node(model: Model, world: World, tree: Tree, cache: Usefulness, key: int, skip: U1) -> int:
    """Adds a node for the undecided robot with the least score, so that first choices are the rollout's."""
    row = _usefulness_row(model, cache, world.state[0], world.state[1])
    inverse = cache.inverse[row]
    fetching = _fetching(model, world)
    ahead = _all_fetched(model, world, fetching)
    chosen, chosen_score = NONE, np.inf
    for r in range(world.mode.size):
        if world.undecided[r]:
            _, score = _best_action(model, world, inverse, r, fetching, ahead, skip)
            if chosen == NONE or score < chosen_score:
                chosen, chosen_score = r, score
    node = tree.size[0]
    tree.size[0] = node + 1
    tree.visits[node] = 0
    tree.robot[node] = chosen
    tree.first_edge[node] = NONE
    tree.edges[node] = 0
    tree.key[node] = key
    tree.sibling[node] = NONE
    return node


@compiled
def _may_wait(world: World, r: int) -> bool:
    """Waiting makes sense while somebody else acts or is still to be decided."""
    for other in range(world.mode.size):
        if other != r and (world.undecided[other] or world.mode[other] != FREE):
            return True
    return False


@compiled
def _widen(model: Model, world: World, tree: Tree, cache: Usefulness, node: int, skip: U1) -> int:
    """Adds the next action in greedy order to a node; NONE if it has them all or the tree is full."""
    if tree.size[1] == tree.action.size:
        return NONE
    r = tree.robot[node]
    row = _usefulness_row(model, cache, world.state[0], world.state[1])
    waiting = False
    edge = tree.first_edge[node]
    while edge != NONE:
        if tree.action[edge] == WAIT:
            waiting = True
        else:
            skip[tree.action[edge]] = 1
        edge = tree.next_edge[edge]
    action = NONE
    wait_now = not waiting and _may_wait(world, r)
    if not (wait_now and tree.edges[node] >= WAIT_RANK):
        fetching = _fetching(model, world)
        ahead = _all_fetched(model, world, fetching)
        action, _ = _best_action(model, world, cache.inverse[row], r, fetching, ahead, skip)
        if action == NONE:  # last, what the greedy policy leaves out: being early, or going where another goes too
            action, _ = _best_action(model, world, cache.inverse[row], r, 0, True, skip)
    edge = tree.first_edge[node]
    while edge != NONE:
        if tree.action[edge] != WAIT:
            skip[tree.action[edge]] = 0
        edge = tree.next_edge[edge]
    if action == NONE:
        if not wait_now and tree.edges[node] > 0:
            return NONE
        action = WAIT
    edge = tree.size[1]
    tree.size[1] = edge + 1
    tree.action[edge] = action
    tree.next_edge[edge] = tree.first_edge[node]
    tree.first_child[edge] = NONE
    tree.tries[edge] = 0
    tree.total_s[edge] = 0.0
    tree.squares[edge] = 0.0
    tree.first_edge[node] = edge
    tree.edges[node] += 1
    return edge


@compiled
def _select(
    model: Model, world: World, tree: Tree, cache: Usefulness, search: Search, node: int, spread_s: float, skip: U1
) -> int:
    """The edge to follow: a new one while the node is too narrow for its visits, else the best by UCB1."""
    visits = tree.visits[node]
    if tree.edges[node] == 0 or tree.edges[node] < search.widening_factor * visits**search.widening_exponent:
        edge = _widen(model, world, tree, cache, node, skip)
        if edge != NONE:
            return edge
    log_visits = np.log(visits + 1.0)
    best, best_bound = NONE, np.inf
    edge = tree.first_edge[node]
    while edge != NONE:
        tries = tree.tries[edge]
        bound = tree.total_s[edge] / tries - search.exploration * spread_s * np.sqrt(log_visits / tries)
        if bound < best_bound:
            best, best_bound = edge, bound
        edge = tree.next_edge[edge]
    return best


@compiled
def _any_undecided(world: World) -> bool:
    for r in range(world.mode.size):
        if world.undecided[r]:
            return True
    return False


@compiled
def run_samples(
    model: Model,
    root: World,
    world: World,
    tree: Tree,
    cache: Usefulness,
    search: Search,
    rng: U8,
    samples: int,
    moments: F8,
    path: I4,
    skip: U1,
) -> None:
    """Runs samples from the root, whose node 0 must exist.

    ``moments`` [3] keeps the number, mean and summed squared deviation of the makespans drawn so far (Welford);
    ``path`` is scratch for the edges of one sample, ``skip`` [C + O] zeros for candidate scans. A full tree grows no
    further: samples then leave it at its fringe.
    """
    for _ in range(samples):
        copy_world(root, world)
        spread_s = np.sqrt(moments[2] / moments[0]) if moments[0] > 1 else 1.0
        node, depth, outcome = 0, 0, DECIDE
        while True:
            edge = _select(model, world, tree, cache, search, node, spread_s, skip)
            tree.visits[node] += 1
            if edge == NONE:  # a full tree's childless fringe
                outcome = _rollout(model, world, cache, rng, skip)
                break
            path[depth] = edge
            depth += 1
            act(model, world, tree.robot[node], tree.action[edge])
            key = 0
            if not _any_undecided(world):
                world.state[2] = 0
                outcome = _advance(model, world, rng)
                if outcome != DECIDE:
                    break
                key = world.state[2]
            child, last = tree.first_child[edge], NONE
            while child != NONE and tree.key[child] != key:
                last = child
                child = tree.sibling[child]
            if child == NONE or depth == path.size:
                if child == NONE and tree.size[0] < tree.visits.size:
                    child = _new_node(model, world, tree, cache, key, skip)
                    if last == NONE:
                        tree.first_child[edge] = child
                    else:
                        tree.sibling[last] = child
                outcome = _rollout(model, world, cache, rng, skip)
                break
            node = child
        cost_s = world.clock[0]
        if outcome == STUCK:
            cost_s += model.penalty_s
        moments[0] += 1
        delta = cost_s - moments[1]
        moments[1] += delta / moments[0]
        moments[2] += delta * (cost_s - moments[1])
        for step in range(depth):
            edge = path[step]
            tree.tries[edge] += 1
            tree.total_s[edge] += cost_s
            tree.squares[edge] += cost_s * cost_s


@compiled
def make_root(model: Model, root: World, tree: Tree, cache: Usefulness, skip: U1) -> None:
    """Puts the root node into an empty tree."""
    tree.size[:] = 0
    _new_node(model, root, tree, cache, 0, skip)
