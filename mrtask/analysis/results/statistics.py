"""Statistics of the episodes with their uncertainty: mean costs, paired improvements, shares of a gap closed.

Planners ran the same trials, so everything is resampled together for all planners (paired bootstrap; Efron and
Tibshirani, *An Introduction to the Bootstrap*, ch. 14: bias-corrected and accelerated intervals). Trials in one home
resemble each other, so homes are resampled, each with all of its trials (a cluster bootstrap; Davison and Hinkley,
*Bootstrap Methods and their Application*, sec. 3.8); where no home repeats, this resamples trials. Every statistic here
is a function of the planners' mean costs. This makes the resampling a matrix product and the acceleration's jackknife a
closed form, so that 100,000 episodes take seconds.
"""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from scipy import stats
from scipy.special import ndtr, ndtri

from mrtask.analysis.results.episodes import STATUSES, size_classes_in_order
from mrtask.analysis.results.roles import INFORMED_BASELINE, KNOWN, REFERENCES
from mrtask.arrays import Bools, Floats, Ints
from mrtask.names import counted
from mrtask.planning.planners import planners_in_order

RESAMPLES = 5000
CONFIDENCE = 0.95
SIGNIFICANT_P = 0.05
SEED = 20603
"""The seed of the resampling. Every estimate starts from it, so none depends on which others are computed."""
MIN_TRIALS_FOR_INTERVAL = 10
"""Fewer trials, or homes where they repeat, say too little about their spread; the interval would be far too narrow."""
MAX_BATCH_CELLS = 4_000_000
MAX_EXACT_TRIALS = 13
"""Up to this many trials, the test enumerates the signs of all differences; beyond that, it is SciPy's."""
SAME_COST_S = 1e-6
SAME_VALUE = 1e-10
"""The relative and absolute tolerance: resamples of the same trials in another order differ by rounding."""

IN_CELLS = "in grid cells: "
"""The prefix of a planner's name for its costs in grid cells, which stand beside those in seconds."""

Cell = tuple[str, int]
"""``(size class, robots)``"""
ALL_CLASSES, ALL_TEAMS = "all", 0
"""These stand in for a size class and a team size if results are pooled over them."""
EVERYTHING: Cell = (ALL_CLASSES, ALL_TEAMS)


@dataclass(frozen=True)
class Estimate:
    """A value from ``n`` trials in ``homes`` homes with its 95 % interval, or NaN if it is not defined.

    It has no interval below `MIN_TRIALS_FOR_INTERVAL` trials, or below as many homes where there are several. In a
    single home, the interval is about that home's trials and says nothing of other homes.
    """

    value: float
    low: float
    high: float
    n: int
    homes: int = 0
    """The homes of the trials; a trial whose home is not known counts as one of its own. 0 where none were counted."""

    @property
    def defined(self) -> bool:
        """Return whether the estimate has a value."""
        return bool(np.isfinite(self.value))

    @property
    def has_interval(self) -> bool:
        """Return whether the estimate has an interval too."""
        return bool(np.isfinite(self.low))


UNDEFINED = Estimate(np.nan, np.nan, np.nan, 0)
"""The estimate from zero trials."""


@dataclass(frozen=True)
class ByHome:
    """How often a planner is sooner than another, where homes repeat."""

    share_sooner: Estimate
    """The share of the trials that one of the two won that it won, in percent; homes are resampled."""
    won: int
    """The number of homes in which it was sooner more often than later."""
    lost: int
    """The number of homes in which it was later more often than sooner."""


@dataclass(frozen=True)
class Comparison:
    """A planner against a baseline on the trials that both finished."""

    improvement: Estimate
    """``1 - mean(planner) / mean(baseline)``, in percent: positive is better."""
    median_percent: float
    """The median over the trials of what each saves of the baseline's cost, in percent; NaN without pairs."""
    wins: int
    ties: int
    losses: int
    p_value: float
    """The p-value of Wilcoxon's signed-rank test that the paired costs differ; NaN below two pairs.

    Where homes repeat, a pair is a home, with its mean costs. Equal pairs take part: their ranks are split evenly
    between both signs (SciPy's ``zsplit``).
    """
    p_value_without_ties: float
    """The p-value of the usual form of the test, which leaves equal pairs out; 1 where all are equal."""
    only_planner: int
    only_baseline: int
    """The number of trials that only this one of the two finished; they are outside the comparison."""
    by_home: ByHome | None = None
    """None where no home repeats."""

    def percent_of_pairs(self, count: int) -> float:
        """Return a number of trials in percent of those that both finished."""
        return 100 * count / self.improvement.n

    @property
    def ties_decide(self) -> bool:
        """Whether only one of the two treatments of equal pairs calls the difference significant."""
        return (self.p_value < SIGNIFICANT_P) != (self.p_value_without_ties < SIGNIFICANT_P)


@dataclass(frozen=True)
class PlannerCell:
    """One planner in one cell."""

    counts: dict[str, int]
    """The number of episodes by status."""
    cost_cells: Estimate
    cost_s: float
    decision_s: float
    """The mean planning time per decision; NaN if it was not recorded."""

    @property
    def episodes(self) -> int:
        """Return the number of rows, whatever their status."""
        return sum(self.counts.values())

    @property
    def accepted(self) -> int:
        """Return the number of rows that enter the means."""
        return self.counts["accepted"]


@dataclass(frozen=True)
class Summary:
    """Everything that tables and figures show of one variant. Cells with `ALL_TEAMS` robots pool all team sizes."""

    planners: tuple[str, ...]
    size_classes: tuple[str, ...]
    robots: tuple[int, ...]
    planner_cells: dict[tuple[Cell, str], PlannerCell]
    comparisons: dict[tuple[Cell, str, str], Comparison]
    """The comparisons by ``(cell, planner, baseline)``."""
    gaps: dict[tuple[Cell, str], Estimate]
    """The share of the way from `learned_myopic`'s mean to `known`'s that a planner covers, in percent."""

    @property
    def cells(self) -> list[Cell]:
        """Return the cells of one size class and one team size that have episodes, in the table's order."""
        present = {cell for cell, _ in self.planner_cells}
        return [(c, r) for c in self.size_classes for r in self.robots if (c, r) in present]

    def compared(self, planner: str, baseline: str) -> bool:
        """Return whether both planners ran in some cell."""
        return any(key[1:] == (planner, baseline) for key in self.comparisons)

    def cost(self, cell: Cell, planner: str) -> Estimate:
        """Return the mean cost in grid cells, or `UNDEFINED` if the planner did not run."""
        found = self.planner_cells.get((cell, planner))
        return found.cost_cells if found else UNDEFINED

    def improvement(self, cell: Cell, planner: str, baseline: str) -> Estimate:
        """Return the improvement over the baseline in percent, or `UNDEFINED` if the two are not compared."""
        found = self.comparisons.get((cell, planner, baseline))
        return found.improvement if found else UNDEFINED

    def gap(self, cell: Cell, planner: str) -> Estimate:
        """Return the share of the gap that the planner closes, in percent, or `UNDEFINED` without a gap."""
        return self.gaps.get((cell, planner), UNDEFINED)


def cell_name(cell: Cell) -> str:
    """Return a name such as ``medium, 2 robots``, or the size class alone if the cell pools all teams."""
    size_class, robots = cell
    return size_class if robots == ALL_TEAMS else f"{size_class}, {counted(robots, 'robot')}"


class Bootstrap:
    """Paired resamples of ``costs`` [N, P]: N trials, P planners, all finite.

    The same draw serves every statistic of the same trials. What is drawn are groups of trials: the homes, or single
    trials where all are in one home.

    Args:
        homes: [N] the home of each trial. With None, every trial has its own.
    """

    def __init__(
        self, costs: Floats, homes: Iterable[Hashable] | None = None, resamples: int = RESAMPLES, seed: int = SEED
    ) -> None:
        self.costs, self.resamples, self.seed = costs, resamples, seed
        home_of = number_homes(range(len(costs)) if homes is None else homes)
        self.homes = int(home_of.max(initial=-1)) + 1
        group_of = home_of if self.homes > 1 else np.arange(len(costs))
        self._sizes = np.bincount(group_of).astype(np.float64)
        """[G] the trials of each group."""
        self._sums = np.zeros((len(self._sizes), costs.shape[1]))
        """[G, P] each group's summed costs."""
        np.add.at(self._sums, group_of, costs)

    @cached_property
    def _resampled_means(self) -> Floats:
        """Return the mean costs [B, P] of the resamples."""
        n, rng = len(self._sizes), np.random.default_rng(self.seed)
        means = np.empty((self.resamples, self.costs.shape[1]))
        batch = max(1, MAX_BATCH_CELLS // n)
        for first in range(0, self.resamples, batch):
            rows = min(batch, self.resamples - first)
            drawn = rng.integers(n, size=(rows, n)) + n * np.arange(rows)[:, None]
            times = np.bincount(drawn.ravel(), minlength=rows * n).reshape(rows, n).astype(np.float64)
            means[first : first + rows] = times @ self._sums / (times @ self._sizes)[:, None]
        return means

    def resampled(self, statistic: Callable[[Floats], Floats], columns: Sequence[int]) -> Floats:
        """Return the statistic [B] of each resample; ``columns`` is as in `estimate`."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return statistic(self._resampled_means[:, list(columns)])

    def estimate(self, statistic: Callable[[Floats], Floats], columns: Sequence[int] | None = None) -> Estimate:
        """Return the statistic with its BCa interval.

        Args:
            statistic: a function from means [..., K] to values [...].
            columns: the K planners whose means it takes; all by default.
        """
        n, taken = len(self.costs), slice(None) if columns is None else list(columns)
        nothing = Estimate(np.nan, np.nan, np.nan, n, self.homes)
        if n == 0:
            return nothing
        means = self.costs[:, taken].mean(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            value = float(statistic(means))
            if not np.isfinite(value):
                return nothing
            if len(self._sizes) < MIN_TRIALS_FOR_INTERVAL:
                return Estimate(value, np.nan, np.nan, n, self.homes)
            resampled = statistic(self._resampled_means[:, taken])
            left_out = statistic((n * means - self._sums[:, taken]) / (n - self._sizes)[:, None])
        if not np.isfinite(resampled).all():
            return Estimate(value, np.nan, np.nan, n, self.homes)
        low, high = np.quantile(resampled, _bca_levels(value, resampled, left_out))
        return Estimate(value, float(low), float(high), n, self.homes)


def number_homes(homes: Iterable[Hashable]) -> Ints:
    """Return [N] the number of each trial's home, in the order in which they first appear."""
    return np.asarray(pd.factorize(np.asarray(list(homes), dtype=object))[0], dtype=np.int64)


class PairedCosts:
    """The costs of trials (rows) by planner (columns), NaN if a trial was not finished.

    Each estimate uses the trials that all of its planners finished.

    Args:
        homes: the home of each trial, from `homes_of`; of these trials or of more.
    """

    def __init__(self, costs: pd.DataFrame, homes: pd.Series, seed: int = SEED) -> None:
        self.costs, self.homes, self.seed = costs, homes.loc[costs.index], seed
        self._draws: dict[bytes, Bootstrap] = {}

    def estimate(self, statistic: Callable[[Floats], Floats], planners: Sequence[object]) -> Estimate:
        """Return a statistic of these planners' means. One draw of trials serves all statistics that share them."""
        columns: list[object] = list(self.costs.columns)
        places = [columns.index(name) for name in planners]
        costs = self.costs.to_numpy(dtype=np.float64)
        finished = np.isfinite(costs[:, places]).all(axis=1)
        if (key := finished.tobytes()) not in self._draws:
            homes = self.homes.to_numpy()[finished]
            self._draws[key] = Bootstrap(np.nan_to_num(costs[finished]), homes, seed=self.seed)
        return self._draws[key].estimate(statistic, places)

    def mean(self, planner: object) -> Estimate:
        """Return the mean cost."""
        return self.estimate(lambda means: means[..., 0], [planner])

    def improvement(self, planner: object, baseline: object) -> Estimate:
        """Return what ``planner`` saves of the baseline's mean cost, in percent."""
        return self.estimate(improvement_of_means, [planner, baseline])

    def above(self, planner: object, reference: object) -> Estimate:
        """Return by how much a mean cost exceeds the reference's, in percent."""
        return self.estimate(lambda means: np.asarray(100 * (means[..., 0] / means[..., 1] - 1)), [planner, reference])


def _bca_levels(value: float, resampled: Floats, left_out: Floats) -> Floats:
    """Return the quantiles of the resamples that bound the interval, or the plain ones if BCa's are undefined."""
    plain = np.array([(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    tied = np.isclose(resampled, value, rtol=SAME_VALUE, atol=SAME_VALUE)
    bias = ndtri(np.mean((resampled < value) & ~tied) + np.mean(tied) / 2)
    deviation = left_out.mean() - left_out
    spread = float((deviation**2).sum())
    if not (np.isfinite(bias) and np.isfinite(spread) and spread > 0):
        return plain
    acceleration = float((deviation**3).sum()) / (6 * spread**1.5)
    z = bias + ndtri(plain)
    return np.asarray(ndtr(bias + z / (1 - acceleration * z)), dtype=np.float64)


def improvement_percent(cost: Floats, baseline: Floats, homes: Iterable[Hashable] | None = None) -> Estimate:
    """Return ``1 - mean(cost) / mean(baseline)`` of paired costs [N] in homes [N], in percent.

    It is undefined if the baseline's mean is 0.
    """
    return Bootstrap(np.column_stack([cost, baseline]), homes).estimate(improvement_of_means)


def improvement_of_means(means: Floats) -> Floats:
    """Return the improvement in percent from means [..., 2] of planner and baseline."""
    return np.asarray(100 * (1 - means[..., 0] / means[..., 1]))


def _gap_closed(means: Floats) -> Floats:
    """Return the share of the gap from means of planner, informed baseline and known.

    It is NaN if knowing everything saves nothing.
    """
    gap = means[..., 1] - means[..., 2]
    return np.asarray(np.where(gap > 0, 100 * (means[..., 1] - means[..., 0]) / gap, np.nan))


def compare(
    cost: Floats, baseline: Floats, homes: Iterable[Hashable] | None = None, improvement: Estimate | None = None
) -> Comparison:
    """Compare paired costs [N] in homes [N]; NaN marks a trial that was not finished.

    Args:
        homes: the home of each trial. With None, every trial has its own.
        improvement: the estimate on the trials that both finished, if the caller has it already.
    """
    done, base_done = np.isfinite(cost), np.isfinite(baseline)
    both = done & base_done
    home_of = number_homes(np.asarray(range(len(cost)) if homes is None else list(homes), dtype=object)[both])
    saved = baseline[both] - cost[both]
    sooner, later = saved > SAME_COST_S, saved < -SAME_COST_S
    repeated = 1 < home_of.max(initial=-1) + 1 < len(home_of)
    tested = np.bincount(home_of, saved) / np.bincount(home_of) if repeated else saved
    return Comparison(
        improvement=improvement or improvement_percent(cost[both], baseline[both], home_of),
        median_percent=_median_percent(saved, baseline[both]),
        wins=int(sooner.sum()),
        ties=int((~sooner & ~later).sum()),
        losses=int(later.sum()),
        p_value=_wilcoxon(tested),
        p_value_without_ties=_wilcoxon(tested, ties=False),
        only_planner=int((done & ~base_done).sum()),
        only_baseline=int((base_done & ~done).sum()),
        by_home=_by_home(sooner, later, home_of) if repeated else None,
    )


def _by_home(sooner: Bools, later: Bools, home_of: Ints) -> ByHome:
    balance = np.bincount(home_of, sooner.astype(np.float64) - later)
    decided = sooner | later
    share = Bootstrap(np.column_stack([sooner, decided])[decided].astype(np.float64), home_of[decided])
    return ByHome(
        share_sooner=share.estimate(lambda means: np.asarray(100 * means[..., 0] / means[..., 1])),
        won=int((balance > 0).sum()),
        lost=int((balance < 0).sum()),
    )


def _median_percent(saved: Floats, baseline: Floats) -> float:
    """Return the median of ``saved / baseline`` in percent; where both cost nothing, nothing is saved."""
    if not len(saved):
        return float("nan")
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.median(np.where(np.abs(saved) <= SAME_COST_S, 0.0, 100 * saved / baseline)))


def _wilcoxon(saved: Floats, ties: bool = True) -> float:
    """The p value; ``ties``: equal pairs take part, with their ranks split between both signs."""
    if len(saved) < 2:
        return float("nan")
    saved = np.where(np.abs(saved) <= SAME_COST_S, 0.0, saved)
    if not saved.any():
        return 1.0
    if not ties:
        saved = saved[saved != 0]
    if len(saved) <= MAX_EXACT_TRIALS:
        return _exact_wilcoxon(saved)
    return float(stats.wilcoxon(saved, zero_method="zsplit").pvalue)


def _exact_wilcoxon(saved: Floats) -> float:
    """Try all signs that the differences could have had, as SciPy does, but a thousand times faster."""
    ranks = stats.rankdata(np.abs(saved))[saved != 0]
    signs = (np.arange(2 ** len(ranks))[:, None] >> np.arange(len(ranks))) & 1
    sums, found = signs @ ranks, ranks[saved[saved != 0] > 0].sum()
    return float(min(1.0, 2 * min(np.mean(sums >= found), np.mean(sums <= found))))


def summarise(episodes: pd.DataFrame) -> Summary:
    """Return all statistics of one variant's checked episodes: by cell, by size class over all teams, and over all."""
    classes = size_classes_in_order(episodes["size_class"].unique())
    teams = sorted(map(int, episodes["robots"].unique()))
    parts: dict[Cell, pd.DataFrame] = {}
    for size_class in classes:
        of_class = episodes[episodes["size_class"] == size_class]
        parts |= {(size_class, robots): of_class[of_class["robots"] == robots] for robots in teams}
        parts[size_class, ALL_TEAMS] = of_class
    return summarise_parts(episodes, classes, teams, parts | {EVERYTHING: episodes})


def summarise_parts(
    episodes: pd.DataFrame, classes: Sequence[str], teams: Sequence[int], parts: Mapping[Cell, pd.DataFrame]
) -> Summary:
    """Return the statistics of each of ``parts`` of the episodes by itself."""
    summary = Summary(planners_in_order(episodes["planner"].unique()), tuple(classes), tuple(teams), {}, {}, {})
    for cell, rows in parts.items():
        _summarise_cell(summary, cell, rows)
    return summary


def paired_costs(episodes: pd.DataFrame, column: str = "cost_s") -> pd.DataFrame:
    """Return trials x planners, with NaN if a planner did not finish the trial or never ran it."""
    return episodes.pivot(index="trial_id", columns="planner", values=column)


def homes_of(episodes: pd.DataFrame) -> pd.Series:
    """Return each trial's home, by trial; a trial whose home is not recorded has one of its own."""
    trials = episodes.drop_duplicates("trial_id").set_index("trial_id")
    alone = pd.Series([f"of {trial}" for trial in trials.index], index=trials.index, dtype=object)
    return trials["home_id"].astype(object).fillna(alone) if "home_id" in trials.columns else alone


def home_repeats(homes: pd.Series) -> bool:
    """Return whether these trials' homes are resampled as groups; not where all are different, or all the same."""
    return 1 < homes.nunique() < len(homes)


def decision_s(rows: pd.DataFrame) -> dict[str, float]:
    """Return each planner's mean planning time per decision, for planners for which it was recorded."""
    if not {"planning_s", "decisions"} <= set(rows.columns):
        return {}
    known = rows[["planner", "planning_s", "decisions"]].dropna().groupby("planner").sum()
    return {str(name): float(value) for name, value in (known["planning_s"] / known["decisions"]).items()}


def _summarise_cell(summary: Summary, cell: Cell, rows: pd.DataFrame) -> None:
    seconds = paired_costs(rows)
    planners = [name for name in summary.planners if name in seconds.columns]
    # Costs in grid cells stand beside those in seconds, so that one draw of trials serves both.
    both_units = pd.concat([seconds, paired_costs(rows, "cost_cells").add_prefix(IN_CELLS)], axis=1)
    costs = PairedCosts(both_units, homes_of(rows))
    counts = rows.groupby(["planner", "status"]).size().to_dict()
    mean_s, each_decision_s = seconds.mean().to_dict(), decision_s(rows)
    for name in planners:
        summary.planner_cells[cell, name] = PlannerCell(
            counts={status: counts.get((name, status), 0) for status in STATUSES},
            cost_cells=costs.mean(IN_CELLS + name),
            cost_s=mean_s[name],
            decision_s=each_decision_s.get(name, float("nan")),
        )
        for other in REFERENCES:
            if other in planners and other != name:
                pair = (seconds[name].to_numpy(), seconds[other].to_numpy(), costs.homes.to_numpy())
                summary.comparisons[cell, name, other] = compare(*pair, costs.improvement(name, other))
        if {INFORMED_BASELINE, KNOWN} <= set(planners) - {name}:
            summary.gaps[cell, name] = costs.estimate(_gap_closed, [name, INFORMED_BASELINE, KNOWN])
