"""The charts of the report: planner against baseline, mean costs, improvements, planning time, a sweep's variants.

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
from matplotlib.ticker import FuncFormatter

from mrtask.analysis.page.style import (
    BLACK,
    GREY,
    LIGHT_GREY,
    house_style,
    new_figure,
    planner_label,
    planner_looks,
    robot_color,
    seconds,
)
from mrtask.analysis.results.episodes import Variant
from mrtask.analysis.results.published import Published
from mrtask.analysis.results.roles import KNOWN
from mrtask.analysis.results.statistics import ALL_TEAMS, Cell, Estimate, Floats, Summary, paired_costs
from mrtask.names import counted

WIDTH_IN = 10.5
MAX_VECTOR_POINTS = 1500
"""Scatter plots with more points are drawn as pixels, which keeps the report small."""
MAX_NAMED_CELLS = 12
CLASS_MARKERS = "oDs^vPX"
TIME_PERCENTILES = (5, 25, 50, 75, 95)


def scatter(episodes: pd.DataFrame, summary: Summary, planner: str, baselines: Sequence[str]) -> Figure | None:
    """Each trial's cost with ``planner`` against that with each baseline, by size class; below the line is better."""
    costs = paired_costs(episodes, "cost_cells")
    baselines = [name for name in baselines if name in costs.columns and name != planner]
    if planner not in costs.columns or not costs[[planner, *baselines]].dropna().size or not baselines:
        return None
    trials = episodes.drop_duplicates("trial_id").set_index("trial_id")[["size_class", "robots"]].loc[costs.index]
    pixels = len(costs) * len(baselines) > MAX_VECTOR_POINTS
    with house_style():
        figure = new_figure(WIDTH_IN, 3.7 * len(baselines) + 0.3)
        grid = figure.subplots(len(baselines), len(summary.size_classes), squeeze=False)
        for line, baseline in zip(grid, baselines, strict=True):
            for axes, size_class in zip(line, summary.size_classes, strict=True):
                pairs = costs.loc[(trials["size_class"] == size_class).to_numpy(), [baseline, planner]].dropna()
                _scatter_panel(axes, pairs, trials["robots"], summary.robots, pixels)
                axes.set_xlabel(f"{planner_label(baseline)} (cells)")
                improvement = summary.improvement((size_class, ALL_TEAMS), planner, baseline)
                if improvement.defined:
                    text = f"{improvement.value:+.1f} % improvement\n{len(pairs)} trials"
                    axes.text(0.04, 0.97, text, transform=axes.transAxes, va="top", fontsize=8.5)
            line[0].set_ylabel(f"{planner_label(planner)} (cells)")
        for axes, size_class in zip(grid[0], summary.size_classes, strict=True):
            axes.set_title(size_class)
        handles = [_dot(robot_color(count - 1), counted(count, "robot")) for count in summary.robots]
        handles.append(Line2D([], [], color=BLACK, linewidth=1, label="equal cost"))
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _scatter_panel(axes: Axes, pairs: pd.DataFrame, robots: pd.Series, teams: Sequence[int], pixels: bool) -> None:
    top = float(pairs.to_numpy().max()) * 1.05 if len(pairs) else 1.0
    top = top or 1.0
    axes.fill_between([0, top], [0, top], color="#f3f7fa", zorder=0)
    axes.plot([0, top], [0, top], color=BLACK, linewidth=1, zorder=1)
    for count in teams:
        points = pairs[(robots.loc[pairs.index] == count).to_numpy()].to_numpy()
        looks: dict[str, Any] = {"s": 13, "color": robot_color(count - 1), "alpha": 0.55, "linewidths": 0, "zorder": 2}
        axes.scatter(points[:, 0], points[:, 1], rasterized=pixels, **looks)
    axes.set(xlim=(0, top), ylim=(0, top), aspect="equal")


def mean_costs(summary: Summary, published: Published) -> Figure | None:
    """Mean cost by team size with 95 % intervals, one panel per size class; published means hollow and dashed."""
    if not any(cell.cost_cells.defined for cell in summary.planner_cells.values()):
        return None
    looks = planner_looks([*summary.planners, *published.planners])
    with house_style():
        figure = new_figure(WIDTH_IN, 4.0)
        panels = figure.subplots(1, len(summary.size_classes), squeeze=False)[0]
        for axes, size_class in zip(panels, summary.size_classes, strict=True):
            for name in published.planners:
                means = {r: published.cost_cells.get((name, (size_class, r))) for r in summary.robots}
                known = {robots: mean for robots, mean in means.items() if mean is not None}
                axes.plot(
                    list(known), list(known.values()), linestyle=":", marker=looks[name][1], color=looks[name][0],
                    markerfacecolor="white", linewidth=1, markersize=5,
                )  # fmt: skip
            for index, name in enumerate(summary.planners):
                shift = 0.05 * (index - (len(summary.planners) - 1) / 2)
                _points_with_intervals(
                    axes,
                    [r + shift for r in summary.robots],
                    [summary.cost((size_class, r), name) for r in summary.robots],
                    *looks[name],
                )
            axes.set(title=size_class, xlabel="robots", xticks=summary.robots)
            axes.set_ylim(bottom=0)
            axes.grid(axis="x", visible=False)
        panels[0].set_ylabel("mean cost (grid cells)")
        handles = [_line(*looks[name], planner_label(name)) for name in summary.planners]
        handles.append(
            Line2D([], [], color=GREY, linestyle=":", marker="o", markerfacecolor="white", label="published")
        )
        figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


def improvements(summary: Summary, published: Published, planner: str, baselines: Sequence[str]) -> Figure | None:
    """The improvement over each baseline in every cell with its 95 % interval, beside the published one."""
    baselines = [name for name in baselines if summary.compared(planner, name)]
    cells = summary.cells
    if not baselines:
        return None
    color = planner_looks(summary.planners)[planner][0]
    with house_style():
        figure = new_figure(WIDTH_IN, 2.7 * len(baselines) + 0.4)
        places = np.arange(len(cells))
        panels = figure.subplots(len(baselines), 1, squeeze=False, sharex=True)[:, 0]
        for axes, baseline in zip(panels, baselines, strict=True):
            printed = [published.improvement_of(planner, baseline, cell) for cell in cells]
            heights = [np.nan if value is None else value for value in printed]
            axes.bar(places + 0.2, heights, 0.38, facecolor="white", edgecolor=GREY, hatch="////", linewidth=0.8)
            ours = [summary.improvement(cell, planner, baseline) for cell in cells]
            axes.bar(places - 0.2, [each.value for each in ours], 0.38, color=color)
            axes.errorbar(places - 0.2, [e.value for e in ours], _errors(ours), fmt="none", ecolor=BLACK, capsize=3)
            if KNOWN in summary.planners and planner != KNOWN:
                bound = [summary.improvement(cell, KNOWN, baseline).value for cell in cells]
                axes.plot(places - 0.2, bound, linestyle="none", marker="_", markersize=16, color=BLACK)
            axes.axhline(0, color=BLACK, linewidth=0.8)
            axes.set(ylabel="improvement (%)", title=f"{planner_label(planner)} over {planner_label(baseline)}")
            axes.grid(axis="x", visible=False)
        panels[-1].set_xticks(places, _cell_names(cells))
        handles: list[Patch | Line2D] = [
            Patch(color=color, label=f"{planner_label(planner)}, 95 % interval"),
            Patch(facecolor="white", edgecolor=GREY, hatch="////", label="published"),
        ]
        if KNOWN in summary.planners:
            handles.append(
                Line2D([], [], linestyle="none", marker="_", markersize=14, color=BLACK, label="known contents (bound)")
            )
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _cell_names(cells: Sequence[Cell]) -> list[str]:
    """Size class and team size; of many cells the number of robots, with the class below the first of its cells."""
    if len(cells) <= MAX_NAMED_CELLS:
        return [f"{size_class}\n{counted(robots, 'robot')}" for size_class, robots in cells]
    first = {size_class: robots for size_class, robots in reversed(cells)}
    return [f"{robots}\n{size_class if first[size_class] == robots else ''}" for size_class, robots in cells]


def planning_times(episodes: pd.DataFrame, planners: Sequence[str]) -> Figure | None:
    """Planning time per decision: median, quartiles, 5th and 95th percentile, by planner and team size."""
    if not {"planning_s", "decisions"} <= set(episodes.columns):
        return None
    rows = episodes[(episodes["decisions"] > 0) & (episodes["planning_s"] > 0)]
    rows = rows.assign(decision_s=rows["planning_s"] / rows["decisions"])
    if rows.empty:
        return None
    teams = sorted(rows["robots"].unique())
    boxes, colors = [], []
    for line, name in enumerate(planners):
        for index, robots in enumerate(teams):
            times = rows.loc[(rows["planner"] == name) & (rows["robots"] == robots), "decision_s"]
            if len(times):
                keys = ("whislo", "q1", "med", "q3", "whishi")
                box = dict(zip(keys, np.percentile(times, TIME_PERCENTILES), strict=True))
                boxes.append((box, line + 0.8 * (index + 0.5) / len(teams) - 0.4))
                colors.append(robot_color(robots - 1))
    with house_style():
        figure = new_figure(WIDTH_IN, 0.55 * len(planners) + 1.3)
        axes = figure.subplots()
        drawn = axes.bxp(
            [box for box, _ in boxes], positions=[place for _, place in boxes], widths=0.6 / len(teams),
            orientation="horizontal", showfliers=False, patch_artist=True, manage_ticks=False,
            medianprops={"color": BLACK},
        )  # fmt: skip
        for patch, color in zip(drawn["boxes"], colors, strict=True):
            patch.set(facecolor=color, alpha=0.75)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: seconds(value)))
        axes.set_yticks(range(len(planners)), [planner_label(name) for name in planners])
        axes.invert_yaxis()
        axes.set_xlabel("planning time per decision")
        axes.grid(axis="y", visible=False)
        handles = [Patch(color=robot_color(robots - 1), alpha=0.75, label=counted(robots, "robot")) for robots in teams]
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def sweep(summaries: Mapping[Variant, Summary], planner: str, baselines: Sequence[str]) -> Figure | None:
    """The improvement over each baseline by variant of a sweep, one line per size class, all team sizes together."""
    baselines = [name for name in baselines if any(each.compared(planner, name) for each in summaries.values())]
    if not baselines or len(summaries) < 2:
        return None
    classes = list(dict.fromkeys(name for summary in summaries.values() for name in summary.size_classes))
    names, label = _tick_names(list(summaries))
    with house_style():
        figure = new_figure(WIDTH_IN, 3.8)
        panels = figure.subplots(1, len(baselines), squeeze=False)[0]
        for axes, baseline in zip(panels, baselines, strict=True):
            for index, size_class in enumerate(classes):
                values = [s.improvement((size_class, ALL_TEAMS), planner, baseline) for s in summaries.values()]
                places = [place + 0.06 * (index - (len(classes) - 1) / 2) for place in range(len(values))]
                _points_with_intervals(
                    axes, places, values, robot_color(index), CLASS_MARKERS[index % len(CLASS_MARKERS)]
                )
            axes.axhline(0, color=LIGHT_GREY, linewidth=1, zorder=0)
            axes.set_xticks(range(len(names)), names, rotation=0 if max(map(len, names)) < 9 else 20)
            axes.set(title=f"{planner_label(planner)} over {planner_label(baseline)}", xlabel=label)
            axes.grid(axis="x", visible=False)
        panels[0].set_ylabel("improvement (%)")
        handles = [
            _line(robot_color(index), CLASS_MARKERS[index % len(CLASS_MARKERS)], name)
            for index, name in enumerate(classes)
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _tick_names(variants: Sequence[Variant]) -> tuple[list[str], str]:
    """Values only, with the key as the axis' label, where all variants change the same one key."""
    parts = [variant.partition("=") for variant in variants]
    if len({key for key, _, _ in parts}) == 1 and all(value and "=" not in value for _, _, value in parts):
        return [value for _, _, value in parts], parts[0][0]
    return [variant.replace(",", "\n") or "as configured" for variant in variants], ""


def _errors(estimates: Sequence[Estimate]) -> Floats:
    """[2, N] the interval's lengths below and above the value; NaN, which is not drawn, where there is no interval."""
    lengths = np.array([[each.value - each.low, each.high - each.value] for each in estimates]).T
    return np.asarray(np.maximum(lengths, 0), dtype=np.float64)


def _points_with_intervals(
    axes: Axes, places: Sequence[float], estimates: Sequence[Estimate], color: str, marker: str
) -> None:
    kept = [(place, each) for place, each in zip(places, estimates, strict=True) if each.defined]
    if kept:
        found = [each for _, each in kept]
        axes.errorbar(
            [place for place, _ in kept], [each.value for each in found], _errors(found),
            color=color, marker=marker, markersize=5.5, linewidth=1.6, elinewidth=1, capsize=2.5,
        )  # fmt: skip


def _dot(color: str, label: str) -> Line2D:
    return Line2D([], [], linestyle="none", marker="o", color=color, label=label)


def _line(color: str, marker: str, label: str) -> Line2D:
    return Line2D([], [], color=color, marker=marker, linewidth=1.6, label=label)
