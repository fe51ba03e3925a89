"""Recorded episodes of our planners on a suite, so that scoring a planner does not have to run the others.

``benchmarks/record_scores.py`` makes them. A test runs some of them again and compares.
"""

import json
from importlib.resources import files
from io import StringIO
from typing import Any

import pandas as pd

from mrtask.suite.frozen import Suite

PLANNERS: dict[str, dict[str, Any]] = {
    "nonlearned_myopic": {},
    "learned_myopic": {},
    "greedy": {},
    "pouct_paper": {"samples": 1000},
    "pouct": {"samples": 1000},
    "known": {"samples": 1000},
}
"""The recorded planners and their options."""


def recorded_episodes(suite: Suite) -> pd.DataFrame:
    """Return the recorded rows of a suite: ``trial_id, planner, status, cost_s, size_class, robots``."""
    text = files("mrtask.suite").joinpath(file_name(suite.name)).read_text(encoding="utf-8")
    costs = pd.read_csv(StringIO(text), comment="#")
    rows = costs.melt("trial_id", var_name="planner", value_name="cost_s")
    rows["status"] = rows["cost_s"].notna().map({True: "accepted", False: "failed"})
    trials = {trial.trial_id: trial for trial in suite.trials}
    return rows.assign(
        size_class=rows["trial_id"].map(lambda name: trials[name].size_class),
        robots=rows["trial_id"].map(lambda name: trials[name].team.robots),
    )


def recorded_text(costs: pd.DataFrame, version: str) -> str:
    """Return the file's content for costs in seconds, trials x planners. Costs keep all their digits."""
    head = f"# recorded with mrtask {version}; options: {json.dumps(PLANNERS)}\n"
    return head + costs[list(PLANNERS)].to_csv(float_format="%.17g", lineterminator="\n")


def file_name(suite: str) -> str:
    """Return the file of a suite's recorded costs."""
    return f"{suite}.costs.csv"
