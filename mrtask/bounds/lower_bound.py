"""Compute the lower bound of a decision problem, and the clairvoyant bound beside it.

The size of the team decides the method.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from time import process_time

import numpy as np

from mrtask.arrays import Bools, Floats
from mrtask.bounds.one_robot import SearchMade, one_robot_bound
from mrtask.bounds.team_bound import team_bound
from mrtask.planning.clairvoyant import clairvoyant_s
from mrtask.planning.problem import PlanningProblem
from mrtask.planning.solver_belief import belief_of, draw_worlds

PILOT_WORLDS = 30
"""The number of worlds on which the bound for a team chooses among its curves."""


class BoundKind(StrEnum):
    """The method that gave a bound."""

    EXACT = "exact"
    """One robot: the mean is the optimum itself, up to the sampling of worlds."""
    PENALISED = "penalised"
    """One robot: information relaxation with penalties."""
    TEAM = "team"
    """Several robots: a limit on what a team can search in a given time."""


@dataclass(frozen=True, eq=False)
class LowerBound:
    """Values for K worlds drawn from the belief, whose expectations bound every planner's expected makespan."""

    values_s: Floats
    """[K] values of the tighter bound."""
    clairvoyant_s: Floats
    """[K] makespans of a team that knows the world."""
    kind: BoundKind
    seconds: float
    """The CPU time of the computation."""


def lower_bound(
    problem: PlanningProblem,
    worlds: Bools,
    rng: np.random.Generator,
    runs: Sequence[Sequence[SearchMade]] | None = None,
) -> LowerBound:
    """Return the bound in ``worlds`` [K, C, O], which `draw_worlds` must have drawn from the problem's own belief.

    Args:
        rng: draws further worlds, which only the bound uses.
        runs: in each world, the searches of a planner with which the bound will be compared. For one robot, the bound's
        values then vary with the planner's costs, at the same mean.

    Raises:
        ValueError: a robot is busy.
    """
    began_s = process_time()
    belief = belief_of(problem)
    clairvoyant = np.array([clairvoyant_s(belief, world) for world in worlds])
    if belief.robots == 1:
        bound = one_robot_bound(belief, worlds, runs)
        values_s, kind = bound.values_s, BoundKind.EXACT if bound.exact else BoundKind.PENALISED
    else:
        values_s, kind = team_bound(belief, worlds, draw_worlds(belief, PILOT_WORLDS, rng)), BoundKind.TEAM
    return LowerBound(values_s, clairvoyant, kind, process_time() - began_s)
