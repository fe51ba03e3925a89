"""The compiled search of `mrtask.planning.pouct`: PO-UCT over the team's concurrent actions.

One sample descends the tree of histories by UCB1, leaves it at the first new history, and finishes the task by the
greedy policy. An action is a container, WAIT, or C + object for an interaction that may hurt.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrtask.planning.compiled import compiled
from mrtask.planning.greedy_kernel import GreedyPolicy, first_to_decide, next_action, rollout
from mrtask.planning.team_kernel import (
    DECIDE,
    HISTORY,
    STUCK,
    WAIT,
    Model,
    World,
    act,
    advance,
    any_undecided,
    copy_world,
    may_wait,
)
from mrtask.planning.tree import (
    EDGES,
    NODES,
    NONE,
    Tree,
    add_edge,
    add_node,
    attach,
    back_up,
    child_of,
    least_bound,
    spread_s,
)

U8 = NDArray[np.uint64]

WAIT_RANK = 2
"""Waiting is tried after this many containers at a tree node."""


class Search(NamedTuple):
    """Options of the search."""

    exploration: float
    widening_factor: float
    widening_exponent: float


@compiled
def decision_node(model: Model, world: World, tree: Tree, greedy: GreedyPolicy, key: int) -> int:
    """Adds a node for the undecided robot with the least score, so that first choices are the rollout's."""
    return add_node(tree, first_to_decide(model, world, greedy), key)


@compiled
def _mark_tried(tree: Tree, greedy: GreedyPolicy, node: int, mark: int) -> bool:
    """Sets ``greedy.skip`` for the actions a node has; whether waiting is among them."""
    waiting = False
    edge = tree.first_edge[node]
    while edge != NONE:
        if tree.action[edge] == WAIT:
            waiting = True
        else:
            greedy.skip[tree.action[edge]] = mark
        edge = tree.next_edge[edge]
    return waiting


@compiled
def _widen(model: Model, world: World, tree: Tree, greedy: GreedyPolicy, node: int) -> int:
    """Adds the next action in greedy order to a node; NONE if it has them all or the tree is full."""
    if tree.size[EDGES] == tree.action.size:
        return NONE
    robot = tree.robot[node]
    waiting = _mark_tried(tree, greedy, node, 1)
    action = NONE
    wait_now = not waiting and may_wait(world, robot)
    if not (wait_now and tree.next_untried[node] >= WAIT_RANK):
        action = next_action(model, world, greedy, robot)
    _mark_tried(tree, greedy, node, 0)
    if action == NONE:
        if not wait_now and tree.next_untried[node] > 0:
            return NONE
        action = WAIT
    tree.next_untried[node] += 1
    return add_edge(tree, node, action)


@compiled
def _select(model: Model, world: World, tree: Tree, greedy: GreedyPolicy, search: Search, node: int) -> int:
    """The edge to follow: a new one while the node is too narrow for its visits, else the best by UCB1."""
    width = search.widening_factor * tree.visits[node] ** search.widening_exponent
    if tree.next_untried[node] == 0 or tree.next_untried[node] < width:
        edge = _widen(model, world, tree, greedy, node)
        if edge != NONE:
            return edge
    return least_bound(tree, node, search.exploration * spread_s(tree))


@compiled
def run_samples(
    model: Model, root: World, world: World, tree: Tree, greedy: GreedyPolicy, search: Search, rng: U8, samples: int
) -> None:
    """Runs samples from the root, whose node 0 must exist; ``world`` is overwritten.

    A full tree grows no further: samples then leave it at its fringe.
    """
    for _ in range(samples):
        copy_world(root, world)
        node, depth, outcome = 0, 0, DECIDE
        while True:
            edge = _select(model, world, tree, greedy, search, node)
            tree.visits[node] += 1
            if edge == NONE:  # a full tree's childless fringe
                outcome = rollout(model, world, greedy, rng)
                break
            tree.path[depth] = edge
            depth += 1
            act(model, world, tree.robot[node], tree.action[edge])
            key = 0
            if not any_undecided(world):
                world.state[HISTORY] = 0
                outcome = advance(model, world, rng)
                if outcome != DECIDE:
                    break
                key = world.state[HISTORY]
            child = child_of(tree, edge, key)
            if child == NONE or depth == tree.path.size:
                if child == NONE and tree.size[NODES] < tree.visits.size:
                    attach(tree, edge, decision_node(model, world, tree, greedy, key))
                outcome = rollout(model, world, greedy, rng)
                break
            node = child
        cost_s = world.clock[0]
        if outcome == STUCK:
            cost_s += model.penalty_s
        back_up(tree, depth, cost_s)
