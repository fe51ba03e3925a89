"""The planner `pouct_paper`, which is the paper's: PO-UCT over actions <container, object> with Algorithm 1's outcomes.

Free robots are assigned one after the other in the tree, each by UCB1 (Auer et al. 2002) over all pairs that make
progress (`mrtask.planning.paper.action_kernel`). A leaf's value is the time so far plus an estimate of the remaining
time. Wherever the paper's text, its authors' development code and our own reading differ, `PaperOptions` has a switch.
The defaults are the reading that comes nearest to the published improvements (`pipeline.ablation` shows what each
switch is worth). From the text they take Algorithm 1, the choice, and that only free robots decide; from the code, the
eight likeliest actions; our own are likelihoods that know that every object is somewhere.
"""

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from mrtask.arrays import Bools
from mrtask.planning.paper import leaf_kernel
from mrtask.planning.paper import search_kernel as kernel
from mrtask.planning.paper.action_kernel import LIMIT, ActionLimits, ActionRules, first_action
from mrtask.planning.paper.belief_kernel import PaperBelief, PaperModel
from mrtask.planning.paper.paper_model import blank_belief, bound_of, paper_model, rollouts_of, root_belief
from mrtask.planning.problem import WAIT, Assignment, Plan, PlanInfo, PlanningProblem, safe
from mrtask.planning.shared_kernel import NONE
from mrtask.planning.tree import (
    MAX_SPREAD,
    NODES,
    SearchOptions,
    Tree,
    edges_of,
    empty_tree,
    is_settled,
    mean_cost_s,
    root_statistics,
    run_search,
)

BOUNDS = {
    "zero": leaf_kernel.ZERO,
    "nearest": leaf_kernel.NEAREST,
    "revealed": leaf_kernel.REVEALED,
}
GREEDY = "greedy"


@dataclass(frozen=True)
class PaperOptions(SearchOptions):
    """Options of `pouct_paper`, under ``planner.pouct_paper`` in the configuration.

    "The text" is the paper (arXiv 2603.20544). "The code" is its authors' public development code (RAIL-lsp-dev, branch
    abhish/mr-task, May 2025), which is older than the text. Each option names the code's setting.
    """

    leaf: str = "revealed"
    """The value of the remaining task at a leaf. ``zero``: nothing (the code). ``nearest``: a lower bound on the time,
    with every object at the nearest container that may hold it (a reading of the text's "heuristic cost providing a
    lower bound"). ``revealed``: the mean time if the team learned the contents now and fetched all objects at once
    (ours). ``greedy``: the time that the policy `greedy` takes in a world drawn from the belief (from `pouct`)."""
    exploration_unit: str = "spread"
    """The unit of ``exploration``, UCB1's constant: ``spread``, standard deviations of the cost at the root (ours), or
    ``seconds``. The code's 10 grid cells of 0.05 m are 0.5 s at 1 m/s; the text does not say."""
    choice: str = "mean"
    """The joint action that is taken. ``mean``: the edges of least mean cost (the text). ``visits``: the most visited
    edges (the code), and of equally visited ones the one of least cost."""
    max_actions: int | None = 8
    """A node keeps at most this many actions of a robot, those of the highest P_S (the code: 8). An object known to be
    there counts as 1. null: all, as in the text."""
    avoid_targets: bool = False
    """Whether a team with at least as many actions as robots leaves containers to the robots that head for them (the
    code), unless nothing else is left."""
    advance_when_alone: bool = False
    """Whether a robot has only actions that advance the task while all others wait (the code), unless it has no such
    action."""
    round_decimals: int | None = None
    """The number of decimals to which P_S is rounded; null: no rounding (the text). The code: 2. An object that is
    possible stays possible."""
    exists: bool = True
    """Whether P_S is conditioned on every object being somewhere: an object that is not located is in container k with
    probability p_k / (1 - prod(1 - p)), over the containers where it may still be. The text says only that tasks are
    about existing objects; the code does not condition."""
    reassign: str = "free"
    """With ``free``, only free robots decide (Algorithm 1 to the letter). With ``all``, those under way decide too
    after news (the code assigns all robots again at each reveal)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, allowed in (
            ("leaf", (*BOUNDS, GREEDY)),
            ("exploration_unit", ("spread", "seconds")),
            ("choice", ("mean", "visits")),
            ("reassign", ("free", "all")),
        ):
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} must be one of {', '.join(allowed)}, not {getattr(self, name)!r}")
        if self.max_actions is not None and self.max_actions < 1:
            raise ValueError(f"max_actions must be at least 1 or null, not {self.max_actions}")
        if self.round_decimals is not None and self.round_decimals < 0:
            raise ValueError(f"round_decimals must be >= 0 or null, not {self.round_decimals}")


class PaperPouct(PaperOptions):
    """The paper's search planner, made from its options: ``PaperPouct(leaf="zero")``. See the module."""

    knows_contents = False

    def warm_up(self, problem: PlanningProblem) -> None:
        """Compile the kernels by planning with one sample."""
        replace(self, samples=1).plan(problem, seed=0)

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """Search from the problem's belief; ``seed`` starts the samples' random numbers.

        Raises:
            ValueError: the task has more objects than the kernel's bit masks hold.
        """
        began_s = perf_counter()
        free = [index for index, robot in enumerate(problem.robots) if robot.free]
        if problem.automaton.accepting[problem.state] or not free:
            return Plan({index: Assignment(WAIT) for index in free})
        search = PaperSearch(problem, self, seed)
        choose = _Choice(problem, search, self.choice)
        done = run_search(self, search.run, choose.is_settled)
        info = PlanInfo(
            planning_s=perf_counter() - began_s,
            samples=done,
            tree_nodes=int(search.tree.size[NODES]),
            value_s=mean_cost_s(search.tree, choose.edge(0)),
            root=root_statistics(search.tree, choose.assignment),
            root_robot=int(search.tree.nodes[0].robot),
        )
        return Plan(_joint_action(problem, search, choose), info)


class PaperSearch:
    """The arrays of one search: the model, the root's belief, and the tree, which `run` grows."""

    def __init__(self, problem: PlanningProblem, options: PaperOptions, seed: int) -> None:
        self.model: PaperModel = paper_model(
            problem, exists=options.exists, redirect=options.reassign == "all", round_decimals=options.round_decimals
        )
        self.root: PaperBelief = root_belief(problem, self.model)
        self.tree: Tree = empty_tree(options)
        self.rules = ActionRules(
            self.model.prob.size if options.max_actions is None else options.max_actions,
            options.avoid_targets,
            options.advance_when_alone,
        )
        self.limits = action_limits(self.rules, len(self.tree.nodes))
        self._exploration = kernel.Exploration(options.exploration, options.exploration_unit == "spread")
        self.bound = bound_of(problem, BOUNDS.get(options.leaf, leaf_kernel.ZERO))
        self.rollouts = rollouts_of(problem) if options.leaf == GREEDY else None
        self._belief = blank_belief(problem)
        self._rng = np.array([seed], dtype=np.uint64)
        kernel.decision_node(self.root, self.tree, NONE)

    def run(self, samples: int) -> None:
        """Run this many samples."""
        kernel.run_samples(
            self.model,
            self.root,
            self._belief,
            self.tree,
            self.rules,
            self.limits,
            self._exploration,
            self.bound,
            self.rollouts,
            self._rng,
            samples,
        )


def action_limits(rules: ActionRules, nodes: int) -> ActionLimits:
    """Return scratch space for the rules, for trees of up to ``nodes`` nodes."""
    return ActionLimits(
        nodes=np.recarray(nodes, dtype=LIMIT),
        ranked_prob=np.empty(rules.max_actions),
        ranked=np.empty(rules.max_actions, dtype=np.int64),
    )


class _Choice:
    """The rule for choosing an edge of a node.

    An action without an interaction that can hurt (see `safe`) replaces one with it if it costs no more as far as the
    samples can tell: the means lie within their standard errors. Likewise any other action replaces a detour, which is
    an interaction that can hurt and leads no nearer to acceptance. A detour that takes no time is left to teams that
    have nothing else: they could make one after the other at one instant and go round in circles.
    """

    def __init__(self, problem: PlanningProblem, search: PaperSearch, choice: str) -> None:
        self._tree, self._by_visits = search.tree, choice == "visits"
        self._deciders = int(search.root.robots.undecided.sum())
        self._objects = problem.presence_prob.shape[1]
        self._can_hurt = (problem.automaton.advancing & ~safe(problem.automaton))[problem.state]
        self._detours = self._can_hurt & ~_nearer(problem)
        self._at_once = _at_once(problem)

    def edge(self, node: int, allow_wait: bool = True) -> int:
        """Return the chosen edge, or NONE if the node has none; ``allow_wait`` says whether waiting may be chosen."""
        tree = self._tree
        edges = [edge for edge in edges_of(tree, node) if allow_wait or tree.edges[edge].action != WAIT]
        robot = int(tree.nodes[node].robot)
        in_no_circle = [edge for edge in edges if not (self._is_detour(edge) and self._takes_no_time(robot, edge))]
        best = self._best(in_no_circle if node > 0 else in_no_circle or edges)
        for is_worse in (self._hurts, self._is_detour):
            if best != NONE and is_worse(best):
                best = self._unless_as_good(best, self._best([edge for edge in edges if not is_worse(edge)]))
        return best

    def _best(self, edges: list[int]) -> int:
        return min(edges, key=self._rank, default=NONE)

    def _unless_as_good(self, best: int, other: int) -> int:
        """Return the other edge if there is one and it costs no more as far as the samples can tell."""
        if other == NONE:
            return best
        tree = self._tree
        error_s = tree.moments[MAX_SPREAD] * np.hypot(*(tree.edges[[best, other]].visits ** -0.5))
        return other if mean_cost_s(tree, other) <= mean_cost_s(tree, best) + error_s else best

    def assignment(self, action: int) -> Assignment:
        """Return the assignment that an action of the tree stands for."""
        return Assignment(WAIT, 0) if action == WAIT else Assignment(*divmod(action, self._objects))

    def is_settled(self, samples_left: int) -> bool:
        """Return whether the choice stays the same wherever the remaining samples go.

        Only a choice by visits can be settled, and only if no action can hurt.
        """
        return self._by_visits and not self._can_hurt.any() and is_settled(self._tree, self._deciders, samples_left)

    def _rank(self, edge: int) -> tuple[float, float]:
        visits = int(self._tree.edges[edge].visits)
        return (-visits if self._by_visits else 0, mean_cost_s(self._tree, edge))

    def _is_detour(self, edge: int) -> bool:
        action = int(self._tree.edges[edge].action)
        return action != WAIT and bool(self._detours[action % self._objects])

    def _takes_no_time(self, robot: int, edge: int) -> bool:
        return bool(self._at_once[robot, int(self._tree.edges[edge].action) // self._objects])

    def _hurts(self, edge: int) -> bool:
        action = int(self._tree.edges[edge].action)
        return action != WAIT and bool(self._can_hurt[action % self._objects])


def _nearer(problem: PlanningProblem) -> Bools:
    """Return the interactions [O] that lead nearer to acceptance now."""
    steps = problem.automaton.steps_with(problem.obtainable())
    return np.asarray(steps[problem.automaton.transitions[problem.state]] < steps[problem.state])


def _at_once(problem: PlanningProblem) -> Bools:
    """Return the containers [R, C] at which a robot's interaction would take no time at all."""
    ways_s = np.array([robot.travel_s for robot in problem.robots])
    timeless = np.array([problem.kinds[robot.kind].interact_time_s == 0.0 for robot in problem.robots])
    return np.asarray((ways_s == 0.0) & problem.searched & timeless[:, None])


def _joint_action(problem: PlanningProblem, search: PaperSearch, choose: _Choice) -> dict[int, Assignment]:
    """Follow the chosen edges through the robots that decide. Free robots that the tree did not reach wait.

    Some robot acts if any can: where the whole team would wait, the first robot takes its best other action.
    """
    tree = search.tree
    assignments = {index: Assignment(WAIT, 0) for index, robot in enumerate(problem.robots) if robot.free}
    deciders = [int(robot) for robot in np.flatnonzero(search.root.robots.undecided)]
    node = 0
    for _ in deciders:
        edge = choose.edge(node) if node != NONE else NONE
        if edge == NONE:
            break
        assignments[int(tree.nodes[node].robot)] = choose.assignment(int(tree.edges[edge].action))
        node = int(tree.edges[edge].first_child)
    resting = [index for index, chosen in assignments.items() if chosen.container == WAIT]
    if len(resting) == len(problem.robots):
        edge = choose.edge(0, allow_wait=False)
        robots = [(int(tree.nodes[0].robot), int(tree.edges[edge].action))] if edge != NONE else []
        robots += [(robot, first_action(search.model, search.root, robot)) for robot in deciders]
        robot, action = next((pair for pair in robots if pair[1] != NONE), (deciders[0], WAIT))
        assignments[robot] = choose.assignment(action)
    return assignments
