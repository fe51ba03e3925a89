"""The table of episodes for the analysis: checked, typed, and split by variant if a sweep made several.

One row is one planner's run of one trial. Planners are compared on the trials (``trial_id``) that they share.
"""

import re
from collections.abc import Iterable

import numpy as np
import pandas as pd

from mrtask.execution.team_spec import ALIKE
from mrtask.homes.home import ALL_SIZE_CLASSES

REQUIRED_COLUMNS = ("trial_id", "size_class", "robots", "planner", "status", "cost_s", "cost_cells")
BUDGET = "sample_budget"
"""Optional column: the samples per decision that a planner may draw; NaN for a planner that draws none."""
STATUSES = ("accepted", "failed", "error", "timeout")
"""``failed``: the task could not be done; ``error``: an exception; ``timeout``: the episode took too long."""

OVERRIDES_IN_COLUMNS = ("evaluation.robots", "evaluation.size_classes", "evaluation.planners")
"""Sweeps over these make no variants, because each row has its team size, size class and planner in columns."""

Variant = str
"""The overrides of a sweep's cell (``planner.pouct.samples=100``); empty without a sweep."""


def checked_episodes(episodes: pd.DataFrame) -> pd.DataFrame:
    """Return a checked copy in key order, with float costs (NaN unless accepted) and a ``variant`` column.

    Raises:
        ValueError: a column is missing, a status or team size is unknown, an accepted row has no cost, or a planner's
            trial occurs twice.
    """
    missing = [column for column in REQUIRED_COLUMNS if column not in episodes.columns]
    if missing:
        raise ValueError(
            f"the episodes lack the columns {', '.join(missing)}; needed are {', '.join(REQUIRED_COLUMNS)}: "
            "give the table that `python -m pipeline.evaluate` writes"
        )
    frame = episodes.reset_index(drop=True).copy()
    for column in ("trial_id", "size_class", "planner", "status"):
        frame[column] = frame[column].astype(str)
    unknown = sorted(set(frame["status"]) - set(STATUSES))
    if unknown:
        raise ValueError(f"unknown episode status {', '.join(map(repr, unknown))}; allowed are {', '.join(STATUSES)}")
    frame["robots"] = pd.to_numeric(frame["robots"]).astype("int64")
    if (frame["robots"] < 1).any():
        raise ValueError(f"an episode has {frame['robots'].min()} robots; a team has at least one")
    accepted = frame["status"] == "accepted"
    unlike = frame["team"].fillna(ALIKE) != ALIKE if "team" in frame.columns else pd.Series(False, index=frame.index)
    for column in ("cost_s", "cost_cells"):
        cost = pd.to_numeric(frame[column]).astype("float64")
        bad = accepted & ~(np.isfinite(cost) & (cost >= 0))
        if column == "cost_cells":
            bad &= ~(unlike & cost.isna())
        if bad.any():
            row = frame[bad].iloc[0]
            raise ValueError(
                f"the accepted episode {row['trial_id']} of {row['planner']} has {column} {cost[bad].iloc[0]}; "
                "an accepted episode's cost is a number >= 0"
            )
        frame[column] = cost.where(accepted)
    for column in ("decisions", "planning_s", "samples"):
        if column in frame.columns:
            frame[column] = pd.to_numeric(frame[column]).astype("float64")
    frame["variant"] = _variants(frame)
    twice = frame.duplicated(["variant", "trial_id", "planner"])
    if twice.any():
        row = frame[twice].iloc[0]
        raise ValueError(
            f"{int(twice.sum())} episodes occur twice, the first is {row['trial_id']} of {row['planner']}; "
            "give one row per trial and planner, and a `sweep` column where a sweep ran them several times"
        )
    return frame.sort_values(["variant", "trial_id", "planner"], ignore_index=True)


def without_cells(episodes: pd.DataFrame) -> bool:
    """Return whether finished episodes have no cost in grid cells, because the robots of their team differ in speed."""
    return bool(((episodes["status"] == "accepted") & episodes["cost_cells"].isna()).any())


def variants_in_order(episodes: pd.DataFrame) -> list[Variant]:
    """Return the variants of a checked table, with numbers in them sorted as numbers."""
    return sorted(set(episodes["variant"]), key=natural_key)


def size_classes_in_order(names: Iterable[str]) -> list[str]:
    """Return the size classes from small to large, then any others by name."""
    present = set(names)
    return [name for name in ALL_SIZE_CLASSES if name in present] + sorted(present - set(ALL_SIZE_CLASSES))


def natural_key(text: str) -> list[tuple[int, float, str]]:
    """Return a sort key under which ``samples=200`` comes before ``samples=1000``."""
    parts = re.split(r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?)", text)
    return [(1, float(part), "") if index % 2 else (0, 0.0, part) for index, part in enumerate(parts)]


def _variants(frame: pd.DataFrame) -> pd.Series:
    if "sweep" not in frame.columns:
        return pd.Series("", index=frame.index, dtype="str")
    sweep = frame["sweep"].fillna("").astype(str)
    shortened = sweep.map({label: _without_columns(label) for label in sweep.unique()}).astype("str")
    keys = pd.DataFrame({"variant": shortened, "trial_id": frame["trial_id"], "planner": frame["planner"]})
    return sweep if keys.duplicated().any() else shortened


def _without_columns(label: str) -> str:
    overrides = re.split(r",(?![^\[{(]*[\]})])", label)
    return ",".join(part for part in overrides if part.split("=")[0].lstrip("+") not in OVERRIDES_IN_COLUMNS)
