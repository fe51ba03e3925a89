"""Summarise the episodes: costs, planned and real travel times, and what happened where robots met."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from mrtask.analysis.page.style import planner_label
from mrtask.analysis.results.roles import BASELINES
from mrtask.analysis.results.statistics import Estimate, compare, homes_of, paired_costs
from mrtask.planning.planners import planners_in_order

Row = Mapping[str, Any]


def summary(rows: Sequence[Row]) -> str:
    """Return the summary as text."""
    if not rows:
        return "no episodes"
    episodes = pd.DataFrame(rows)
    return "\n".join(
        [*_costs(episodes), "", *_improvements(episodes), "", *_travel(episodes), "", *_meetings(episodes)]
    )


def _costs(episodes: pd.DataFrame) -> Iterator[str]:
    planners = planners_in_order(episodes["planner"].unique())
    yield f"{len(episodes)} episodes, {episodes['trial_id'].nunique()} trials, {episodes['home_id'].nunique()} homes"
    yield f"{'seconds until the task was done, mean':<40}" + "".join(f"{planner_label(name):>22}" for name in planners)
    for robots, of_team in episodes.groupby("robots"):
        means = of_team.groupby("planner")["cost_s"].mean()
        yield f"{f'  robots: {robots}':<40}" + "".join(f"{means[name]:>22.1f}" for name in planners)
    failed = episodes[episodes["status"] != "accepted"]
    yield f"not done: {len(failed)}"
    for row in failed.to_dict("records"):
        yield f"  {row['trial_id']} {row['planner']}: {row['error']}"


def _improvements(episodes: pd.DataFrame) -> Iterator[str]:
    """Return each planner's improvement over each baseline, on the trials that both finished."""
    planners = planners_in_order(episodes["planner"].unique())
    yield "time saved (95 % interval), on the trials that both finished"
    for name in planners:
        for baseline in planners:
            if name in BASELINES or baseline not in BASELINES:
                continue
            yield f"  {planner_label(name)} over {planner_label(baseline)}"
            teams = [(f"robots: {robots}", of_team) for robots, of_team in episodes.groupby("robots")]
            for label, of_team in [*teams, ("all", episodes)]:
                costs = paired_costs(of_team)
                pair = (costs[name].to_numpy(dtype=float), costs[baseline].to_numpy(dtype=float))
                found = compare(*pair, homes_of(of_team)[costs.index].to_numpy())
                counted = f"{found.wins} faster, {found.ties} equal, {found.losses} slower"
                yield f"    {label:<12}{_percent(found.improvement):>26}   {counted}"


def _percent(estimate: Estimate) -> str:
    interval = f" ({estimate.low:.1f}, {estimate.high:.1f})" if estimate.has_interval else ""
    return f"{estimate.value:.1f} %{interval}"


def _travel(episodes: pd.DataFrame) -> Iterator[str]:
    yield "drives to a container that were not redirected: seconds planned (length over top speed) and real"
    for robots, of_team in episodes.groupby("robots"):
        legs = [leg for listed in of_team["legs"] for leg in listed if leg["planned_s"] > 0]
        planned, real = (np.array([leg[key] for leg in legs], dtype=float) for key in ("planned_s", "real_s"))
        ratio = real / planned
        yield (
            f"  robots: {robots}   {len(legs)} drives, planned {planned.mean():.1f} s, real {real.mean():.1f} s in the "
            f"mean; real / planned {real.sum() / planned.sum():.2f} over all, median {np.median(ratio):.2f}, "
            f"95 % below {np.quantile(ratio, 0.95):.2f}"
        )


def _meetings(episodes: pd.DataFrame) -> Iterator[str]:
    yield "where robots met"
    for robots, of_team in episodes.groupby("robots"):
        gaps = of_team["least_gap_m"].dropna()
        least = f"{gaps.min():.3f} m" if len(gaps) else "-"
        yield (
            f"  robots: {robots}   contacts {of_team['contacts'].sum()}, least gap {least}; "
            f"gave way {of_team['gave_way'].sum()} times, stood for others {of_team['held_s'].mean():.1f} s an "
            f"episode, gave up {of_team['gave_up'].sum()}; steps refused at walls and furniture "
            f"{of_team['brushes'].sum()}; "
            f"events refused {of_team['refused'].map(len).sum()}"
        )
