"""Which planners are compared with which: the roles of `mrtask.planning.planners`, as the analysis uses them."""

from collections.abc import Sequence

from mrtask.planning.planners import Role, planner_role, planners_in_order, planners_with_role

BASELINES = planners_with_role(Role.BASELINE)
"""A planner's improvement is measured against these."""
REFERENCES = (*BASELINES, *planners_with_role(Role.REFERENCE))
"""All planners that others are compared with."""
INFORMED_BASELINE, KNOWN = "learned_myopic", "known"
"""The gap of `mrtask.analysis.results.statistics.Summary.gaps` lies between these two."""
RULE = "greedy"
"""The strongest planner without search: a planner's improvement over it is what search is worth."""
OUR_PLANNER = planners_with_role(Role.OURS)[0]
FALLBACK_ROLES = (Role.REFERENCE, Role.BASELINE, Role.BOUND)
"""A comparison is about a planner of these roles where none of ours ran."""


def main_planner(planners: Sequence[str], wanted: str | None = None) -> str | None:
    """The planner that the report is about: ``wanted``, else one of ours, else the best of the rest.

    Of ours, this is the first in the order of planners; of the references and baselines the last, which is the
    strongest. None where no planner ran.
    """
    if wanted in planners:
        return wanted
    ordered = planners_in_order(planners)
    ours = [name for name in ordered if planner_role(name) is Role.OURS]
    rest = [name for role in FALLBACK_ROLES for name in reversed(ordered) if planner_role(name) is role]
    return next(iter([*ours, *rest]), None)
