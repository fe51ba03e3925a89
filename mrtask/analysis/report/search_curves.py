"""What search is worth: cost against the number of samples (the anytime curve), and cost and time against team size.

Everything in a panel is over the same trials, those that all of its planners finished, all size classes together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

from mrtask.analysis.page.style import BLACK, GREY, house_style, new_figure, planner_label, planner_looks, seconds
from mrtask.analysis.results.roles import INFORMED_BASELINE, KNOWN, REFERENCES, RULE
from mrtask.analysis.results.statistics import Bootstrap, Estimate, Floats, improvement_of_means
from mrtask.names import counted
from mrtask.planning.planners import planners_in_order

BUDGET = "sample_budget"
"""Column: the samples per decision that a planner was given; NaN for one that takes none."""
LEVEL_PLANNERS = (INFORMED_BASELINE, RULE, KNOWN)
"""Drawn as level lines beside the curves, where they ran."""
MIN_TEAMS = 4
"""With fewer team sizes the other figures are enough."""
MAX_ABOVE_PERCENT = 100
"""The lower panels end here, so that a curve that starts far above leaves the others readable."""
PANEL_WIDTH_IN, PANEL_HEIGHT_IN = 3.5, 2.9

Point = tuple[str, float]
"""A planner and one of its budgets."""


@dataclass(frozen=True)
class Worth:
    """Planner against planner by team size: the robots where the first is clearly sooner, and where it is not."""

    clear: tuple[int, ...]
    unclear: tuple[int, ...]


@dataclass(frozen=True)
class SampleCurves:
    """The episodes of a sweep over sample budgets, and which planners are drawn."""

    rows: pd.DataFrame
    """One row per planner, budget and trial; the budget of a planner that takes none is 0."""
    curves: tuple[str, ...]
    """Planners that ran with several budgets."""
    levels: tuple[str, ...]
    """Other planners, drawn as level lines."""
    budgets: Mapping[str, tuple[float, ...]]
    """Planner -> its budgets in rising order."""
    best: Point
    """What the lower panels are relative to."""

    @property
    def planners(self) -> tuple[str, ...]:
        """All that are drawn, in the order of the legend."""
        return (*self.curves, *self.levels)

    @property
    def points(self) -> list[Point]:
        """Every planner that is drawn with each of its budgets."""
        return [(name, budget) for name in self.planners for budget in self.budgets[name]]

    @property
    def ticks(self) -> list[float]:
        """The budgets of all curves."""
        return sorted({budget for name in self.curves for budget in self.budgets[name]})


def sample_curves(episodes: pd.DataFrame, planner: str | None) -> SampleCurves | None:
    """What `draw_sample_curves` draws; ``best`` is ``planner``, or the last with a curve, at its largest budget.

    None where no planner ran with several budgets, or where a sweep changed something else too.
    """
    if BUDGET not in episodes.columns:
        return None
    rows = episodes.assign(**{BUDGET: pd.to_numeric(episodes[BUDGET]).fillna(0.0)})
    keys = ["planner", BUDGET, "trial_id"]
    if (rows.groupby(keys)["cost_cells"].nunique(dropna=False) > 1).any():
        return None
    rows = rows.drop_duplicates(keys)
    planners = planners_in_order(rows["planner"].unique())
    budgets = {name: tuple(sorted(rows.loc[rows["planner"] == name, BUDGET].unique())) for name in planners}
    curves = tuple(name for name in planners if len(budgets[name]) > 1)
    if not curves:
        return None
    levels = tuple(name for name in LEVEL_PLANNERS if name in budgets and name not in curves)
    relative_to = planner if planner in curves else curves[-1]
    return SampleCurves(rows, curves, levels, budgets, (relative_to, budgets[relative_to][-1]))


def draw_sample_curves(shown: SampleCurves) -> Figure:
    """Mean cost by samples per decision, a column per team size, a curve per planner; below, what is left to gain."""
    teams = sorted(shown.rows["robots"].unique())
    looks = planner_looks(shown.planners)
    reference, samples = shown.best
    with house_style():
        figure = new_figure(PANEL_WIDTH_IN * max(len(teams), 2), 2 * PANEL_HEIGHT_IN + 0.5)
        grid = figure.subplots(2, len(teams), squeeze=False, sharex=True, sharey="row")
        for robots, (upper, lower) in zip(teams, grid.T, strict=True):
            trials = _draw_team_curves(shown, robots, upper, lower, looks)
            upper.set_title(f"{counted(robots, 'robot')}, {trials} trials")
            upper.set_xscale("log")
            upper.set_xticks(shown.ticks, [f"{tick:,.0f}" for tick in shown.ticks])
            upper.xaxis.set_minor_locator(NullLocator())
            lower.set_xlabel("samples per decision")
        grid[1, 0].set_ylim(top=min(grid[1, 0].get_ylim()[1], MAX_ABOVE_PERCENT))
        grid[0, 0].set_ylabel("mean cost (grid cells)")
        grid[1, 0].set_ylabel(f"% above {planner_label(reference)}\nwith {samples:,.0f} samples")
        handles = [_handle(name, looks[name], level=name in shown.levels) for name in shown.planners]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _draw_team_curves(
    shown: SampleCurves, robots: int, upper: Axes, lower: Axes, looks: Mapping[str, tuple[str, str]]
) -> int:
    """Draws the two panels of one team size; returns the number of trials in them."""
    rows = shown.rows[shown.rows["robots"] == robots]
    costs = rows.pivot(index="trial_id", columns=["planner", BUDGET], values="cost_cells")
    points = [point for point in shown.points if point in costs.columns]
    means = Bootstrap(costs[points].dropna().to_numpy())
    for name in shown.planners:
        own = [point for point in points if point[0] == name]
        _curve(upper, own, [means.estimate(_first, [points.index(point)]) for point in own], looks[name])
        if shown.best in points:
            pairs = [[points.index(point), points.index(shown.best)] for point in own]
            _curve(lower, own, [means.estimate(_above_percent, pair) for pair in pairs], looks[name])
    lower.axhline(0, color=GREY, linewidth=0.8, zorder=0)
    return len(means.costs)


def by_team(episodes: pd.DataFrame, planner: str) -> Figure | None:
    """Mean cost, improvement over each reference and planning time per decision by team size; None with few sizes."""
    teams = sorted(episodes["robots"].unique())
    if len(teams) < MIN_TEAMS:
        return None
    planners = planners_in_order(episodes["planner"].unique())
    looks = planner_looks(planners)
    found = {robots: _team_costs(episodes, robots, planners) for robots in teams}
    with house_style():
        figure = new_figure(3 * PANEL_WIDTH_IN, PANEL_HEIGHT_IN + 0.9)
        costs, gains, times = figure.subplots(1, 3)
        for index, name in enumerate(planners):
            means = [found[robots].estimate(_first, [index]) for robots in teams]
            _line(costs, teams, means, looks[name])
            of_planner = episodes[episodes["planner"] == name]
            if {"planning_s", "decisions"} <= set(of_planner.columns):
                sums = of_planner.groupby("robots")[["planning_s", "decisions"]].sum()
                each_s = (sums["planning_s"] / sums["decisions"]).reindex(teams).to_numpy(dtype=np.float64)
                times.plot(teams, each_s, color=looks[name][0], marker=looks[name][1], markersize=5)
        for name, estimates in _gains(found, planners, planner).items():
            _line(gains, teams, estimates, looks[name])
        gains.axhline(0, color=BLACK, linewidth=0.8, zorder=0)
        costs.set_ylim(bottom=0)
        times.set_yscale("log")
        times.yaxis.set_major_formatter(FuncFormatter(lambda value, _: seconds(value)))
        times.yaxis.set_minor_formatter(NullFormatter())
        costs.set(title="mean cost (grid cells)")
        gains.set(title=f"improvement of {planner_label(planner)} (%) over")
        times.set(title="planning time per decision")
        for axes in (costs, gains, times):
            axes.set(xlabel="robots", xticks=teams)
        handles = [_handle(name, looks[name]) for name in planners]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def worth_by_team(episodes: pd.DataFrame, planner: str, other: str) -> Worth | None:
    """With how many robots ``planner`` is clearly (interval above zero) sooner than ``other``; None without both."""
    planners = planners_in_order(episodes["planner"].unique())
    if planner == other or not {planner, other} <= set(planners):
        return None
    found = {int(robots): _team_costs(episodes, robots, planners) for robots in sorted(episodes["robots"].unique())}
    estimates = dict(zip(found, _gains(found, planners, planner)[other], strict=True))
    clear = tuple(robots for robots, each in estimates.items() if each.low > 0)
    return Worth(clear, tuple(robots for robots in estimates if robots not in clear))


def _team_costs(episodes: pd.DataFrame, robots: int, planners: Sequence[str]) -> Bootstrap:
    rows = episodes[episodes["robots"] == robots]
    costs = rows.pivot(index="trial_id", columns="planner", values="cost_cells").reindex(columns=list(planners))
    return Bootstrap(costs.dropna().to_numpy())


def _gains(found: Mapping[int, Bootstrap], planners: Sequence[str], planner: str) -> dict[str, list[Estimate]]:
    """Reference -> the improvement over it by team size."""
    own = planners.index(planner)
    return {
        name: [each.estimate(improvement_of_means, [own, planners.index(name)]) for each in found.values()]
        for name in REFERENCES
        if name in planners and name != planner
    }


def _first(means: Floats) -> Floats:
    return means[..., 0]


def _above_percent(means: Floats) -> Floats:
    return np.asarray(100 * (means[..., 0] / means[..., 1] - 1))


def _curve(axes: Axes, points: Sequence[Point], estimates: Sequence[Estimate], look: tuple[str, str]) -> None:
    """A curve over budgets; a planner without one is a level line."""
    budgets = [budget for _, budget in points]
    if budgets == [0.0]:
        axes.axhline(estimates[0].value, color=look[0], linestyle="--", linewidth=1.2)
    elif estimates:
        _line(axes, budgets, estimates, look)


def _line(axes: Axes, places: Sequence[float], estimates: Sequence[Estimate], look: tuple[str, str]) -> None:
    values, lows, highs = np.array([[each.value, each.low, each.high] for each in estimates]).T
    axes.plot(places, values, color=look[0], marker=look[1], markersize=5, linewidth=1.6)
    axes.fill_between(list(places), lows, highs, color=look[0], alpha=0.15, linewidth=0)


def _handle(name: str, look: tuple[str, str], level: bool = False) -> Line2D:
    if level:
        return Line2D([], [], color=look[0], linestyle="--", label=planner_label(name))
    return Line2D([], [], color=look[0], marker=look[1], label=planner_label(name))
