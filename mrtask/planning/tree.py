"""The tree of histories that both PO-UCT planners search (Silver & Veness 2010), and the options they share.

A node is a history and the robot to decide for, an edge one of that robot's actions, a child of an edge what was
observed next: several robots that decide at one instant are nodes one below the other. Edges keep the costs of the
samples that went through them, and UCB1 (Auer et al. 2002) picks among them.

Legend: M nodes or edges at most, R robots. NONE ends lists.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrtask.planning.compiled import compiled
from mrtask.planning.problem import Assignment

F8 = NDArray[np.float64]
I4 = NDArray[np.int32]
I8 = NDArray[np.int64]

NONE = -1
NODES, EDGES = 0, 1
"""Indices of `Tree.size`."""
EDGE_MEAN, EDGE_WIDTH = 0, 1
"""Columns of `Tree.bound`: an edge's mean cost, and 1 / sqrt(visits)."""
COUNT, MEAN, SQUARES, MAX_SPREAD = 0, 1, 2, 3
"""Indices of `Tree.moments`: Welford's running sums, and the largest standard deviation so far."""
MAX_PATH = 4096
"""Decisions in one sample that the tree follows at most."""
BATCH_SAMPLES = 512
"""Samples between two looks at the clock and at whether the choice is settled."""


@dataclass(frozen=True)
class SearchOptions:
    """What bounds and steers a tree search."""

    samples: int = 100_000
    """At most."""
    time_limit_s: float | None = None
    """Stop earlier after this many seconds; plans then depend on the machine."""
    exploration: float = 1.0
    """UCB1's constant, in standard deviations of the cost at the root (the largest while the search went on)."""
    max_nodes: int = 1_000_000
    """The tree stops growing there; further samples only refine it."""

    def __post_init__(self) -> None:
        for name in ("samples", "max_nodes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, not {getattr(self, name)}")
        if self.exploration < 0:
            raise ValueError(f"exploration must be >= 0, not {self.exploration}")
        if self.time_limit_s is not None and self.time_limit_s <= 0:
            raise ValueError(f"time_limit_s must be > 0 or null, not {self.time_limit_s}")


class Tree(NamedTuple):
    """The arrays of a search, allocated once per plan."""

    size: I8  # [2] NODES and EDGES in use
    visits: I4  # [M]
    robot: I4  # [M]
    first_edge: I4  # [M] newest edge of a node
    next_untried: I4  # [M] a node's next action, by its planner's order, that it has not tried
    key: I8  # [M] what was observed on the way from the parent's edge
    sibling: I4  # [M] next child of the same edge
    action: I4  # [M] of an edge, in its planner's terms
    next_edge: I4  # [M] next older edge of the same node
    first_child: I4  # [M]
    edge_visits: I4  # [M] samples through an edge
    total_s: F8  # [M] their summed costs
    squares: F8  # [M] their summed squared costs
    bound: F8  # [M, 2] what UCB1 needs of them, kept so that no root or quotient is taken at each look
    path: I4  # [MAX_PATH] edges of the sample under way
    moments: F8  # [4] of all costs: COUNT, MEAN, SQUARES, MAX_SPREAD


def empty_tree(options: SearchOptions) -> Tree:
    """A tree without nodes, as large as the search can get."""
    nodes = min(options.samples + 1, options.max_nodes)

    def integers() -> I4:
        return np.empty(nodes, dtype=np.int32)

    return Tree(
        size=np.zeros(2, dtype=np.int64),
        visits=integers(),
        robot=integers(),
        first_edge=integers(),
        next_untried=integers(),
        key=np.empty(nodes, dtype=np.int64),
        sibling=integers(),
        action=integers(),
        next_edge=integers(),
        first_child=integers(),
        edge_visits=integers(),
        total_s=np.empty(nodes),
        squares=np.empty(nodes),
        bound=np.empty((nodes, 2)),
        path=np.empty(MAX_PATH, dtype=np.int32),
        moments=np.zeros(4),
    )


def run_search(
    options: SearchOptions, run: Callable[[int], None], is_settled: Callable[[int], bool] = lambda _: False
) -> int:
    """Calls ``run(count)`` until the samples or the time are spent or ``is_settled(samples left)``; the samples run."""
    began_s, done = perf_counter(), 0
    while done < options.samples and not is_settled(options.samples - done):
        count = min(BATCH_SAMPLES, options.samples - done)
        run(count)
        done += count
        if options.time_limit_s is not None and perf_counter() - began_s > options.time_limit_s:
            break
    return done


@compiled
def add_node(tree: Tree, robot: int, key: int) -> int:
    """A new node for a robot's decision."""
    node = tree.size[NODES]
    tree.size[NODES] = node + 1
    tree.visits[node] = 0
    tree.robot[node] = robot
    tree.first_edge[node] = NONE
    tree.next_untried[node] = 0
    tree.key[node] = key
    tree.sibling[node] = NONE
    return node


@compiled
def add_edge(tree: Tree, node: int, action: int) -> int:
    """A new action of a node."""
    edge = tree.size[EDGES]
    tree.size[EDGES] = edge + 1
    tree.action[edge] = action
    tree.next_edge[edge] = tree.first_edge[node]
    tree.first_child[edge] = NONE
    tree.edge_visits[edge] = 0
    tree.total_s[edge] = 0.0
    tree.squares[edge] = 0.0
    tree.first_edge[node] = edge
    return edge


@compiled
def child_of(tree: Tree, edge: int, key: int) -> int:
    """The node that follows an edge and an observation, NONE if it is new."""
    child = tree.first_child[edge]
    while child != NONE and tree.key[child] != key:
        child = tree.sibling[child]
    return child


@compiled
def attach(tree: Tree, edge: int, node: int) -> None:
    """Puts a new node at the end of an edge's children, where what is seen more often comes sooner."""
    child = tree.first_child[edge]
    if child == NONE:
        tree.first_child[edge] = node
        return
    while tree.sibling[child] != NONE:
        child = tree.sibling[child]
    tree.sibling[child] = node


@compiled
def spread_s(tree: Tree) -> float:
    """The scale of costs, for UCB1's constant: their largest standard deviation so far.

    The present one would fall while the search settles on one action, faster than the logarithm grows, and end
    exploration for good.
    """
    return tree.moments[MAX_SPREAD] if tree.moments[COUNT] > 1 else 1.0


@compiled
def least_bound(tree: Tree, node: int, exploration_s: float) -> int:
    """A node's edge of least lower confidence bound (UCB1 for costs); NONE if it has no edge."""
    radius_s = exploration_s * np.sqrt(np.log(tree.visits[node] + 1.0))
    best, best_bound = NONE, np.inf
    edge = tree.first_edge[node]
    while edge != NONE:
        bound = tree.bound[edge, EDGE_MEAN] - radius_s * tree.bound[edge, EDGE_WIDTH]
        if bound < best_bound:
            best, best_bound = edge, bound
        edge = tree.next_edge[edge]
    return best


@compiled
def back_up(tree: Tree, depth: int, cost_s: float) -> None:
    """Adds a sample's cost to the ``depth`` edges of its path."""
    moments = tree.moments
    moments[COUNT] += 1
    delta = cost_s - moments[MEAN]
    moments[MEAN] += delta / moments[COUNT]
    moments[SQUARES] += delta * (cost_s - moments[MEAN])
    moments[MAX_SPREAD] = max(moments[MAX_SPREAD], np.sqrt(moments[SQUARES] / moments[COUNT]))
    for step in range(depth):
        edge = tree.path[step]
        tree.edge_visits[edge] += 1
        tree.total_s[edge] += cost_s
        tree.squares[edge] += cost_s * cost_s
        visits = float(tree.edge_visits[edge])
        tree.bound[edge, EDGE_MEAN] = tree.total_s[edge] / visits
        tree.bound[edge, EDGE_WIDTH] = 1.0 / np.sqrt(visits)


def edges_of(tree: Tree, node: int) -> list[int]:
    """A node's edges, the newest first."""
    edges, edge = [], int(tree.first_edge[node])
    while edge != NONE:
        edges.append(edge)
        edge = int(tree.next_edge[edge])
    return edges


def mean_cost_s(tree: Tree, edge: int) -> float:
    """The mean cost of the samples through an edge."""
    return float(tree.total_s[edge] / tree.edge_visits[edge])


def most_visited(tree: Tree, node: int) -> int:
    """The most visited edge, of equals the one of least mean cost; NONE at a leaf."""
    return min(
        edges_of(tree, node), key=lambda edge: (-int(tree.edge_visits[edge]), mean_cost_s(tree, edge)), default=NONE
    )


def is_settled(tree: Tree, deciders: int, samples_left: int) -> bool:
    """Whether the most visited joint action of the robots that decide now stays so, wherever the samples left go."""
    node = 0
    for _ in range(deciders):
        visits = [*sorted((int(tree.edge_visits[edge]) for edge in edges_of(tree, node)), reverse=True), 0, 0]
        if visits[0] - visits[1] <= samples_left:
            return False
        node = int(tree.first_child[most_visited(tree, node)])
        if node == NONE:
            break
    return True


def root_statistics(
    tree: Tree, assignment: Callable[[int], Assignment]
) -> tuple[tuple[Assignment, int, float, float], ...]:
    """`PlanInfo.root`; ``assignment`` says what an action means."""
    rows = []
    for edge in sorted(edges_of(tree, 0), key=lambda edge: -tree.edge_visits[edge]):
        mean_s = mean_cost_s(tree, edge)
        variance = max(float(tree.squares[edge] / tree.edge_visits[edge]) - mean_s**2, 0.0)
        rows.append((assignment(int(tree.action[edge])), int(tree.edge_visits[edge]), mean_s, math.sqrt(variance)))
    return tuple(rows)
