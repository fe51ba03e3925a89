"""The compiled search of `mrtask.planning.pouct`: PO-UCT over the team's concurrent actions.

One sample descends the tree of histories by UCB1, leaves it at the first new history, and finishes the task with the
greedy policy. An action is a container, WAIT, or C + object for an interaction that may hurt.
"""

from typing import NamedTuple

import numpy as np

from mrtask.arrays import UInt64s
from mrtask.planning.compiled import compiled, inlined
from mrtask.planning.greedy_kernel import GreedyPolicy, first_to_decide, next_action, rollout
from mrtask.planning.problem import WAIT
from mrtask.planning.reference import by_reference
from mrtask.planning.shared_kernel import NONE, any_undecided
from mrtask.planning.team_kernel import (
    DECIDE,
    HISTORY,
    STUCK,
    Model,
    World,
    act,
    advance,
    copy_world,
    may_wait,
)
from mrtask.planning.tree import (
    EDGES,
    NODES,
    Tree,
    add_edge,
    add_node,
    attach,
    back_up_best,
    child_of,
    least_bound,
    least_visited,
    spread_s,
)

WAIT_RANK = 2
"""A tree node tries waiting after this many containers."""

TIE_S = 1e-9
"""Bounds that differ by less are equal. Actions that lead to the same costs would otherwise differ by rounding."""


class Search(NamedTuple):
    """The options of the search."""

    exploration: float
    widening_factor: float
    widening_exponent: float
    least_visits: float  # a root decision with n visits takes each of its actions at least this times sqrt(n) times


@inlined
def decision_node(model: Model, world: World, tree: Tree, greedy: GreedyPolicy, key: int) -> int:
    """Add a node for the undecided robot with the least score, so that the first choices are the rollout's."""
    return add_node(tree, first_to_decide(model, world, greedy), key)


@inlined
def _mark_tried(tree: Tree, greedy: GreedyPolicy, node: int, mark: int) -> bool:
    """Set ``greedy.skip`` for the actions that a node has, and return whether waiting is one of them."""
    waiting = False
    edge = tree.nodes[node].first_edge
    while edge != NONE:
        if tree.edges[edge].action == WAIT:
            waiting = True
        else:
            greedy.skip[tree.edges[edge].action] = mark
        edge = tree.edges[edge].next_edge
    return waiting


@inlined
def _widen(model: Model, world: World, tree: Tree, greedy: GreedyPolicy, node: int) -> int:
    """Add the next action in greedy order to a node, or return NONE if it has them all or the tree is full."""
    if tree.size[EDGES] == tree.edges.size:
        return NONE
    robot = tree.nodes[node].robot
    waiting = _mark_tried(tree, greedy, node, 1)
    action = NONE
    wait_now = not waiting and may_wait(world, robot)
    if not (wait_now and tree.nodes[node].next_untried >= WAIT_RANK):
        action = next_action(model, world, greedy, robot)
    _mark_tried(tree, greedy, node, 0)
    if action == NONE:
        if not wait_now and tree.nodes[node].next_untried > 0:
            return NONE
        action = WAIT
    tree.nodes[node].next_untried += 1
    return add_edge(tree, node, action)


@inlined
def _select(
    model: Model, world: World, tree: Tree, greedy: GreedyPolicy, search: Search, node: int, at_root: bool
) -> int:
    """Return the edge to follow: a new one while the node is too narrow for its visits, else the best by UCB1.

    Among the robots that decide ``at_root``, an edge with too few visits goes first. The value of a robot's action
    depends on what its team-mates do then, which the tree must have tried.
    """
    width = search.widening_factor * tree.nodes[node].visits ** search.widening_exponent
    if tree.nodes[node].next_untried == 0 or tree.nodes[node].next_untried < width:
        edge = _widen(model, world, tree, greedy, node)
        if edge != NONE:
            return edge
    if at_root:
        edge = least_visited(tree, node)
        if edge != NONE and tree.edges[edge].visits < search.least_visits * np.sqrt(float(tree.nodes[node].visits)):
            return edge
    return least_bound(tree, node, search.exploration * spread_s(tree), TIE_S)


@inlined
def _sample(
    model: Model, root: World, world: World, tree: Tree, greedy: GreedyPolicy, search: Search, rng: UInt64s
) -> None:
    """Run one sample from the root. The tree grows by one node unless it is full."""
    copy_world(root, world)
    node, depth, key, outcome, at_root = 0, 0, 0, DECIDE, True
    if tree.size[NODES] == 0:
        node = NONE
    while True:
        leaf = node == NONE or depth == tree.path.size
        looked = node == NONE and tree.size[NODES] < tree.nodes.size
        if looked:
            node = decision_node(model, world, tree, greedy, key)
            if depth > 0:
                attach(tree, tree.path[depth - 1], node)
        if leaf and depth > 0:
            break
        edge = _select(model, world, tree, greedy, search, node, at_root)
        tree.nodes[node].visits += 1
        if edge == NONE:  # a full tree's nodes without children
            break
        tree.path[depth], tree.nodes_of_path[depth] = edge, node
        depth += 1
        act(model, world, tree.nodes[node].robot, tree.edges[edge].action)
        key = 0
        if not any_undecided(world):
            world.state[HISTORY], at_root = 0, False
            outcome = advance(model, world, rng)
            if outcome != DECIDE:
                break
            key = world.state[HISTORY]
        node = child_of(tree, edge, key)
    if outcome == DECIDE:
        outcome = rollout(model, world, greedy, rng, looked)
    cost_s = world.clock[0]
    if outcome == STUCK:
        cost_s += model.penalty_s
    back_up_best(tree, depth, cost_s)


@compiled
def run_samples(
    model: Model,
    root: World,
    world: World,
    tree: Tree,
    greedy: GreedyPolicy,
    search: Search,
    rng: UInt64s,
    samples: int,
) -> None:
    """Run samples from the root; ``world`` is overwritten."""
    model, root, world = by_reference(model), by_reference(root), by_reference(world)
    tree, greedy, search = by_reference(tree), by_reference(greedy), by_reference(search)
    for _ in range(samples):
        _sample(model, root, world, tree, greedy, search, rng)
