"""The planner `greedy`: the rollout policy by itself, a strong and cheap baseline.

See `mrtask.planning.greedy_kernel`.
"""

from collections.abc import Callable

import numpy as np

from mrtask.planning import greedy_kernel as kernel
from mrtask.planning.compiled import compiled
from mrtask.planning.problem import ANY_SAFE, REASSIGN, Assignment, Plan, PlanningProblem, check_choice
from mrtask.planning.reference import by_reference
from mrtask.planning.shared_kernel import NONE
from mrtask.planning.team_kernel import Model, World
from mrtask.planning.team_model import assignment_begun, root_world, team_model

LATER_WEIGHT = 0.3
"""The weight of finding an object that is needed later, relative to one that advances the task now."""
CACHED_ROWS = 4096


@compiled
def _assign(model: Model, world: World, greedy: kernel.GreedyPolicy) -> None:
    kernel.assign(by_reference(model), by_reference(world), by_reference(greedy))


class Greedy:
    """Repeatedly choose the robot and the action with the least travel time over probability of advancing."""

    knows_contents = False

    def __init__(self, later_weight: float = LATER_WEIGHT, reassign: str = "all") -> None:
        check_later_weight(later_weight)
        check_choice("reassign", reassign, REASSIGN)
        self._later_weight, self._reassign_all = later_weight, reassign == "all"

    def warm_up(self, problem: PlanningProblem) -> None:
        """Compile the kernels by making one plan."""
        self.plan(problem, seed=0)

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """Plan as the class says. The rule draws no random numbers, so ``seed`` has no effect."""
        model = team_model(problem)
        root = root_world(problem, model, self._reassign_all)
        return Plan(assign_greedily(model, root, policy(problem, self._later_weight), _assign))


def check_later_weight(later_weight: float) -> None:
    """Raise ValueError unless the weight is in (0, 1]."""
    if not 0 < later_weight <= 1:
        raise ValueError(f"later_weight must be in (0, 1], not {later_weight}")


def policy(problem: PlanningProblem, later_weight: float) -> kernel.GreedyPolicy:
    """Return the policy's parameter with an empty cache and scratch space."""
    containers, objects = problem.presence_prob.shape
    rows = min(CACHED_ROWS, len(problem.automaton.accepting) << objects)
    return kernel.GreedyPolicy(
        later_weight=later_weight,
        tag=np.full(rows, NONE, dtype=np.int64),
        inverse=np.empty((rows, containers)),
        skip=np.zeros(containers + objects, dtype=np.uint8),
        action=np.empty(len(problem.robots), dtype=np.int64),
        score=np.empty(len(problem.robots)),
    )


def assign_greedily(
    model: Model,
    world: World,
    greedy: kernel.GreedyPolicy,
    assign: Callable[[Model, World, kernel.GreedyPolicy], None] = kernel.assign,
    unnamed: int = ANY_SAFE,
) -> dict[int, Assignment]:
    """Let all undecided robots of a world begin their greedy actions; ``assign`` is the kernel, compiled or not.

    ``unnamed`` is the interaction of actions that name none.
    """
    deciders = np.flatnonzero(world.robots.undecided)
    assign(model, world, greedy)
    return {int(robot): assignment_begun(world, int(robot), unnamed) for robot in deciders}
