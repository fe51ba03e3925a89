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

from mrtask.analysis.statistics import KNOWN, REFERENCES, Bootstrap, Estimate, Floats, planners_in_order
from mrtask.analysis.style import BLACK, GREY, house_style, new_figure, planner_looks, seconds, short_name

BUDGET = "sample_budget"
"""Column: the samples per decision that a planner was given; NaN for one that takes none."""
WITHOUT_SEARCH = ("learned_myopic", "greedy", KNOWN)
"""Drawn as level lines beside the curves, where they ran."""
LEAST_TEAMS = 4
"""Below so many team sizes the other figures say it all."""
MOST_ABOVE_PERCENT = 100
"""The lower panels end here, so that a curve that starts far above leaves the others readable."""
PANEL_WIDTH_IN, PANEL_HEIGHT_IN = 3.5, 2.9


@dataclass(frozen=True)
class Worth:
    """Planner against planner by team size: the robots where the first is clearly sooner, and where it is not."""

    clear: tuple[int, ...]
    unclear: tuple[int, ...]


def by_samples(episodes: pd.DataFrame, planner: str | None) -> Figure | None:
    """Mean cost by samples per decision, a column per team size and a curve per planner; below, what is left to gain.

    The lower panels are relative to ``planner``, or the last with a curve, at its largest budget. None where no
    planner ran with several budgets, or where a sweep changed something else too.
    """
    if BUDGET not in episodes.columns:
        return None
    rows = episodes.assign(**{BUDGET: pd.to_numeric(episodes[BUDGET]).fillna(0.0)})
    keys = ["planner", BUDGET, "trial_id"]
    if (rows.groupby(keys)["cost_cells"].nunique(dropna=False) > 1).any():
        return None
    rows = rows.drop_duplicates(keys)
    planners = planners_in_order(rows["planner"].unique())
    budgets = {name: sorted(rows.loc[rows["planner"] == name, BUDGET].unique()) for name in planners}
    curves = [name for name in planners if len(budgets[name]) > 1]
    if not curves:
        return None
    level = [name for name in WITHOUT_SEARCH if name in budgets and name not in curves]
    drawn = [(name, budget) for name in [*curves, *level] for budget in budgets[name]]
    reference = planner if planner in curves else curves[-1]
    teams = sorted(rows["robots"].unique())
    ticks = sorted({budget for name in curves for budget in budgets[name]})
    looks = planner_looks([*curves, *level])
    with house_style():
        figure = new_figure(PANEL_WIDTH_IN * max(len(teams), 2), 2 * PANEL_HEIGHT_IN + 0.5)
        grid = figure.subplots(2, len(teams), squeeze=False, sharex=True, sharey="row")
        for robots, (upper, lower) in zip(teams, grid.T, strict=True):
            costs = rows[rows["robots"] == robots].pivot(
                index="trial_id", columns=["planner", BUDGET], values="cost_cells"
            )
            shown = [one for one in drawn if one in costs.columns]
            means = Bootstrap(costs[shown].dropna().to_numpy())
            best = (reference, budgets[reference][-1])
            for name in [*curves, *level]:
                own = [one for one in shown if one[0] == name]
                _curve(upper, own, [means.estimate(_first, [shown.index(one)]) for one in own], looks[name])
                if best in shown:
                    pairs = [[shown.index(one), shown.index(best)] for one in own]
                    _curve(lower, own, [means.estimate(_above_percent, pair) for pair in pairs], looks[name])
            lower.axhline(0, color=GREY, linewidth=0.8, zorder=0)
            upper.set_title(f"{_team(robots)}, {len(means.costs)} trials")
            upper.set_xscale("log")
            upper.set_xticks(ticks, [f"{tick:,.0f}" for tick in ticks])
            upper.xaxis.set_minor_locator(NullLocator())
            lower.set_xlabel("samples per decision")
        grid[1, 0].set_ylim(top=min(grid[1, 0].get_ylim()[1], MOST_ABOVE_PERCENT))
        grid[0, 0].set_ylabel("mean cost (grid cells)")
        grid[1, 0].set_ylabel(f"% above {short_name(reference)}\nwith {budgets[reference][-1]:,.0f} samples")
        handles = [_handle(name, looks[name], level=name in level) for name in [*curves, *level]]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def by_team(episodes: pd.DataFrame, planner: str) -> Figure | None:
    """Mean cost, improvement over each reference and planning time per decision by team size; None with few sizes."""
    teams = sorted(episodes["robots"].unique())
    if len(teams) < LEAST_TEAMS:
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
        gains.set(title=f"improvement of {short_name(planner)} (%) over")
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
        name: [each.estimate(_improvement, [own, planners.index(name)]) for each in found.values()]
        for name in REFERENCES
        if name in planners and name != planner
    }


def _first(means: Floats) -> Floats:
    return means[..., 0]


def _above_percent(means: Floats) -> Floats:
    return np.asarray(100 * (means[..., 0] / means[..., 1] - 1))


def _improvement(means: Floats) -> Floats:
    return np.asarray(100 * (1 - means[..., 0] / means[..., 1]))


def _curve(
    axes: Axes, points: Sequence[tuple[str, float]], estimates: Sequence[Estimate], look: tuple[str, str]
) -> None:
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
        return Line2D([], [], color=look[0], linestyle="--", label=short_name(name))
    return Line2D([], [], color=look[0], marker=look[1], label=short_name(name))


def _team(robots: int) -> str:
    return "1 robot" if robots == 1 else f"{robots} robots"
