"""The planner `pouct`, which is ours.

It runs PO-UCT (Silver & Veness 2010) over the team's concurrent actions, with greedy rollouts. Interactions that cannot
hurt the task are automatic where they take no time; where they do, the search decides on them like on all others.
"""

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from mrtask.planning import pouct_kernel as kernel
from mrtask.planning.greedy import LATER_WEIGHT, assign_greedily, check_later_weight, policy
from mrtask.planning.greedy_kernel import GreedyPolicy
from mrtask.planning.problem import (
    ANY_SAFE,
    NONE_UNNAMED,
    REASSIGN,
    WAIT,
    Assignment,
    Plan,
    PlanInfo,
    PlanningProblem,
    check_choice,
)
from mrtask.planning.shared_kernel import AUTOMATON, NONE
from mrtask.planning.team_kernel import FOUND, Model, World, act, nearest_holding
from mrtask.planning.team_model import assignment_begun, blank_world, root_world, team_model
from mrtask.planning.tree import (
    NODES,
    SearchOptions,
    Tree,
    best_of,
    edges_of,
    empty_tree,
    is_settled,
    mean_cost_s,
    most_visited,
    root_statistics,
    run_search,
    spread_s,
)

LEAST_VISITS = 1.0
"""Among the robots that decide now, a decision with n visits takes each action at least this times sqrt(n) times."""


@dataclass(frozen=True)
class PouctOptions(SearchOptions):
    """Options of `pouct`, under ``planner.pouct`` in the configuration.

    A search stops before it has used all its samples once no other joint action can overtake the most visited one. The
    plan is the same.
    """

    widening_factor: float = 1.0
    widening_exponent: float = 0.3
    """A node with n visits has at most factor * n ** exponent actions."""
    later_weight: float = LATER_WEIGHT
    """The weight of finding an object that is needed later, relative to one that advances the task now."""
    reassign: str = "all"
    """With ``all``, robots under way may be redirected at each decision; with ``free``, only free robots decide."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.widening_exponent < 0:
            raise ValueError(f"widening_exponent must be >= 0, not {self.widening_exponent}")
        if self.widening_factor <= 0:
            raise ValueError(f"widening_factor must be > 0, not {self.widening_factor}")
        check_later_weight(self.later_weight)
        check_choice("reassign", self.reassign, REASSIGN)


class Pouct(PouctOptions):
    """Our search planner, made from its options: ``Pouct(samples=1000)``. See the module and `PouctOptions`."""

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
        if problem.automaton.accepting[problem.state]:
            return Plan({index: Assignment(WAIT) for index, robot in enumerate(problem.robots) if robot.free})
        decide_all = problem.interact_time_s > 0
        unnamed = NONE_UNNAMED if decide_all else ANY_SAFE
        model = team_model(problem, decide_all)
        root, world = root_world(problem, model, self.reassign == "all"), blank_world(problem)
        deciders = int(root.robots.undecided.sum())
        if deciders == 0:
            return Plan({})
        greedy, tree = policy(problem, self.later_weight), empty_tree(self)
        choose = _Choice(model, root, tree)
        search = kernel.Search(self.exploration, self.widening_factor, self.widening_exponent, LEAST_VISITS)
        rng = np.array([seed], dtype=np.uint64)
        done = run_search(
            self,
            run=lambda count: kernel.run_samples(model, root, world, tree, greedy, search, rng, count),
            is_settled=lambda samples_left: not choose.detours and is_settled(tree, deciders, samples_left),
        )
        best, first = choose.edge(0), int(tree.nodes[0].robot)
        info = PlanInfo(
            planning_s=perf_counter() - began_s,
            samples=done,
            tree_nodes=int(tree.size[NODES]),
            value_s=mean_cost_s(tree, best),
            root=root_statistics(tree, lambda action: _assignment(model, root, first, action, unnamed)),
            root_robot=first,
        )
        return Plan(_joint_action(model, root, choose, greedy, unnamed), info)


def _assignment(model: Model, root: World, robot: int, action: int, unnamed: int) -> Assignment:
    """Return the assignment that an action of the tree stands for, for a robot at the root."""
    containers = len(root.containers.searched)
    if action < containers:
        return Assignment(action, unnamed)
    return Assignment(nearest_holding(model, root, robot, action - containers), action - containers)


class _Choice:
    """The rule for choosing an edge of a node at which a robot decides now.

    The most visited edge is chosen. A detour, which is an interaction that may hurt and leads no nearer to acceptance,
    must be better than all else by more than the samples' standard error. Otherwise a team for which a detour costs no
    time could make one after the other and go round in circles.
    """

    def __init__(self, model: Model, root: World, tree: Tree) -> None:
        self.tree, self._containers = tree, len(root.containers)
        state = model.states[root.state[AUTOMATON]]
        self.detours = int(state.worth & ~state.nearer & root.state[FOUND])

    def edge(self, node: int) -> int:
        """Return the chosen edge, or NONE if the node has none."""
        best = most_visited(self.tree, node)
        if best == NONE or not self._is_detour(best):
            return best
        direct = best_of(self.tree, [edge for edge in edges_of(self.tree, node) if not self._is_detour(edge)])
        if direct == NONE:
            return best
        error_s = spread_s(self.tree) * np.hypot(*(self.tree.edges[[best, direct]].visits ** -0.5))
        return direct if mean_cost_s(self.tree, direct) <= mean_cost_s(self.tree, best) + error_s else best

    def _is_detour(self, edge: int) -> bool:
        obj = int(self.tree.edges[edge].action) - self._containers
        return obj >= 0 and bool((self.detours >> obj) & 1)


def _joint_action(
    model: Model, root: World, choose: _Choice, greedy: GreedyPolicy, unnamed: int
) -> dict[int, Assignment]:
    """Follow the chosen edges through the robots that decide now, and assign greedily where the tree ends.

    This overwrites the root world. The greedy policy decides for a robot only if there are fewer samples than robots.
    """
    assignments: dict[int, Assignment] = {}
    tree, node = choose.tree, 0
    while node != NONE and root.robots.undecided.any() and (edge := choose.edge(node)) != NONE:
        robot = int(tree.nodes[node].robot)
        act(model, root, robot, int(tree.edges[edge].action))
        assignments[robot] = assignment_begun(root, robot, unnamed)
        node = int(tree.edges[edge].first_child)
    if root.robots.undecided.any():
        return assignments | assign_greedily(model, root, greedy, unnamed=unnamed)
    return assignments
