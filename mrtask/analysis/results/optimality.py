"""How far planners are from optimal: the rows of `mrtask.bounds.assess`, summarised cell by cell."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from mrtask.analysis.results.episodes import size_classes_in_order
from mrtask.analysis.results.statistics import (
    CONFIDENCE,
    MIN_TRIALS_FOR_INTERVAL,
    RESAMPLES,
    SEED,
    UNDEFINED,
    Cell,
    Estimate,
    PairedCosts,
    homes_of,
    number_homes,
)
from mrtask.arrays import Floats, Ints
from mrtask.bounds.lower_bound import BoundKind


@dataclass(frozen=True)
class CellOptimality:
    """How far a planner is from optimal in the trials of one cell."""

    cell: Cell
    planner: str
    cost_s: Estimate
    bound_s: Estimate
    clairvoyant_s: Estimate
    gap_percent: Estimate
    """By how much the mean cost exceeds the mean bound: the planner is at most this far from the optimum."""
    median_gap_percent: Estimate
    """The median of the same figure over trials."""
    exact_share: float
    """The share of trials whose bound is the optimum itself."""
    bound_seconds: float
    """The mean CPU time of a trial's bound."""
    failed: int
    """Unfinished episodes, which enter neither the cost nor the bound."""


def summarise_optimality(rows: pd.DataFrame) -> list[CellOptimality]:
    """Return all cells of the rows that `assess` made, by size class and team size."""
    classes = size_classes_in_order(rows["size_class"].unique())
    groups = rows.groupby(["size_class", "robots", "planner"])
    found = [_summarise_cell((str(key[0]), int(str(key[1]))), str(key[2]), trials) for key, trials in groups]
    return sorted(found, key=lambda one: (classes.index(one.cell[0]), one.cell[1], one.planner))


def _summarise_cell(cell: Cell, planner: str, rows: pd.DataFrame) -> CellOptimality:
    done = rows[rows["cost_s"].notna()]
    homes = homes_of(done)
    costs = PairedCosts(done.set_index("trial_id")[["cost_s", "bound_s", "clairvoyant_s"]], homes)
    return CellOptimality(
        cell=cell,
        planner=planner,
        cost_s=costs.mean("cost_s"),
        bound_s=costs.mean("bound_s"),
        clairvoyant_s=costs.mean("clairvoyant_s"),
        gap_percent=costs.above("cost_s", "bound_s"),
        median_gap_percent=_median(
            100 * (done["cost_s"] / done["bound_s"] - 1).to_numpy(), number_homes(homes.tolist())
        ),
        exact_share=float((rows["kind"] == BoundKind.EXACT.value).mean()),
        bound_seconds=float(rows["bound_seconds"].mean()),
        failed=int(rows["failed"].sum()),
    )


def _median(values: Floats, home_of: Ints) -> Estimate:
    """Return the median of [N] trials with its percentile interval; see `Bootstrap` for what is resampled."""
    n, homes = len(values), int(home_of.max(initial=-1)) + 1
    if n == 0:
        return UNDEFINED
    middle = float(np.median(values))
    groups = [values[home_of == home] for home in range(homes)] if homes > 1 else values[:, None]
    if len(groups) < MIN_TRIALS_FOR_INTERVAL:
        return Estimate(middle, np.nan, np.nan, n, homes)

    def median(drawn: Ints) -> float:
        return float(np.median(np.concatenate([groups[number] for number in drawn])))

    options = {"n_resamples": RESAMPLES, "confidence_level": CONFIDENCE, "method": "percentile", "vectorized": False}
    numbers, rng = np.arange(len(groups)), np.random.default_rng(SEED)
    interval = stats.bootstrap((numbers,), median, rng=rng, **options).confidence_interval
    return Estimate(middle, float(interval.low), float(interval.high), n, homes)
