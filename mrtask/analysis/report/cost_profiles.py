"""The distribution of costs beyond their means: performance profiles, and the distribution of each cell's costs.

A performance profile (Dolan and Moré, *Benchmarking optimization software with performance profiles*, Mathematical
Programming 91, 2002) takes each planner's cost on a trial relative to the cheapest planner's on that trial, and shows
for every factor in how many trials a planner stays within it. A failed episode never does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mrtask.analysis.page.charts import legend_below, panels, ticks_as
from mrtask.analysis.page.style import house_style, planner_label, planner_looks
from mrtask.analysis.page.tables import Entry, Row, Table
from mrtask.analysis.results.episodes import size_classes_in_order
from mrtask.analysis.results.statistics import Summary, cell_name, paired_costs
from mrtask.arrays import Floats
from mrtask.names import counted
from mrtask.planning.planners import Role, planner_role, planners_in_order

FACTORS = (1.0, 1.1, 1.25, 1.5, 2.0)
"""The table's columns."""
WITHIN = "above the cheapest by no more than"
MAX_FACTOR = 4.0
"""Where the picture ends; 1 to 4 on a logarithmic axis."""
FACTOR_TICKS = (1.0, 1.25, 1.5, 2.0, 3.0, 4.0)
SAME_COST = 1e-9
"""Relative: a planner this close to the cheapest is the cheapest too."""
SHOWN_PERCENTILE = 99
MAX_STEPS = 120
"""A curve with more steps is drawn through as many of its points, evenly spaced."""
PANEL_IN = 3.5
COST_PANEL_HEIGHT_IN = 2.1


@dataclass(frozen=True)
class CostRatios:
    """Each planner's cost relative to the cheapest of the trial."""

    planners: tuple[str, ...]
    ratios: Floats
    """[N, P] at least 1; infinite where the planner did not finish, or the cheapest cost nothing."""
    done: NDArray[np.bool_]
    """[N, P] whether the planner finished."""
    size_classes: Sequence[str]
    """[N]"""

    def within(self, factor: float) -> Floats:
        """[P] the share of trials that each planner finishes within ``factor`` of the cheapest, in percent."""
        return np.asarray(100 * (self.ratios <= factor * (1 + SAME_COST)).mean(axis=0))

    @property
    def finished(self) -> Floats:
        """[P] the share of trials that each planner finishes, in percent."""
        return np.asarray(100 * self.done.mean(axis=0))

    def of_class(self, size_class: str) -> Floats:
        """[n, P] the ratios in one size class."""
        return self.ratios[[name == size_class for name in self.size_classes]]


def cost_ratios(rows: pd.DataFrame) -> CostRatios | None:
    """The ratios over the trials that all planners ran and one finished; None with fewer than two planners.

    Bounds such as `known` take no part: they know more than a planner can, and would be the cheapest everywhere.
    """
    planners = tuple(n for n in planners_in_order(rows["planner"].unique()) if planner_role(n) is not Role.BOUND)
    if len(planners) < 2:
        return None
    taking_part = rows[rows["planner"].isin(planners)]
    runs = taking_part.groupby("trial_id")["planner"].transform("nunique")
    costs = paired_costs(taking_part[runs == len(planners)], "cost_cells").reindex(columns=planners).dropna(how="all")
    if costs.empty:
        return None
    filled = costs.fillna(np.inf).to_numpy()
    best = filled.min(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(filled == best, 1.0, filled / best)
    class_of = rows.drop_duplicates("trial_id").set_index("trial_id")["size_class"]
    return CostRatios(planners, ratios, np.isfinite(filled), tuple(class_of.loc[costs.index]))


def profile_table(ratios: CostRatios | None) -> Table | None:
    """In how many trials each planner is the cheapest, or within some factors of it; None without ratios."""
    if ratios is None:
        return None
    headings = [("", "cheapest") if factor == 1 else (WITHIN, f"{100 * (factor - 1):.0f} %") for factor in FACTORS]
    shares = np.array([*map(ratios.within, FACTORS), ratios.finished]).T
    rows = [
        Row(planner_label(name), tuple(Entry(f"{share:.0f} %") for share in own))
        for name, own in zip(ratios.planners, shares, strict=True)
    ]
    return Table((*headings, ("", "finished")), tuple(rows))


@house_style()
def draw_profile(ratios: CostRatios) -> Figure:
    """The profile of every planner, one panel per size class."""
    classes = size_classes_in_order(ratios.size_classes)
    looks = planner_looks(ratios.planners)
    figure, (line,) = panels(PANEL_IN * max(len(classes), 2), 3.6, columns=len(classes), sharey=True)
    for axes, size_class in zip(line, classes, strict=True):
        of_class = ratios.of_class(size_class)
        for name, own in zip(ratios.planners, of_class.T, strict=True):
            _steps(axes, own, MAX_FACTOR, looks[name][0], start=1.0)
        axes.set(title=f"{size_class}, {counted(len(of_class), 'trial')}", xlabel="cost relative to the cheapest")
        ticks_as(axes.xaxis, "{:g}".format, FACTOR_TICKS, log=True)
        axes.set(xlim=(1, MAX_FACTOR), ylim=(0, 101))
    line[0].set_ylabel("trials (%)")
    _legend(figure, ratios.planners)
    return figure


@house_style()
def draw_costs(rows: pd.DataFrame, summary: Summary) -> Figure | None:
    """The distribution of every planner's costs, one panel per cell; None where nothing was finished."""
    if not rows["cost_cells"].notna().any():
        return None
    lines, columns = len(summary.size_classes), len(summary.robots)
    size_in = PANEL_IN * max(columns, 2), COST_PANEL_HEIGHT_IN * lines + 0.7
    figure, grid = panels(*size_in, lines, columns, sharey=True)
    for line, size_class in zip(grid, summary.size_classes, strict=True):
        for axes, robots in zip(line, summary.robots, strict=True):
            _cost_panel(axes, rows[(rows["size_class"] == size_class) & (rows["robots"] == robots)], summary.planners)
            axes.set_title(cell_name((size_class, robots)))
        line[0].set_ylabel("trials (%)")
    for axes in grid[-1]:
        axes.set_xlabel("cost (grid cells)")
    _legend(figure, summary.planners)
    return figure


def _cost_panel(axes: Axes, rows: pd.DataFrame, planners: Sequence[str]) -> None:
    finished = rows["cost_cells"].dropna()
    if finished.empty:
        missing = "nothing finished" if len(rows) else "not run"
        axes.text(0.5, 0.5, missing, transform=axes.transAxes, ha="center", va="center")
        axes.set_xticks([])
        return
    top = float(np.percentile(finished, SHOWN_PERCENTILE)) or 1.0
    looks = planner_looks(planners)
    for name in planners:
        costs = rows.loc[rows["planner"] == name, "cost_cells"].fillna(np.inf).to_numpy()
        if len(costs):
            _steps(axes, costs, top, looks[name][0], start=0.0)
    axes.set(xlim=(0, top), ylim=(0, 101))


def _steps(axes: Axes, values: Floats, top: float, color: str, start: float) -> None:
    """Draw the share of ``values`` that are at most x, for x from ``start`` to ``top``; infinite values never are."""
    found, counts = np.unique(values[values <= top], return_counts=True)
    shares = 100 * counts.cumsum() / len(values)
    if len(found) > MAX_STEPS:
        kept = np.unique(np.linspace(0, len(found) - 1, MAX_STEPS).round().astype(int))
        found, shares = found[kept], shares[kept]
    if not len(found) or found[0] > start:
        found, shares = np.array([start, *found]), np.array([0.0, *shares])
    axes.step([*found, top], [*shares, shares[-1]], where="post", color=color, linewidth=1.5)


def _legend(figure: Figure, planners: Sequence[str]) -> None:
    looks = planner_looks(planners)
    legend_below(figure, [Line2D([], [], color=looks[name][0], label=planner_label(name)) for name in planners])
