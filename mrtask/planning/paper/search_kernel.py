"""The compiled search of `mrtask.planning.paper.planner`: PO-UCT (Silver & Veness 2010) over its belief states."""

from typing import NamedTuple

from mrtask.arrays import UInt64s
from mrtask.planning.compiled import compiled, inlined
from mrtask.planning.paper.action_kernel import ActionLimits, ActionRules, next_action
from mrtask.planning.paper.belief_kernel import (
    PaperBelief,
    PaperModel,
    act,
    copy_belief,
    mark_undecided,
    may_wait,
    sample_outcome,
)
from mrtask.planning.paper.leaf_kernel import Bound, Rollouts, rest_s
from mrtask.planning.problem import WAIT
from mrtask.planning.reference import by_reference
from mrtask.planning.shared_kernel import AUTOMATON, NONE, any_undecided
from mrtask.planning.tree import (
    EDGES,
    NODES,
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


@inlined
def decision_node(belief: PaperBelief, tree: Tree, key: int) -> int:
    """Add a node for the undecided robot with the lowest number."""
    chosen = NONE
    for r in range(belief.robots.size):
        if belief.robots[r].undecided:
            chosen = r
            break
    return add_node(tree, chosen, key)


@inlined
def _select(
    model: PaperModel,
    belief: PaperBelief,
    tree: Tree,
    rules: ActionRules,
    limits: ActionLimits,
    node: int,
    exploration_s: float,
) -> int:
    """Return the edge to follow: an untried action, else the best by UCB1, or NONE if the robot can do nothing."""
    actions = model.prob.size
    if tree.nodes[node].next_untried <= actions and tree.size[EDGES] < tree.edges.size:
        action = next_action(model, belief, rules, limits, tree, node)
        if action < actions or may_wait(belief, tree.nodes[node].robot) or tree.nodes[node].first_edge == NONE:
            return add_edge(tree, node, action if action < actions else WAIT)
    return least_bound(tree, node, exploration_s)


@inlined
def _with_finds(belief: PaperBelief, outcome: int) -> int:
    """Return the key of an outcome that includes the finds on the way, which tell histories apart.

    Keys are unique for teams of up to 37 robots.
    """
    key = outcome
    for r in range(belief.robots.size):
        obj = belief.robots[r].obj
        if obj != NONE:
            place = belief.robots[r].place
            key = (
                3 * key
                + ((belief.containers[place].present >> obj) & 1)
                + 2 * ((belief.containers[place].absent >> obj) & 1)
            )
    return key


@inlined
def _sample(
    model: PaperModel,
    root: PaperBelief,
    belief: PaperBelief,
    tree: Tree,
    rules: ActionRules,
    limits: ActionLimits,
    exploration: Exploration,
    bound: Bound,
    rollouts: Rollouts | None,
    rng: UInt64s,
) -> None:
    """Run one sample from the root. The tree grows by one node unless it is full."""
    copy_belief(model, root, belief)
    exploration_s = exploration.constant * (spread_s(tree) if exploration.per_spread else 1.0)
    node, depth, cost_s, at_leaf = 0, 0, 0.0, True
    while True:
        edge = _select(model, belief, tree, rules, limits, node, exploration_s)
        tree.nodes[node].visits += 1
        if edge == NONE:
            break
        tree.path[depth] = edge
        depth += 1
        act(model, belief, tree.nodes[node].robot, tree.edges[edge].action)
        key = NONE
        if not any_undecided(belief):
            key = sample_outcome(model, belief, rng)
            if key == NONE:
                at_leaf, cost_s = False, model.penalty_s
                break
            if model.states[belief.state[AUTOMATON]].accepting:
                at_leaf = False
                break
            key = _with_finds(belief, key)
            mark_undecided(model, belief)
        child = child_of(tree, edge, key)
        if child == NONE or depth == tree.path.size:
            if child == NONE and tree.size[NODES] < tree.nodes.size:
                attach(tree, edge, decision_node(belief, tree, key))
            break
        node = child
    if at_leaf:
        cost_s = rest_s(model, belief, bound, rollouts, rng)
    back_up(tree, depth, belief.clock[0] + cost_s)


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
    rng: UInt64s,
    samples: int,
) -> None:
    """Run samples from node 0, which must exist; ``belief`` is overwritten."""
    model, root, belief, tree = by_reference(model), by_reference(root), by_reference(belief), by_reference(tree)
    rules, limits, exploration = by_reference(rules), by_reference(limits), by_reference(exploration)
    bound, rollouts = by_reference(bound), by_reference(rollouts)
    for _ in range(samples):
        _sample(model, root, belief, tree, rules, limits, exploration, bound, rollouts, rng)
