"""How an evaluation ends: its results in the terminal, and an error where a planner never succeeded."""

from collections.abc import Collection

import pandas as pd

from mrtask.analysis.report.in_terminal import never_succeeded, result_lines
from pipeline.base import console
from pipeline.base.config import UserError


class NeverSucceeded(UserError):
    """A planner without a single accepted episode."""


def say(episodes: pd.DataFrame) -> None:
    """Print each planner's results over all cells, and what failed and why."""
    console.text("\n".join(result_lines(episodes)))


def check(episodes: pd.DataFrame, planners: Collection[str] | None = None) -> None:
    """Raise `NeverSucceeded` where one of these planners, by default of all, has no accepted episode."""
    rows = episodes if planners is None else episodes[episodes["planner"].isin(planners)]
    if never := never_succeeded(rows):
        listed = ", ".join(f"{name} (of {count})" for name, count in never.items())
        raise NeverSucceeded(
            f"no episode was accepted of {listed}; the rows and their reasons are kept, and "
            "evaluation.rerun=[error,timeout,failed] runs them again once the cause is gone"
        )
