"""Which planners the analysis compares with which, by the roles of `mrtask.planning.planners`."""

from collections.abc import Sequence

from mrtask.planning.planners import Role, planner_role, planners_in_order, planners_with_role

BASELINES = planners_with_role(Role.BASELINE)
"""The planners over which a planner's improvement is measured."""
REFERENCES = (*BASELINES, *planners_with_role(Role.REFERENCE))
"""All planners with which others are compared."""
INFORMED_BASELINE, KNOWN = "learned_myopic", "known"
"""The gap of `mrtask.analysis.results.statistics.Summary.gaps` lies between these two planners."""
RULE = "greedy"
"""The strongest planner without search. A planner's improvement over it is the value of search."""
OUR_PLANNER = planners_with_role(Role.OURS)[0]
FALLBACK_ROLES = (Role.REFERENCE, Role.BASELINE, Role.BOUND)
"""A comparison is about a planner of these roles if none of ours ran."""


def main_planner(planners: Sequence[str], wanted: str | None = None) -> str | None:
    """Return the planner that the report is about: ``wanted``, else one of ours, else the best of the rest.

    Among ours, this is the first in the order of planners. Among the references and baselines, it is the last, which is
    the strongest. It is None if no planner ran.
    """
    if wanted in planners:
        return wanted
    ordered = planners_in_order(planners)
    ours = [name for name in ordered if planner_role(name) is Role.OURS]
    rest = [name for role in FALLBACK_ROLES for name in reversed(ordered) if planner_role(name) is role]
    return next(iter([*ours, *rest]), None)
