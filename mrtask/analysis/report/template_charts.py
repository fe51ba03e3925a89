"""Pictures of one planner against the others by part of the trials: improvement by template; wins, ties and losses."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from mrtask.analysis.page.style import (
    BLACK,
    LIGHT_GREY,
    ORANGE,
    house_style,
    new_figure,
    planner_label,
    planner_looks,
)
from mrtask.analysis.report.by_template import TemplateResult
from mrtask.analysis.report.wins import compared_cells
from mrtask.analysis.results.roles import REFERENCES
from mrtask.analysis.results.statistics import ALL_CLASSES, Comparison, Summary, cell_name

WIDTH_IN = 10.5
ROW_IN = 0.27
MIN_LABELLED_PERCENT = 9.0
"""A narrower part of a bar has no number in it."""


def template_improvements(results: Mapping[str, TemplateResult], planner: str) -> Figure | None:
    """The improvement over each other planner with its interval, a line per template; None if nothing is compared."""
    references = [name for name in REFERENCES if any(result.improvement(name).defined for result in results.values())]
    if not references:
        return None
    shown = list(results.values())
    color, marker = planner_looks([planner])[planner]
    with house_style():
        figure = new_figure(WIDTH_IN, ROW_IN * len(shown) + 1.0)
        panels = figure.subplots(1, len(references), squeeze=False, sharex=True, sharey=True)[0]
        places = np.arange(len(shown))
        for axes, reference in zip(panels, references, strict=True):
            found = [result.improvement(reference) for result in shown]
            values, lows, highs = np.array([[each.value, each.low, each.high] for each in found]).T
            axes.errorbar(
                values, places, xerr=np.maximum([values - lows, highs - values], 0), fmt=marker, color=color,
                markersize=5.5, elinewidth=1.4, capsize=2.5,
            )  # fmt: skip
            axes.axvline(0, color=BLACK, linewidth=0.8, zorder=0)
            axes.set(title=f"over {planner_label(reference)}", xlabel="improvement (%)")
            axes.grid(axis="y", visible=False)
        panels[0].set_yticks(places, [result.label for result in shown])
        panels[0].set_ylim(len(shown) - 0.5, -0.5)
    return figure


def wins(summary: Summary, planner: str) -> Figure | None:
    """The shares of trials that ``planner`` won, tied and lost, a panel per other planner, a bar per cell."""
    by_reference = {
        reference: {
            cell: pair
            for cell, pair in compared_cells(summary, planner, reference)
            if cell[0] == ALL_CLASSES or cell in summary.cells
        }
        for reference in REFERENCES
        if summary.compared(planner, reference)
    }
    by_reference = {name: pairs for name, pairs in by_reference.items() if any(p.improvement.n for p in pairs.values())}
    if not by_reference:
        return None
    cells = list(dict.fromkeys(cell for pairs in by_reference.values() for cell in pairs))
    color = planner_looks([planner])[planner][0]
    with house_style():
        figure = new_figure(WIDTH_IN, ROW_IN * len(cells) + 1.2)
        panels = figure.subplots(1, len(by_reference), squeeze=False, sharey=True)[0]
        for axes, (reference, pairs) in zip(panels, by_reference.items(), strict=True):
            for place, cell in enumerate(cells):
                if cell in pairs and pairs[cell].improvement.n:
                    _bar(axes, place, pairs[cell], color)
            axes.set(title=f"against {planner_label(reference)}", xlabel="trials (%)", xlim=(0, 100))
            axes.grid(visible=False)
        panels[0].set_yticks(
            range(len(cells)), ["all" if cell[0] == ALL_CLASSES else cell_name(cell) for cell in cells]
        )
        panels[0].set_ylim(len(cells) - 0.4, -0.6)
        name = planner_label(planner)
        looks = {color: f"{name} sooner", LIGHT_GREY: "equal", ORANGE: f"{name} later"}
        handles = [Patch(color=each, label=label) for each, label in looks.items()]
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _bar(axes: Axes, place: int, pair: Comparison, color: str) -> None:
    """One stacked bar with the share of wins and of losses written into it."""
    trials, left = pair.improvement.n, 0.0
    parts = ((pair.wins, color, "white"), (pair.ties, LIGHT_GREY, BLACK), (pair.losses, ORANGE, BLACK))
    for count, fill, ink in parts:
        percent = 100 * count / trials
        axes.barh(place, percent, 0.78, left=left, color=fill)
        if percent >= MIN_LABELLED_PERCENT:
            axes.text(
                left + percent / 2, place, f"{percent:.0f}", ha="center", va="center_baseline", fontsize=7, color=ink
            )
        left += percent
