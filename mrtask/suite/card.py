"""The card of a planner's score: the figures to quote, beside those of our planners on the same trials."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from mrtask.analysis.results.statistics import Estimate, PairedCosts, paired_costs
from mrtask.names import counted
from mrtask.planning.planners import Role, planner_role, planners_in_order

BASELINES = ("nonlearned_myopic", "learned_myopic")
PROFILE_FACTORS = (1.0, 1.1, 1.25, 1.5, 2.0)
"""The factors of a performance profile, which gives the share of trials whose cost is at most this many times the
best."""
SAME_COST = 1 + 1e-9


def render_card(
    planner: str,
    options: Mapping[str, Any],
    episodes: pd.DataFrame,
    recorded: pd.DataFrame,
    suite: str,
    home_of: Mapping[str, str],
) -> str:
    """Return the card as text.

    Args:
        episodes: the planner's rows, `mrtask.suite.score.COLUMNS`.
        recorded: rows of our planners on the same trials. New rows replace those of a planner with the same name.
        home_of: the home of each trial; intervals come from resampling homes.
    """
    together = pd.concat([recorded[recorded["planner"] != planner], episodes], ignore_index=True)
    costs = paired_costs(together)
    homes = pd.Series(home_of)
    profiles = _profiles(costs)
    names = planners_in_order(costs.columns)
    chosen = " ".join(f"{name}={value}" for name, value in options.items()) or "default options"
    lines = [
        f"{planner} ({chosen}) on {suite}: {counted(len(episodes), 'trial')} in "
        + counted(homes[episodes["trial_id"]].nunique(), "home"),
        "",
        f"{'':22} {'finished':>8} {'mean s':>8}  {'% below nonlearned':>20}  {'% below learned':>20}",
    ]
    for name in names:
        finished = costs[name].notna()
        lines.append(
            f"{_marked(name, planner)} {int(finished.sum()):>8} {costs[name].mean():>8.3f}  "
            + "  ".join(f"{_improvement(costs, homes, name, baseline):>20}" for baseline in BASELINES)
        )
    header = " ".join(f"{f'{factor:g}x':>6}" for factor in PROFILE_FACTORS)
    lines += ["", f"{'within, of the best:':22} {header}"]
    lines += [
        f"{_marked(name, planner)} " + " ".join(f"{share:>6.1%}" for share in profiles[name])
        for name in names
        if name in profiles
    ]
    lines += ["", "by class and team: mean s, % below learned_myopic"]
    for (size_class, robots), cell in episodes.groupby(["size_class", "robots"], sort=False):
        part = costs.loc[cell["trial_id"]]
        lines.append(
            f"  {size_class:7} {robots} robots: {part[planner].mean():>8.3f}  "
            f"{_improvement(part, homes, planner, 'learned_myopic')}"
        )
    if (unfinished := int(costs[planner].isna().sum())) > 0:
        note = "trials were not finished: means and improvements leave them out, the profile does not"
        lines += ["", f"{unfinished} {note}"]
    return "\n".join(lines)


def planning_text(episodes: pd.DataFrame) -> str:
    """Return how long planning took. It depends on the machine, so it is not part of the score."""
    decisions = episodes["decisions"].sum()
    mean_ms = 1000 * episodes["planning_s"].sum() / max(decisions, 1)
    worst_ms = 1000 * (episodes["planning_s"] / episodes["decisions"].clip(lower=1)).max()
    return (
        f"planning here: {mean_ms:.2f} ms a decision on average, {worst_ms:.2f} ms in the slowest episode, "
        f"{decisions} decisions"
    )


def _marked(name: str, scored: str) -> str:
    short = name.rsplit(".", 1)[-1]
    return f"{'> ' if name == scored else '  '}{short[:20]:20}"


def _improvement(costs: pd.DataFrame, homes: pd.Series, planner: str, baseline: str) -> str:
    if planner == baseline or baseline not in costs:
        return "-"
    return _text(PairedCosts(costs, homes).improvement(planner, baseline))


def _text(estimate: Estimate) -> str:
    if not estimate.defined:
        return "-"
    interval = f" [{estimate.low:.1f}, {estimate.high:.1f}]" if estimate.has_interval else ""
    return f"{estimate.value:.1f}{interval}"


def _profiles(costs: pd.DataFrame) -> dict[str, list[float]]:
    """Return performance profiles (Dolan and Moré 2002) of all planners that do not know all contents."""
    fair = [name for name in costs.columns if planner_role(name) is not Role.BOUND]
    best = costs[fair].min(axis=1)
    ratios = costs[fair].div(best.where(best > 0), axis=0).where(best > 0, costs[fair].add(1.0))
    ratios = ratios.fillna(np.inf)
    return {name: [float((ratios[name] <= factor * SAME_COST).mean()) for factor in PROFILE_FACTORS] for name in fair}
