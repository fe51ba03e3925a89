"""The tree of histories that both PO-UCT planners search (Silver & Veness 2010), and the options that they share.

A node is a history and the robot that decides; an edge is one of that robot's actions; a child of an edge is the
observation that follows. Several robots that decide at one instant are nodes one below the other. Edges keep the costs
of the samples that went through them, and UCB1 (Auer et al. 2002) chooses among them.

Legend: M nodes or edges at most, R robots. NONE ends a list.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import NamedTuple

import numpy as np

from mrtask.arrays import Floats, Ints
from mrtask.planning.compiled import Records, inlined
from mrtask.planning.problem import Assignment
from mrtask.planning.shared_kernel import NONE

NODES, EDGES = 0, 1
"""Indices of `Tree.size`."""
COUNT, MEAN, SQUARES, MAX_SPREAD = 0, 1, 2, 3
"""Indices of `Tree.moments`: Welford's running sums, and the largest standard deviation so far."""
MAX_PATH = 4096
"""The largest number of decisions that the tree follows in one sample."""
BATCH_SAMPLES = 512
"""The number of samples between two checks of the clock and of whether the choice is settled."""


@dataclass(frozen=True)
class SearchOptions:
    """The options that limit and steer a tree search."""

    samples: int = 100_000
    """The largest number of samples."""
    time_limit_s: float | None = None
    """Stop earlier after this many seconds; plans then depend on the machine."""
    exploration: float = 1.0
    """UCB1's constant, in standard deviations of the cost at the root (the largest so far in the search)."""
    max_nodes: int = 1_000_000
    """The tree stops growing at this size; further samples only refine it."""

    def __post_init__(self) -> None:
        for name in ("samples", "max_nodes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, not {getattr(self, name)}")
        if self.exploration < 0:
            raise ValueError(f"exploration must be >= 0, not {self.exploration}")
        if self.time_limit_s is not None and self.time_limit_s <= 0:
            raise ValueError(f"time_limit_s must be > 0 or null, not {self.time_limit_s}")


NODE = np.dtype(
    [
        ("key", np.int64),  # the observation that led here from the parent's edge
        ("visits", np.int64),
        ("robot", np.int64),
        ("first_edge", np.int64),  # its newest edge
        ("next_untried", np.int64),  # the next action, in its planner's order, that the node has not tried
        ("sibling", np.int64),  # the next child of the same edge
        ("best", np.int64),  # the most visited edge, kept by `back_up_best`
        ("passed_s", np.float64),  # visits times that edge's mean cost, as last passed on to the parent's edge
    ],
    align=True,
)
EDGE = np.dtype(
    [
        ("action", np.int64),  # numbered as its planner does
        ("next_edge", np.int64),  # the next older edge of the same node
        ("first_child", np.int64),
        ("visits", np.int64),  # samples through the edge
        ("total_s", np.float64),  # their summed costs
        ("squares", np.float64),  # their summed squared costs
        ("backed_s", np.float64),  # `total_s`, but with nodes' best actions in place of all samples: `back_up_best`
        ("mean_s", np.float64),  # what UCB1 needs, stored so that it takes no root or quotient each time:
        ("width", np.float64),  # the mean cost, and 1 / sqrt(visits)
    ],
    align=True,
)


class Tree(NamedTuple):
    """The arrays of a search, allocated once per plan."""

    size: Ints  # [2] NODES and EDGES in use
    nodes: Records  # [M] of NODE
    edges: Records  # [M] of EDGE
    path: Ints  # [MAX_PATH] edges of the sample under way
    nodes_of_path: Ints  # [MAX_PATH] the nodes that these edges leave
    moments: Floats  # [4] of all costs: COUNT, MEAN, SQUARES, MAX_SPREAD


def empty_tree(options: SearchOptions) -> Tree:
    """Return a tree without nodes, as large as the search can get."""
    nodes = min(options.samples + 1, options.max_nodes)
    return Tree(
        size=np.zeros(2, dtype=np.int64),
        nodes=np.recarray(nodes, dtype=NODE),
        edges=np.recarray(nodes, dtype=EDGE),
        path=np.empty(MAX_PATH, dtype=np.int64),
        nodes_of_path=np.empty(MAX_PATH, dtype=np.int64),
        moments=np.zeros(4),
    )


def run_search(
    options: SearchOptions, run: Callable[[int], None], is_settled: Callable[[int], bool] = lambda _: False
) -> int:
    """Call ``run(count)`` until the samples or the time are used up or the choice is settled.

    ``is_settled`` gets the number of samples that remain. Returns the number of samples that were run.
    """
    began_s, done = perf_counter(), 0
    while done == 0 or (done < options.samples and not is_settled(options.samples - done)):
        count = min(BATCH_SAMPLES, options.samples - done)
        run(count)
        done += count
        if options.time_limit_s is not None and perf_counter() - began_s > options.time_limit_s:
            break
    return done


@inlined
def add_node(tree: Tree, robot: int, key: int) -> int:
    """Add a node for a robot's decision, and return it."""
    node = tree.size[NODES]
    tree.size[NODES] = node + 1
    record = tree.nodes[node]
    record.key = key
    record.visits = 0
    record.robot = robot
    record.first_edge = NONE
    record.next_untried = 0
    record.sibling = NONE
    record.best = NONE
    record.passed_s = 0.0
    return node


@inlined
def add_edge(tree: Tree, node: int, action: int) -> int:
    """Add an action to a node, and return its edge."""
    edge = tree.size[EDGES]
    tree.size[EDGES] = edge + 1
    record = tree.edges[edge]
    record.action = action
    record.next_edge = tree.nodes[node].first_edge
    record.first_child = NONE
    record.visits = 0
    record.total_s = 0.0
    record.squares = 0.0
    record.backed_s = 0.0
    tree.nodes[node].first_edge = edge
    return edge


@inlined
def child_of(tree: Tree, edge: int, key: int) -> int:
    """Return the node that follows an edge and an observation, or NONE if it is new."""
    child = tree.edges[edge].first_child
    while child != NONE and tree.nodes[child].key != key:
        child = tree.nodes[child].sibling
    return child


@inlined
def attach(tree: Tree, edge: int, node: int) -> None:
    """Append a new node to an edge's children. Frequent observations thus tend to come early."""
    child = tree.edges[edge].first_child
    if child == NONE:
        tree.edges[edge].first_child = node
        return
    while tree.nodes[child].sibling != NONE:
        child = tree.nodes[child].sibling
    tree.nodes[child].sibling = node


@inlined
def spread_s(tree: Tree) -> float:
    """Return the scale of the costs for UCB1's constant: their largest standard deviation so far.

    The present standard deviation would fall while the search settles on one action, faster than the logarithm grows,
    and would end exploration for good.
    """
    return tree.moments[MAX_SPREAD] if tree.moments[COUNT] > 1 else 1.0


@inlined
def least_bound(tree: Tree, node: int, exploration_s: float, tie_s: float = 0.0) -> int:
    """Return a node's edge with the least lower confidence bound (UCB1 for costs), or NONE if it has no edge.

    A newer edge is taken unless an older one is better by more than ``tie_s``.
    """
    radius_s = exploration_s * np.sqrt(np.log(tree.nodes[node].visits + 1.0))
    best, best_bound = NONE, np.inf
    edge = tree.nodes[node].first_edge
    while edge != NONE:
        record = tree.edges[edge]
        bound = record.mean_s - radius_s * record.width
        if bound < best_bound - tie_s:
            best, best_bound = edge, bound
        edge = record.next_edge
    return best


@inlined
def least_visited(tree: Tree, node: int) -> int:
    """Return a node's least visited edge (the newest of equals), or NONE if it has no edge."""
    least, edge = NONE, tree.nodes[node].first_edge
    while edge != NONE:
        if least == NONE or tree.edges[edge].visits < tree.edges[least].visits:
            least = edge
        edge = tree.edges[edge].next_edge
    return least


@inlined
def _count_cost(tree: Tree, cost_s: float) -> None:
    """Add a sample's cost to the moments."""
    moments = tree.moments
    moments[COUNT] += 1
    delta = cost_s - moments[MEAN]
    moments[MEAN] += delta / moments[COUNT]
    moments[SQUARES] += delta * (cost_s - moments[MEAN])
    moments[MAX_SPREAD] = max(moments[MAX_SPREAD], np.sqrt(moments[SQUARES] / moments[COUNT]))


@inlined
def _count_visit(tree: Tree, edge: int, cost_s: float) -> float:
    """Add a sample to an edge, and return the number of the edge's samples."""
    record = tree.edges[edge]
    record.visits += 1
    record.total_s += cost_s
    record.squares += cost_s * cost_s
    visits = float(record.visits)
    record.width = 1.0 / np.sqrt(visits)
    return visits


@inlined
def back_up(tree: Tree, depth: int, cost_s: float) -> None:
    """Add a sample's cost to the ``depth`` edges of its path."""
    _count_cost(tree, cost_s)
    for step in range(depth):
        visits = _count_visit(tree, tree.path[step], cost_s)
        edge = tree.edges[tree.path[step]]
        edge.mean_s = edge.total_s / visits


@inlined
def back_up_best(tree: Tree, depth: int, cost_s: float) -> None:
    """Add a sample's cost to the ``depth`` edges of its path, with the best choice at each node instead of all samples.

    A node passes on the mean cost of its most visited edge, as if all its samples had taken it: those that explored
    other edges say what these cost, not what the node's decision will cost.
    """
    _count_cost(tree, cost_s)
    gained_s = cost_s
    for step in range(depth - 1, -1, -1):
        visits = _count_visit(tree, tree.path[step], cost_s)
        edge, node = tree.edges[tree.path[step]], tree.nodes[tree.nodes_of_path[step]]
        edge.backed_s += gained_s
        edge.mean_s = edge.backed_s / visits
        if node.best == NONE or _is_better(tree, tree.path[step], node.best):
            node.best = tree.path[step]
        passed_s = node.visits * tree.edges[node.best].mean_s
        gained_s = passed_s - node.passed_s
        node.passed_s = passed_s


@inlined
def _is_better(tree: Tree, edge: int, other: int) -> bool:
    """Return whether an edge has more visits than another one, or as many and a lower mean cost."""
    one, two = tree.edges[edge], tree.edges[other]
    return one.visits > two.visits or (one.visits == two.visits and one.mean_s < two.mean_s)


def edges_of(tree: Tree, node: int) -> list[int]:
    """Return a node's edges, starting with the newest."""
    edges, edge = [], int(tree.nodes[node].first_edge)
    while edge != NONE:
        edges.append(edge)
        edge = int(tree.edges[edge].next_edge)
    return edges


def mean_cost_s(tree: Tree, edge: int) -> float:
    """Return the mean cost of an edge, as it was backed up."""
    return float(tree.edges[edge].mean_s)


def best_of(tree: Tree, edges: list[int]) -> int:
    """Return the most visited of the edges, or NONE if there are none.

    Of equally visited edges, take the one with the least mean cost.
    """
    return min(edges, key=lambda edge: (-int(tree.edges[edge].visits), mean_cost_s(tree, edge)), default=NONE)


def most_visited(tree: Tree, node: int) -> int:
    """Return a node's most visited edge, or NONE at a leaf; see `best_of`."""
    return best_of(tree, edges_of(tree, node))


def is_settled(tree: Tree, deciders: int, samples_left: int) -> bool:
    """Return whether the search has settled on its joint action for the robots that decide now.

    It has when the most visited joint action stays the most visited one, wherever the remaining samples go.
    """
    node = 0
    for _ in range(deciders):
        visits = [*sorted((int(tree.edges[edge].visits) for edge in edges_of(tree, node)), reverse=True), 0, 0]
        if visits[0] - visits[1] <= samples_left:
            return False
        node = int(tree.edges[most_visited(tree, node)].first_child)
        if node == NONE:
            break
    return True


def root_statistics(
    tree: Tree, assignment: Callable[[int], Assignment]
) -> tuple[tuple[Assignment, int, float, float], ...]:
    """Return `PlanInfo.root`; ``assignment`` translates the tree's actions."""
    rows = []
    for edge in sorted(edges_of(tree, 0), key=lambda edge: -tree.edges[edge].visits):
        action, visits = int(tree.edges[edge].action), int(tree.edges[edge].visits)
        sampled_s = float(tree.edges[edge].total_s) / visits
        variance = max(float(tree.edges[edge].squares) / visits - sampled_s**2, 0.0)
        rows.append((assignment(action), visits, mean_cost_s(tree, edge), math.sqrt(variance)))
    return tuple(rows)
