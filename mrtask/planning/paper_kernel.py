"""The compiled search of `mrtask.planning.paper`: PO-UCT (Silver & Veness 2010) over the paper's belief states."""

from typing import NamedTuple

from mrtask.planning.compiled import compiled
from mrtask.planning.paper_action_kernel import ActionLimits, ActionRules, next_action
from mrtask.planning.paper_belief_kernel import (
    AUTOMATON,
    U8,
    WAIT,
    PaperBelief,
    PaperModel,
    act,
    any_undecided,
    copy_belief,
    mark_undecided,
    may_wait,
    sample_outcome,
)
from mrtask.planning.paper_leaf_kernel import Bound, Rollouts, rest_s
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


class Exploration(NamedTuple):
    """UCB1's constant, in seconds or in standard deviations of the cost."""

    constant: float
    per_spread: bool


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
def _select(
    model: PaperModel,
    belief: PaperBelief,
    tree: Tree,
    rules: ActionRules,
    limits: ActionLimits,
    node: int,
    exploration_s: float,
) -> int:
    """The edge to follow: an action not tried yet, else the best by UCB1; NONE if the robot can do nothing."""
    actions = model.prob.size
    if tree.next_untried[node] <= actions and tree.size[EDGES] < tree.action.size:
        action = next_action(model, belief, rules, limits, tree, node)
        if action < actions or may_wait(belief, tree.robot[node]) or tree.first_edge[node] == NONE:
            return add_edge(tree, node, action if action < actions else WAIT)
    return least_bound(tree, node, exploration_s)


@compiled
def _with_finds(belief: PaperBelief, outcome: int) -> int:
    """The key of an outcome: finds on the way tell histories apart. Unique for teams of up to 37 robots."""
    key = outcome
    for r in range(belief.place.size):
        obj = belief.obj[r]
        if obj != NONE:
            place = belief.place[r]
            key = 3 * key + ((belief.present[place] >> obj) & 1) + 2 * ((belief.absent[place] >> obj) & 1)
    return key


@compiled
def run_samples(
    model: PaperModel,
    root: PaperBelief,
    belief: PaperBelief,
    tree: Tree,
    rules: ActionRules,
    limits: ActionLimits,
    exploration: Exploration,
    bound: Bound,
    rollouts: Rollouts | None,
    rng: U8,
    samples: int,
) -> None:
    """Runs samples from node 0, which must exist; ``belief`` is overwritten.

    A full tree grows no further: samples then leave it at its fringe.
    """
    for _ in range(samples):
        copy_belief(model, root, belief)
        exploration_s = exploration.constant * (spread_s(tree) if exploration.per_spread else 1.0)
        node, depth, cost_s, at_leaf = 0, 0, 0.0, True
        while True:
            edge = _select(model, belief, tree, rules, limits, node, exploration_s)
            tree.visits[node] += 1
            if edge == NONE:
                break
            tree.path[depth] = edge
            depth += 1
            act(model, belief, tree.robot[node], tree.action[edge])
            key = NONE
            if not any_undecided(belief):
                key = sample_outcome(model, belief, rng)
                if key == NONE:
                    at_leaf, cost_s = False, model.penalty_s
                    break
                if model.accepting[belief.state[AUTOMATON]]:
                    at_leaf = False
                    break
                key = _with_finds(belief, key)
                mark_undecided(model, belief)
            child = child_of(tree, edge, key)
            if child == NONE or depth == tree.path.size:
                if child == NONE and tree.size[NODES] < tree.visits.size:
                    attach(tree, edge, decision_node(belief, tree, key))
                break
            node = child
        if at_leaf:
            cost_s = rest_s(model, belief, bound, rollouts, rng)
        back_up(tree, depth, belief.clock[0] + cost_s)
