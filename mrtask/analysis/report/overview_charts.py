"""The charts of the report's overview: planner against baseline, mean costs, improvements, planning time, variants.

Each function takes results and returns a matplotlib figure, or None where there is nothing to draw.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mrtask.analysis.page.charts import LINE, WIDTH_IN, legend_below, panels, planner_handles, ticks_as, with_bars
from mrtask.analysis.page.style import (
    BLACK,
    GREY,
    LIGHT_GREY,
    house_style,
    planner_label,
    planner_looks,
    robot_color,
    seconds,
)
from mrtask.analysis.results.episodes import Variant
from mrtask.analysis.results.published import Published
from mrtask.analysis.results.roles import KNOWN
from mrtask.analysis.results.statistics import ALL_TEAMS, Cell, Summary, paired_costs
from mrtask.names import counted

MAX_VECTOR_POINTS = 1500
"""Scatter plots with more points are drawn as pixels, which keeps the report small."""
POINT: dict[str, Any] = {"s": 13, "alpha": 0.55, "linewidths": 0, "zorder": 2}
MAX_NAMED_CELLS = 12
CLASS_MARKERS = "oDs^vPX"
BOX = {"whislo": 5, "q1": 25, "med": 50, "q3": 75, "whishi": 95}
"""Percentiles of planning times, by matplotlib's names for the parts of a box plot."""
WITH_BARS: dict[str, Any] = LINE | {"markersize": 5.5, "elinewidth": 1, "capsize": 2.5}


@house_style()
def scatter(episodes: pd.DataFrame, summary: Summary, planner: str, baselines: Sequence[str]) -> Figure | None:
    """Each trial's cost with ``planner`` against that with each baseline, by size class; below the line is better."""
    costs = paired_costs(episodes, "cost_cells")
    baselines = [name for name in baselines if name in costs.columns and name != planner]
    if not baselines or planner not in costs.columns or costs[[planner, *baselines]].dropna().empty:
        return None
    trials = episodes.drop_duplicates("trial_id").set_index("trial_id").loc[costs.index]
    pixels = len(costs) * len(baselines) > MAX_VECTOR_POINTS
    classes = summary.size_classes
    figure, grid = panels(WIDTH_IN, 3.7 * len(baselines) + 0.3, len(baselines), len(classes))
    for line, baseline in zip(grid, baselines, strict=True):
        for axes, size_class in zip(line, classes, strict=True):
            pairs = costs.loc[trials["size_class"] == size_class, [baseline, planner]].dropna()
            _scatter_panel(axes, pairs, trials["robots"], summary.robots, pixels)
            title = size_class if baseline == baselines[0] else ""
            axes.set(title=title, xlabel=f"{planner_label(baseline)} (cells)")
            improvement = summary.improvement((size_class, ALL_TEAMS), planner, baseline)
            if improvement.defined:
                text = f"{improvement.value:+.1f} % improvement\n{len(pairs)} trials"
                axes.text(0.04, 0.97, text, transform=axes.transAxes, va="top", fontsize=8.5)
        line[0].set_ylabel(f"{planner_label(planner)} (cells)")
    teams = {counted(count, "robot"): robot_color(count - 1) for count in summary.robots}
    dots = [Line2D([], [], linestyle="none", marker="o", color=color, label=label) for label, color in teams.items()]
    legend_below(figure, [*dots, Line2D([], [], color=BLACK, linewidth=1, label="equal cost")])
    return figure


def _scatter_panel(axes: Axes, pairs: pd.DataFrame, robots: pd.Series, teams: Sequence[int], pixels: bool) -> None:
    top = pairs.to_numpy().max(initial=0.0) * 1.05 or 1.0
    axes.fill_between([0, top], [0, top], color="#f3f7fa", zorder=0)
    axes.plot([0, top], [0, top], color=BLACK, linewidth=1, zorder=1)
    for count in teams:
        points = pairs[robots.loc[pairs.index] == count].to_numpy()
        axes.scatter(points[:, 0], points[:, 1], rasterized=pixels, color=robot_color(count - 1), **POINT)
    axes.set(xlim=(0, top), ylim=(0, top), aspect="equal")


@house_style()
def mean_costs(summary: Summary, published: Published) -> Figure | None:
    """Mean cost by team size with 95 % intervals, one panel per size class; published means hollow and dotted."""
    if not any(cell.cost_cells.defined for cell in summary.planner_cells.values()):
        return None
    looks = planner_looks([*summary.planners, *published.planners])
    hollow: dict[str, Any] = {"linestyle": ":", "markerfacecolor": "white", "linewidth": 1, "markersize": 5}
    figure, (line,) = panels(WIDTH_IN, 4.0, columns=len(summary.size_classes))
    for axes, size_class in zip(line, summary.size_classes, strict=True):
        for name in published.planners:
            means = {r: published.cost_cells.get((name, (size_class, r))) for r in summary.robots}
            known = {robots: mean for robots, mean in means.items() if mean is not None}
            axes.plot(list(known), list(known.values()), color=looks[name][0], marker=looks[name][1], **hollow)
        for name, shift in _side_by_side(summary.planners, 0.05):
            costs = [summary.cost((size_class, robots), name) for robots in summary.robots]
            places = [robots + shift for robots in summary.robots]
            with_bars(axes, places, costs, color=looks[name][0], marker=looks[name][1], **WITH_BARS)
        axes.set(title=size_class, xlabel="robots", xticks=summary.robots)
        axes.set_ylim(bottom=0)
        axes.grid(axis="x", visible=False)
    line[0].set_ylabel("mean cost (grid cells)")
    printed = Line2D([], [], color=GREY, marker="o", label="published", **hollow)
    legend_below(figure, [*planner_handles(summary.planners), printed], columns=4)
    return figure


@house_style()
def improvements(summary: Summary, published: Published, planner: str, baselines: Sequence[str]) -> Figure | None:
    """The improvement over each baseline in every cell with its 95 % interval, beside the published one."""
    baselines = [name for name in baselines if summary.compared(planner, name)]
    if not baselines:
        return None
    cells, has_known = summary.cells, KNOWN in summary.planners and planner != KNOWN
    color = planner_looks(summary.planners)[planner][0]
    printed_look: dict[str, Any] = {"facecolor": "white", "edgecolor": GREY, "hatch": "////"}
    level_look: dict[str, Any] = {"linestyle": "none", "marker": "_", "color": BLACK}
    figure, grid = panels(WIDTH_IN, 2.7 * len(baselines) + 0.4, len(baselines), sharex=True)
    places = np.arange(len(cells))
    for (axes,), baseline in zip(grid, baselines, strict=True):
        printed = [published.improvement_of(planner, baseline, cell) for cell in cells]
        heights = [np.nan if value is None else value for value in printed]
        axes.bar(places + 0.2, heights, 0.38, linewidth=0.8, **printed_look)
        ours = [summary.improvement(cell, planner, baseline) for cell in cells]
        axes.bar(places - 0.2, [each.value for each in ours], 0.38, color=color)
        with_bars(axes, places - 0.2, ours, fmt="none", ecolor=BLACK, capsize=3)
        if has_known:
            level = [summary.improvement(cell, KNOWN, baseline).value for cell in cells]
            axes.plot(places - 0.2, level, markersize=16, **level_look)
        axes.axhline(0, color=BLACK, linewidth=0.8)
        axes.set(ylabel="improvement (%)", title=f"{planner_label(planner)} over {planner_label(baseline)}")
        axes.grid(axis="x", visible=False)
    grid[-1, 0].set_xticks(places, _cell_names(cells))
    own = Patch(color=color, label=f"{planner_label(planner)}, 95 % interval")
    level_handle = Line2D([], [], markersize=14, label="known", **level_look)
    legend_below(figure, [own, Patch(label="published", **printed_look), *([level_handle] if has_known else [])])
    return figure


def _cell_names(cells: Sequence[Cell]) -> list[str]:
    """Size class and team size; of many cells the number of robots, with the class below the first of its cells."""
    if len(cells) <= MAX_NAMED_CELLS:
        return [f"{size_class}\n{counted(robots, 'robot')}" for size_class, robots in cells]
    first = {size_class: robots for size_class, robots in reversed(cells)}
    return [f"{robots}\n{size_class if first[size_class] == robots else ''}" for size_class, robots in cells]


@house_style()
def planning_times(episodes: pd.DataFrame, planners: Sequence[str]) -> Figure | None:
    """Planning time per decision: median, quartiles, 5th and 95th percentile, by planner and team size."""
    if not {"planning_s", "decisions"} <= set(episodes.columns):
        return None
    rows = episodes[(episodes["decisions"] > 0) & (episodes["planning_s"] > 0)]
    if rows.empty:
        return None
    times: dict[Any, pd.Series] = dict(
        list((rows["planning_s"] / rows["decisions"]).groupby([rows["planner"], rows["robots"]]))
    )
    teams = sorted(rows["robots"].unique())
    places = {
        (name, robots): line + 0.8 * (index + 0.5) / len(teams) - 0.4
        for line, name in enumerate(planners)
        for index, robots in enumerate(teams)
    }
    boxes = [dict(zip(BOX, np.percentile(group, list(BOX.values())), strict=True)) for group in times.values()]
    figure, ((axes,),) = panels(WIDTH_IN, 0.55 * len(planners) + 1.3)
    drawn = axes.bxp(
        boxes, positions=[places[key] for key in times], widths=0.6 / len(teams), orientation="horizontal",
        showfliers=False, patch_artist=True, manage_ticks=False, medianprops={"color": BLACK},
    )  # fmt: skip
    for patch, (_, robots) in zip(drawn["boxes"], times, strict=True):
        patch.set(facecolor=robot_color(robots - 1), alpha=0.75)
    ticks_as(axes.xaxis, seconds, log=True)
    axes.set_yticks(range(len(planners)), [planner_label(name) for name in planners])
    axes.invert_yaxis()
    axes.set_xlabel("planning time per decision")
    axes.grid(axis="y", visible=False)
    legend_below(figure, [Patch(color=robot_color(n - 1), alpha=0.75, label=counted(n, "robot")) for n in teams])
    return figure


@house_style()
def sweep(summaries: Mapping[Variant, Summary], planner: str, baselines: Sequence[str]) -> Figure | None:
    """The improvement over each baseline by variant of a sweep, one line per size class, all team sizes together."""
    baselines = [name for name in baselines if any(each.compared(planner, name) for each in summaries.values())]
    if not baselines or len(summaries) < 2:
        return None
    classes = list(dict.fromkeys(name for summary in summaries.values() for name in summary.size_classes))
    looks: dict[str, dict[str, Any]] = {
        name: {"color": robot_color(i), "marker": CLASS_MARKERS[i % len(CLASS_MARKERS)]}
        for i, name in enumerate(classes)
    }
    names, label = _tick_names(list(summaries))
    figure, (line,) = panels(WIDTH_IN, 3.8, columns=len(baselines))
    for axes, baseline in zip(line, baselines, strict=True):
        for size_class, shift in _side_by_side(classes, 0.06):
            values = [each.improvement((size_class, ALL_TEAMS), planner, baseline) for each in summaries.values()]
            with_bars(axes, np.arange(len(values)) + shift, values, **looks[size_class], **WITH_BARS)
        axes.axhline(0, color=LIGHT_GREY, linewidth=1, zorder=0)
        axes.set_xticks(range(len(names)), names, rotation=0 if max(map(len, names)) < 9 else 20)
        axes.set(title=f"{planner_label(planner)} over {planner_label(baseline)}", xlabel=label)
        axes.grid(axis="x", visible=False)
    line[0].set_ylabel("improvement (%)")
    legend_below(figure, [Line2D([], [], label=name, **looks[name]) for name in classes])
    return figure


def _side_by_side(names: Sequence[str], step: float) -> list[tuple[str, float]]:
    """Each name with the shift that keeps its marks from covering the others."""
    return [(name, step * (index - (len(names) - 1) / 2)) for index, name in enumerate(names)]


def _tick_names(variants: Sequence[Variant]) -> tuple[list[str], str]:
    """Values only, with the key as the axis' label, where all variants change the same one key."""
    parts = [variant.partition("=") for variant in variants]
    if len({key for key, _, _ in parts}) == 1 and all(value and "=" not in value for _, _, value in parts):
        return [value for _, _, value in parts], parts[0][0]
    return [variant.replace(",", "\n") or "as configured" for variant in variants], ""
