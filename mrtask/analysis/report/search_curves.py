"""The value of search: cost against the number of samples (the anytime curve), and cost and time against team size.

Everything in a panel is over the same trials: those that all of its planners finished, in all size classes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mrtask.analysis.page.charts import (
    LINE,
    WIDTH_IN,
    Look,
    legend_below,
    panels,
    planner_handles,
    ticks_as,
    with_band,
)
from mrtask.analysis.page.style import BLACK, GREY, house_style, planner_label, planner_looks, seconds
from mrtask.analysis.results.episodes import BUDGET
from mrtask.analysis.results.roles import INFORMED_BASELINE, KNOWN, REFERENCES, RULE
from mrtask.analysis.results.statistics import Estimate, PairedCosts, decision_s, homes_of, paired_costs
from mrtask.names import counted
from mrtask.planning.planners import planners_in_order

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
    """The team sizes at which one planner is clearly sooner than another, and those at which it is not."""

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
    """The reference of the lower panels."""

    @property
    def planners(self) -> tuple[str, ...]:
        """All planners that are drawn, in the order of the legend."""
        return (*self.curves, *self.levels)


def sample_curves(episodes: pd.DataFrame, planner: str | None) -> SampleCurves | None:
    """What `draw_sample_curves` draws; ``best`` is ``planner``, or the last with a curve, at its largest budget.

    None where no planner ran with several budgets, or where the sweep also changed something else.
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


@house_style()
def draw_sample_curves(shown: SampleCurves) -> Figure:
    """Mean cost by samples per decision, a column per team size, a curve per planner; below, what is still to gain."""
    teams = sorted(shown.rows["robots"].unique())
    looks = planner_looks(shown.planners)
    reference, samples = shown.best
    ticks = sorted({budget for name in shown.curves for budget in shown.budgets[name]})
    width_in = PANEL_WIDTH_IN * max(len(teams), 2)
    figure, grid = panels(width_in, 2 * PANEL_HEIGHT_IN + 0.5, 2, len(teams), sharex=True, sharey="row")
    for robots, (upper, lower) in zip(teams, grid.T, strict=True):
        trials = _draw_team_curves(shown, robots, upper, lower, looks)
        upper.set_title(f"{counted(robots, 'robot')}, {trials} trials")
        lower.set_xlabel("samples per decision")
        ticks_as(upper.xaxis, "{:,.0f}".format, ticks, log=True)
    grid[1, 0].set_ylim(top=min(grid[1, 0].get_ylim()[1], MAX_ABOVE_PERCENT))
    grid[0, 0].set_ylabel("mean cost (grid cells)")
    grid[1, 0].set_ylabel(f"% above {planner_label(reference)}\nwith {samples:,.0f} samples")
    legend_below(figure, planner_handles(shown.planners, dashed=shown.levels))
    return figure


def _draw_team_curves(shown: SampleCurves, robots: int, upper: Axes, lower: Axes, looks: Mapping[str, Look]) -> int:
    """Draw the two panels of one team size; return the number of trials in them."""
    rows = shown.rows[shown.rows["robots"] == robots]
    costs = rows.pivot(index="trial_id", columns=["planner", BUDGET], values="cost_cells")
    every = [(name, budget) for name in shown.planners for budget in shown.budgets[name]]
    points = [point for point in every if point in costs.columns]
    paired = PairedCosts(costs[points].dropna(), homes_of(rows))
    for name in shown.planners:
        own = [point for point in points if point[0] == name]
        _curve(upper, own, [paired.mean(point) for point in own], looks[name])
        if shown.best in points:
            _curve(lower, own, [paired.above(point, shown.best) for point in own], looks[name])
    lower.axhline(0, color=GREY, linewidth=0.8, zorder=0)
    return len(paired.costs)


@house_style()
def by_team(episodes: pd.DataFrame, planner: str) -> Figure | None:
    """Mean cost, improvement over each reference and planning time per decision by team size; None with few sizes."""
    found = _costs_by_team(episodes)
    if len(found) < MIN_TEAMS:
        return None
    teams, planners = list(found), planners_in_order(episodes["planner"].unique())
    looks = planner_looks(planners)
    times_s = {robots: decision_s(episodes[episodes["robots"] == robots]) for robots in teams}
    figure, ((costs, gains, times),) = panels(WIDTH_IN, PANEL_HEIGHT_IN + 0.9, columns=3)
    for name in planners:
        with_band(costs, teams, [each.mean(name) for each in found.values()], looks[name])
        if name in REFERENCES and name != planner:
            with_band(gains, teams, [each.improvement(planner, name) for each in found.values()], looks[name])
        if timed := [robots for robots in teams if name in times_s[robots]]:
            own_s = [times_s[robots][name] for robots in timed]
            times.plot(timed, own_s, color=looks[name][0], marker=looks[name][1], **LINE)
    gains.axhline(0, color=BLACK, linewidth=0.8, zorder=0)
    costs.set_ylim(bottom=0)
    ticks_as(times.yaxis, seconds, log=True)
    costs.set(title="mean cost (grid cells)", xlabel="robots", xticks=teams)
    gains.set(title=f"improvement of {planner_label(planner)} (%) over", xlabel="robots", xticks=teams)
    times.set(title="planning time per decision", xlabel="robots", xticks=teams)
    legend_below(figure, planner_handles(planners))
    return figure


def worth_by_team(episodes: pd.DataFrame, planner: str, other: str) -> Worth | None:
    """With how many robots ``planner`` is clearly (interval above zero) sooner than ``other``; None without both."""
    if planner == other or not {planner, other} <= set(episodes["planner"]):
        return None
    gains = {robots: each.improvement(planner, other) for robots, each in _costs_by_team(episodes).items()}
    clear = tuple(robots for robots, each in gains.items() if each.low > 0)
    return Worth(clear, tuple(robots for robots in gains if robots not in clear))


def _costs_by_team(episodes: pd.DataFrame) -> dict[int, PairedCosts]:
    """Team size -> the costs of the trials that all planners finished; in rising order."""
    planners, found = list(episodes["planner"].unique()), {}
    for robots in sorted(map(int, episodes["robots"].unique())):
        rows = episodes[episodes["robots"] == robots]
        costs = paired_costs(rows, "cost_cells").reindex(columns=planners).dropna()
        found[robots] = PairedCosts(costs, homes_of(rows))
    return found


def _curve(axes: Axes, points: Sequence[Point], estimates: Sequence[Estimate], look: Look) -> None:
    """A curve over budgets; a planner without a budget is a level line."""
    budgets = [budget for _, budget in points]
    if budgets == [0.0]:
        axes.axhline(estimates[0].value, color=look[0], linestyle="--", linewidth=1.2)
    elif estimates:
        with_band(axes, budgets, estimates, look)
