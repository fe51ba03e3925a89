"""What MLflow's lists and descriptions say about an evaluation: numbers by planner and cell, and the headline."""

import math
from collections.abc import Collection, Iterator

import pandas as pd

from mrtask.analysis.page.style import planner_label
from mrtask.analysis.report.answer import find
from mrtask.analysis.results.published import load_published
from mrtask.analysis.results.roles import BASELINES, main_planner
from mrtask.analysis.results.statistics import EVERYTHING, Cell, Estimate, Summary

MOST_PLANNERS = 12
"""Of more planners, which are variants of a few, MLflow lists the numbers of the best only: its pages get slow."""


def metrics_of(summary: Summary, planners: Collection[str]) -> dict[str, float]:
    """Return ``<planner>/<size>_<robots>/<what>``, and ``<planner>/all/<what>`` over everything; undefined ones lack.

    These are the accepted share, the mean cost, the improvements over the baselines, each with its 95 % interval
    (``_low``, ``_high``), and the mean planning time of a decision.
    """
    named = {cell: f"{cell[0]}_{cell[1]}" for cell in summary.cells} | {EVERYTHING: "all"}
    found = {
        f"{planner_label(planner)}/{name}/{what}": value
        for cell, name in named.items()
        for planner in planners
        for what, value in (*_of_cell(summary, cell, planner), *_beside_means(summary, cell, planner))
    }
    return {name: value for name, value in found.items() if math.isfinite(value)}


def most_telling(summary: Summary) -> list[str]:
    """Return the planners to list: all, or of many the main one, the baselines, and those of the least mean cost."""
    if len(summary.planners) <= MOST_PLANNERS:
        return list(summary.planners)
    costs = {planner: summary.planner_cells[EVERYTHING, planner].cost_cells.value for planner in summary.planners}
    best = sorted(summary.planners, key=lambda planner: costs[planner] if math.isfinite(costs[planner]) else math.inf)
    baselines = [planner for planner in BASELINES if planner in summary.planners]
    main = [main_planner(summary.planners) or best[0]]
    return list(dict.fromkeys([*main, *baselines, *best]))[:MOST_PLANNERS]


def table_of(summary: Summary) -> pd.DataFrame:
    """Return the metrics of all planners as a table with the columns planner, cell, metric, value."""
    rows = [(*name.rsplit("/", 2), value) for name, value in metrics_of(summary, summary.planners).items()]
    return pd.DataFrame(rows, columns=["planner", "cell", "metric", "value"])


def _of_cell(summary: Summary, cell: Cell, planner: str) -> Iterator[tuple[str, float]]:
    one = summary.planner_cells.get((cell, planner))
    if one is None:
        return
    yield "accepted", one.accepted / one.episodes
    yield "decision_s", one.decision_s
    yield from _with_interval("cost_cells", one.cost_cells)
    for baseline in BASELINES:
        yield from _with_interval(f"percent_better_than_{baseline}", summary.improvement(cell, planner, baseline))


def _beside_means(summary: Summary, cell: Cell, planner: str) -> Iterator[tuple[str, float]]:
    """Yield, over everything, what a mean hides: the median saving, and the shares of ties and of later trials."""
    for other in BASELINES if cell == EVERYTHING else ():
        pair = summary.comparisons.get((cell, planner, other))
        if pair is not None and pair.improvement.n:
            yield f"median_percent_better_than_{other}", pair.median_percent
            yield f"percent_of_trials_equal_to_{other}", pair.percent_of_pairs(pair.ties)
            yield f"percent_of_trials_later_than_{other}", pair.percent_of_pairs(pair.losses)


def _with_interval(what: str, estimate: Estimate) -> Iterator[tuple[str, float]]:
    yield what, estimate.value
    yield f"{what}_low", estimate.low
    yield f"{what}_high", estimate.high


def headline_of(summary: Summary) -> str:
    """Return in a sentence how much better the main planner is than the baselines, as the report says it."""
    return find(summary, load_published(), main_planner(summary.planners)).headline
