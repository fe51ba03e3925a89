"""One planner of an evaluation, resolved once from the configuration."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mrtask.likelihood.choice import LikelihoodChoice
from mrtask.planning.planners import make_planner
from mrtask.planning.problem import Planner


@dataclass(frozen=True)
class PlannerSpec:
    """A planner, its options, and the likelihoods that it plans with."""

    name: str
    """What its rows call it: its own name, or that of a variant."""
    planner: str
    """A planner of ours, or the import path of your own. Seeds depend on this, not on ``name``."""
    options: Mapping[str, Any] = field(default_factory=dict)
    likelihood: LikelihoodChoice = field(default_factory=LikelihoodChoice)

    def make(self) -> Planner:
        """Return the planner itself; raises `ValueError` where it is unknown or refuses its options."""
        return make_planner(self.planner, self.options)
