"""How far planners are from optimal, in figures: the rows of `mrtask.bounds.assess`, cell by cell."""

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
    Bootstrap,
    Cell,
    Estimate,
)
from mrtask.arrays import Floats
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
    """By how much the mean cost is above the mean bound: the planner is within so much of optimal."""
    median_gap_percent: Estimate
    """The median over trials of the same."""
    exact_share: float
    """The share of trials whose bound is the optimum itself."""
    bound_seconds: float
    """Mean CPU time to compute a trial's bound."""
    failed: int
    """Episodes that were not finished; they count neither for the cost nor for the bound."""


def summarise_optimality(rows: pd.DataFrame) -> list[CellOptimality]:
    """All cells of the rows that `assess` made, by size class and team size."""
    summary = []
    for size_class in size_classes_in_order(rows["size_class"].unique()):
        for robots in sorted(map(int, rows["robots"].unique())):
            own = rows[(rows["size_class"] == size_class) & (rows["robots"] == robots)]
            for planner, trials in own.groupby("planner", sort=True):
                summary.append(_summarise_cell((size_class, robots), str(planner), trials))
    return summary


def _summarise_cell(cell: Cell, planner: str, rows: pd.DataFrame) -> CellOptimality:
    finished = rows[rows["cost_s"].notna()]
    values = finished[["cost_s", "bound_s", "clairvoyant_s"]].to_numpy(dtype=np.float64)
    draws = Bootstrap(values)
    return CellOptimality(
        cell=cell,
        planner=planner,
        cost_s=draws.estimate(lambda means: means[..., 0], [0]),
        bound_s=draws.estimate(lambda means: means[..., 0], [1]),
        clairvoyant_s=draws.estimate(lambda means: means[..., 0], [2]),
        gap_percent=draws.estimate(_above_percent, [0, 1]),
        median_gap_percent=_median(_above_percent(values[:, :2])),
        exact_share=float((rows["kind"] == BoundKind.EXACT.value).mean()),
        bound_seconds=float(rows["bound_seconds"].mean()),
        failed=int(rows["failed"].sum()),
    )


def _above_percent(means: Floats) -> Floats:
    """By how much a cost is above a bound, from [..., 2]."""
    return np.asarray(100 * (means[..., 0] / means[..., 1] - 1))


def _median(values: Floats) -> Estimate:
    """The median of [N] trials with its percentile interval."""
    n = len(values)
    if n == 0:
        return Estimate(np.nan, np.nan, np.nan, 0)
    middle = float(np.median(values))
    if n < MIN_TRIALS_FOR_INTERVAL:
        return Estimate(middle, np.nan, np.nan, n)
    drawn = stats.bootstrap(
        (values,),
        np.median,
        n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(SEED),
    )
    return Estimate(middle, float(drawn.confidence_interval.low), float(drawn.confidence_interval.high), n)
