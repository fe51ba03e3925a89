"""What a planner is: the one seam between planners and all that runs them.

Names and options of planners are checked before any work, and this room is all that it takes: it imports no numpy.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from mrtask.planning.problem import Plan, PlanningProblem


@runtime_checkable
class Planner(Protocol):
    """Decide which robot goes where next."""

    knows_contents: bool
    """Whether the planner sees the true contents from the start, as a reference that shows the cost of uncertainty."""

    def warm_up(self, problem: "PlanningProblem") -> None:
        """Do in advance what would slow down the first plan, such as compiling kernels."""
        ...

    def plan(self, problem: "PlanningProblem", seed: int) -> "Plan":
        """Assign all free robots and, where the problem allows it, any robot under way.

        Equal input must give an equal plan.
        """
        ...


class Plans(Protocol):
    """The least that a planner must have."""

    def plan(self, problem: "PlanningProblem", seed: int) -> "Plan":
        """Return the team's assignments."""
        ...


class PlanOnly:
    """A user's own planner that has only a `plan` method, wrapped as a `Planner`."""

    knows_contents = False

    def __init__(self, plan: "Callable[[PlanningProblem, int], Plan]") -> None:
        self.plan = plan

    def warm_up(self, problem: "PlanningProblem") -> None:
        """Do nothing: nobody knows what this planner may compile."""
