"""`pouct`: our planner. PO-UCT (Silver & Veness 2010) over the team's concurrent actions, with greedy rollouts.

Against the paper's planner it differs in that actions are containers and a search reveals all task objects there;
every sample is consistent with one hidden world in which all objects exist; leaves are valued by finishing the task
with the greedy policy (least travel / probability of advancing); containers enter the tree in that greedy order by
progressive widening; robots under way may be redirected; and the most visited action is taken.

`greedy` is the rollout's policy by itself, and `known` the same search with the contents given.
"""

import math
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from mrtask.planning import pouct_kernel as kernel
from mrtask.planning.problem import (
    ANY_SAFE,
    WAIT,
    Assignment,
    Plan,
    PlanInfo,
    PlanningProblem,
    needed,
    safe,
)

SMALLEST_PROB = 1e-6
"""Likelihoods of 0 and 1 move this far inside: a container that should hold nothing is searched last, not never."""
CACHED_ROWS = 4096
DEEPEST_PATH = 4096
BATCH_SAMPLES = 512
MOST_OBJECTS = 30


@dataclass(frozen=True)
class PouctOptions:
    """Options of `pouct`, under ``planner.pouct`` in the configuration."""

    samples: int = 100_000
    """At most; a search whose most visited joint action no longer can be overtaken ends earlier, with the same plan."""
    time_limit_s: float | None = None
    """Stop earlier after this many seconds; plans then depend on the machine."""
    exploration: float = 1.0
    """UCB1's constant, in standard deviations of the makespan at the root."""
    widening_factor: float = 1.0
    widening_exponent: float = 0.3
    """A node with n visits has up to factor * n ** exponent actions."""
    later_weight: float = 0.3
    """What finding an object that is needed later counts against finding one that advances the task now."""
    reassign: str = "all"
    """``all``: robots under way may be redirected at each decision; ``free``: only free robots decide."""
    max_nodes: int = 1_000_000
    """The tree stops growing there; further samples only refine it."""

    def __post_init__(self) -> None:
        for name in ("samples", "max_nodes"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, not {getattr(self, name)}")
        for name in ("exploration", "widening_exponent"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must be >= 0, not {getattr(self, name)}")
        if self.widening_factor <= 0:
            raise ValueError(f"widening_factor must be > 0, not {self.widening_factor}")
        if not 0 < self.later_weight <= 1:
            raise ValueError(f"later_weight must be in (0, 1], not {self.later_weight}")
        if self.time_limit_s is not None and self.time_limit_s <= 0:
            raise ValueError(f"time_limit_s must be > 0 or null, not {self.time_limit_s}")
        if self.reassign not in ("all", "free"):
            raise ValueError(f"reassign must be 'all' or 'free', not {self.reassign!r}")


class Pouct:
    """The search planner; see the module and `PouctOptions`."""

    def __init__(self, options: PouctOptions) -> None:
        self.options = options

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """Searches from the problem's belief; ``seed`` starts the random numbers of the samples.

        Raises:
            ValueError: more task objects than the kernel's bit masks hold.
        """
        began_s = perf_counter()
        if problem.automaton.accepting[problem.state]:
            return Plan({index: Assignment(WAIT) for index, robot in enumerate(problem.robots) if robot.free})
        options = self.options
        model, root, cache, skip = prepare(problem, options.later_weight, options.reassign == "all")
        nodes = min(options.samples + 1, options.max_nodes)
        tree = _empty_tree(nodes)
        kernel.make_root(model, root, tree, cache, skip)
        world = _blank_world(len(problem.searched), len(root.nowhere), len(problem.robots))
        search = kernel.Search(options.exploration, options.widening_factor, options.widening_exponent)
        rng = np.array([seed], dtype=np.uint64)
        moments, path = np.zeros(3), np.empty(DEEPEST_PATH, dtype=np.int32)
        done, deciders = 0, int(root.undecided.sum())
        while done < options.samples and not _is_settled(tree, deciders, options.samples - done):
            count = min(BATCH_SAMPLES, options.samples - done)
            kernel.run_samples(model, root, world, tree, cache, search, rng, count, moments, path, skip)
            done += count
            if options.time_limit_s is not None and perf_counter() - began_s > options.time_limit_s:
                break
        best = _best_edge(tree, 0)
        info = PlanInfo(
            planning_s=perf_counter() - began_s,
            samples=done,
            tree_nodes=int(tree.size[0]),
            value_s=float(tree.total_s[best] / tree.tries[best]),
            root=tuple(_root_statistics(tree)),
        )
        return Plan(_most_visited(model, root, tree, cache, skip), info)


class Greedy:
    """The rollout's policy: at each decision the least travel time over probability of advancing, over all pairs."""

    def __init__(self, later_weight: float = PouctOptions.later_weight) -> None:
        self._later_weight = later_weight

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """Assigns all robots; the rule draws nothing, so ``seed`` does not matter."""
        model, root, cache, skip = prepare(problem, self._later_weight, reassign_all=True)
        assignments: dict[int, Assignment] = {}
        while (robot := kernel.greedy_step(model, root, cache, skip)) != kernel.NONE:
            assignments[robot] = _assignment_begun(root, robot)
        return Plan(assignments)


class Known(Pouct):
    """The same search with the contents known: what uncertainty costs is the difference to it."""

    knows_contents = True


def prepare(
    problem: PlanningProblem, later_weight: float, reassign_all: bool
) -> tuple[kernel.Model, kernel.World, kernel.Usefulness, kernel.U1]:
    """The problem in the kernel's terms: the model, the root world, an empty cache, and scratch space."""
    containers, objects = problem.presence_prob.shape
    if objects > MOST_OBJECTS:
        raise ValueError(f"pouct handles tasks of up to {MOST_OBJECTS} objects, this one has {objects}")
    automaton = problem.automaton
    reachable = np.isfinite(np.array([robot.travel_s for robot in problem.robots])).any(axis=0)
    prob = np.clip(problem.presence_prob, SMALLEST_PROB, 1.0 - SMALLEST_PROB)
    prob[~reachable] = 0.0
    finite_s = problem.travel_s[np.isfinite(problem.travel_s)]
    model = kernel.Model(
        travel_s=np.ascontiguousarray(problem.travel_s, dtype=np.float64),
        prob=prob,
        transitions=automaton.transitions.astype(np.int32),
        accepting=automaton.accepting.astype(np.uint8),
        advancing=_masks(automaton.advancing),
        safe=_masks(safe(automaton)),
        needed=_masks(needed(automaton)),
        steps=automaton.steps_to_accept.astype(np.int32),
        search_time_s=float(problem.search_time_s),
        interact_time_s=float(problem.interact_time_s),
        later_weight=later_weight,
        penalty_s=float(containers * (finite_s.max(initial=1.0) + problem.search_time_s)),
    )
    root = _blank_world(containers, objects, len(problem.robots))
    root.searched[:] = problem.searched
    root.holds[:] = np.where(problem.searched, _masks(problem.presence_prob > 0), 0)
    root.nowhere[:] = np.prod(np.where(problem.searched[:, None], 1.0, 1.0 - prob), axis=0)
    root.state[0] = problem.state
    root.state[1] = np.bitwise_or.reduce(root.holds)
    for index, robot in enumerate(problem.robots):
        root.place[index], root.want[index], root.until_s[index] = robot.place, robot.interaction, np.inf
        root.origin[index] = robot.place
        root.away[index] = robot.travel_s
        if robot.free:
            root.undecided[index] = 1
            continue
        root.until_s[index] = robot.remaining_s
        if robot.target >= 0:
            root.mode[index], root.place[index], root.origin[index] = kernel.MOVING, robot.target, kernel.NONE
        else:
            root.mode[index] = kernel.SEARCHING if robot.interacting < 0 else kernel.INTERACTING
            root.doing[index] = robot.interacting
        root.targeted[root.place[index]] += 1
        if reassign_all and problem.may_redirect and robot.target >= 0:
            kernel.reconsider(root, index)
    rows = min(CACHED_ROWS, len(automaton.accepting) << objects)
    cache = kernel.Usefulness(np.full(rows, kernel.NONE, dtype=np.int64), np.empty((rows, containers)))
    return model, root, cache, np.zeros(containers + objects, dtype=np.uint8)


def _masks(members: np.ndarray) -> kernel.I8:
    """[N] bit masks of the rows of a boolean [N, O]."""
    result: kernel.I8 = (members.astype(np.int64) << np.arange(members.shape[1])).sum(axis=1)
    return result


def _blank_world(containers: int, objects: int, robots: int) -> kernel.World:
    return kernel.World(
        clock=np.zeros(1),
        state=np.zeros(4, dtype=np.int64),
        searched=np.zeros(containers, dtype=np.uint8),
        holds=np.zeros(containers, dtype=np.int64),
        targeted=np.zeros(containers, dtype=np.int32),
        nowhere=np.ones(objects),
        mode=np.full(robots, kernel.FREE, dtype=np.int32),
        place=np.full(robots, kernel.NONE, dtype=np.int32),
        want=np.full(robots, kernel.NONE, dtype=np.int32),
        doing=np.full(robots, kernel.NONE, dtype=np.int32),
        until_s=np.full(robots, np.inf),
        since_s=np.zeros(robots),
        origin=np.full(robots, kernel.NONE, dtype=np.int32),
        away=np.zeros((robots, containers)),
        undecided=np.zeros(robots, dtype=np.uint8),
    )


def _empty_tree(nodes: int) -> kernel.Tree:
    def integers(dtype: type = np.int32) -> np.ndarray:
        return np.empty(nodes, dtype=dtype)

    return kernel.Tree(
        size=np.zeros(2, dtype=np.int64),
        visits=integers(),
        robot=integers(),
        first_edge=integers(),
        edges=integers(),
        key=integers(np.int64),
        sibling=integers(),
        action=integers(),
        next_edge=integers(),
        first_child=integers(),
        tries=integers(),
        total_s=np.empty(nodes),
        squares=np.empty(nodes),
    )


def _edges(tree: kernel.Tree, node: int) -> list[int]:
    edges, edge = [], int(tree.first_edge[node])
    while edge != kernel.NONE:
        edges.append(edge)
        edge = int(tree.next_edge[edge])
    return edges


def _best_edge(tree: kernel.Tree, node: int) -> int:
    """The most visited edge, of equals the one of least mean cost; NONE at a leaf."""
    edges = _edges(tree, node)
    if not edges:
        return kernel.NONE
    return min(edges, key=lambda edge: (-tree.tries[edge], tree.total_s[edge] / tree.tries[edge]))


def _most_visited(
    model: kernel.Model, root: kernel.World, tree: kernel.Tree, cache: kernel.Usefulness, skip: kernel.U1
) -> dict[int, Assignment]:
    """Follows the most visited edges through the robots to be decided now; greedy where the tree ends before them.

    The root world is used up.
    """
    assignments: dict[int, Assignment] = {}
    node = 0
    while root.undecided.any():
        edge = _best_edge(tree, node) if node != kernel.NONE else kernel.NONE
        if edge == kernel.NONE:
            robot = kernel.greedy_step(model, root, cache, skip)
            node = kernel.NONE
        else:
            robot = int(tree.robot[node])
            kernel.act(model, root, robot, int(tree.action[edge]))
            node = int(tree.first_child[edge])
        assignments[robot] = _assignment_begun(root, robot)
    return assignments


def _is_settled(tree: kernel.Tree, deciders: int, samples_left: int) -> bool:
    """Whether the most visited joint action of the robots that decide now stays so, wherever the samples left go."""
    node = 0
    for _ in range(deciders):
        tries = [*sorted((int(tree.tries[edge]) for edge in _edges(tree, node)), reverse=True), 0, 0]
        if tries[0] - tries[1] <= samples_left:
            return False
        node = int(tree.first_child[_best_edge(tree, node)])
        if node == kernel.NONE:
            break
    return True


def _root_statistics(tree: kernel.Tree) -> list[tuple[int, int, float, float]]:
    rows = []
    for edge in sorted(_edges(tree, 0), key=lambda edge: -tree.tries[edge]):
        count = int(tree.tries[edge])
        mean_s = float(tree.total_s[edge]) / count
        variance = max(float(tree.squares[edge]) / count - mean_s**2, 0.0)
        rows.append((int(tree.action[edge]), count, mean_s, math.sqrt(variance)))
    return rows


def _assignment_begun(world: kernel.World, robot: int) -> Assignment:
    """What `kernel.act` just made of a robot, as an assignment."""
    if world.mode[robot] != kernel.MOVING:
        return Assignment(WAIT)
    want = int(world.want[robot])
    return Assignment(int(world.place[robot]), ANY_SAFE if want == kernel.NONE else want)
