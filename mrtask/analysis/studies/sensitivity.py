"""The page of a sensitivity study: what the planner saves against one factor of the experiment at a time."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from mrtask.analysis.page.columns import Entry, Row, Table, interval_text
from mrtask.analysis.page.entries import percent_entry
from mrtask.analysis.page.findings import Findings
from mrtask.analysis.page.style import (
    BLACK,
    NOTHING,
    data_uri,
    house_style,
    new_figure,
    planner_label,
    planner_looks,
    svg_bytes,
)
from mrtask.analysis.page.templating import render_fragment, script_digest
from mrtask.analysis.results.episodes import checked_episodes, size_classes_in_order
from mrtask.analysis.results.statistics import BASELINES, Bootstrap, Estimate, improvement_of_means, paired_costs
from mrtask.planning.planners import Role, planners_with_role

OUR_PLANNER = planners_with_role(Role.OURS)[0]
COMPARED = (*BASELINES, OUR_PLANNER)
"""The planners that every point has."""
LOG_FROM_RATIO = 100
"""Values that span as much are drawn on a logarithmic axis."""
FIGURE_IN = (10.5, 3.4)


@dataclass(frozen=True, eq=False)
class Point:
    """The episodes of `COMPARED` with the factor at one value."""

    value: float
    episodes: pd.DataFrame

    @cached_property
    def _rows(self) -> pd.DataFrame:
        return checked_episodes(self.episodes)

    @property
    def trials(self) -> int:
        """The trials that all planners finished."""
        return len(self._costs(None).costs)

    @property
    def size_classes(self) -> list[str]:
        """Small to large."""
        return size_classes_in_order(self._rows["size_class"].unique())

    def improvement(self, baseline: str, size_class: str | None = None) -> Estimate:
        """What our planner saves of the baseline's mean cost, in percent; in all size classes, or in one."""
        columns = [COMPARED.index(OUR_PLANNER), COMPARED.index(baseline)]
        return self._costs(size_class).estimate(improvement_of_means, columns)

    def cost(self, planner: str) -> Estimate:
        """The planner's mean cost in grid cells."""
        return self._costs(None).estimate(lambda means: means[..., 0], [COMPARED.index(planner)])

    def _costs(self, size_class: str | None) -> Bootstrap:
        rows = self._rows if size_class is None else self._rows[self._rows["size_class"] == size_class]
        return Bootstrap(paired_costs(rows, "cost_cells").reindex(columns=list(COMPARED)).dropna().to_numpy())


@dataclass(frozen=True)
class Curve:
    """One factor at several values."""

    name: str
    key: str
    """In the configuration."""
    points: tuple[Point, ...]


def render_sensitivity(curves: Sequence[Curve], experiment: str) -> str:
    """The page.

    Raises:
        ValueError: the episodes are not what `checked_episodes` demands.
    """
    sections = [
        {
            "anchor": f"factor-{number}",
            "link": curve.name,
            "title": curve.name[0].upper() + curve.name[1:],
            "body": render_fragment(
                "sensitivity",
                curve=curve,
                uri=data_uri(svg_bytes(draw_curve(curve))),
                table=curve_table(curve),
                planner=OUR_PLANNER,
            ),
        }
        for number, curve in enumerate(curves)
    ]
    return render_fragment(
        "page",
        title=f"mrtask: sensitivity of {experiment}",
        script="",
        script_digest=script_digest(""),
        question=f"How far does what {planner_label(OUR_PLANNER)} saves depend on what the experiment assumes?",
        findings=findings(curves),
        warnings=[],
        variants=1,
        shown="",
        sections=sections,
        episodes=sum(len(point.episodes) for curve in curves for point in curve.points),
    )


def findings(curves: Sequence[Curve]) -> Findings:
    """At how many values the planner is clearly better than both baselines, and how each factor moves that."""
    points = [point for curve in curves for point in curve.points]
    better = sum(all(point.improvement(baseline).low > 0 for baseline in BASELINES) for point in points)
    sentences = []
    for curve in curves:
        first, last = curve.points[0], curve.points[-1]
        moves = [
            f"over {planner_label(baseline)} {_text(first.improvement(baseline))} at {first.value:g} and "
            f"{_text(last.improvement(baseline))} at {last.value:g}"
            for baseline in BASELINES
        ]
        unclear = [
            f"{planner_label(baseline)} at {', '.join(values)}"
            for baseline in BASELINES
            if (values := [f"{one.value:g}" for one in curve.points if not one.improvement(baseline).low > 0])
        ]
        doubt = f"; not clearly better than {' and '.join(unclear)}" if unclear else ""
        sentences.append(f"{curve.name}: {', '.join(moves)}{doubt}.")
    headline = (
        f"{planner_label(OUR_PLANNER)} is clearly better (95 % interval above zero) than both baselines at {better} of "
        f"{len(points)} values of {len(curves)} factors, each changed by itself."
    )
    return Findings(f"{better} of {len(points)}", headline, tuple(sentences), ())


def curve_table(curve: Curve) -> Table:
    """What is saved over each baseline at each value, in all and by size class, and the mean costs behind it."""
    rows: list[Row] = []
    for baseline in BASELINES:
        rows.append(Row(f"Improvement over {planner_label(baseline)}", heading=True))
        rows.append(Row("all", tuple(_saved(point.improvement(baseline)) for point in curve.points)))
        classes = dict.fromkeys(name for point in curve.points for name in point.size_classes)
        if len(classes) > 1:
            for name in size_classes_in_order(classes):
                rows.append(Row(name, tuple(_saved(point.improvement(baseline, name)) for point in curve.points)))
    rows.append(Row("Mean cost in grid cells", heading=True))
    for planner in COMPARED:
        costs = (point.cost(planner) for point in curve.points)
        rows.append(Row(planner_label(planner), tuple(_cost(cost) for cost in costs)))
    return Table(tuple(("", f"{point.value:g}") for point in curve.points), tuple(rows))


def draw_curve(curve: Curve) -> Figure:
    """The improvement over each baseline, and the mean costs, against the factor; bands are 95 % intervals."""
    values = [point.value for point in curve.points]
    looks = planner_looks(COMPARED)
    with house_style():
        figure = new_figure(*FIGURE_IN)
        gains, costs = figure.subplots(1, 2)
        for baseline in BASELINES:
            _band(gains, values, [point.improvement(baseline) for point in curve.points], looks[baseline])
        for planner in COMPARED:
            _band(costs, values, [point.cost(planner) for point in curve.points], looks[planner])
        gains.axhline(0, color=BLACK, linewidth=0.8)
        gains.set(title=f"saved by {planner_label(OUR_PLANNER)} (%) over")
        costs.set(title="mean cost (grid cells)")
        costs.set_ylim(bottom=0)
        for axes in (gains, costs):
            axes.set_xlabel(curve.name)
            if min(values) > 0 and max(values) >= LOG_FROM_RATIO * min(values):
                axes.set_xscale("log")
            axes.xaxis.set_major_locator(FixedLocator(values))
            axes.xaxis.set_minor_locator(NullLocator())
            axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        handles = [
            Line2D([], [], color=looks[name][0], marker=looks[name][1], label=planner_label(name)) for name in COMPARED
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _band(axes: Axes, values: Sequence[float], estimates: Sequence[Estimate], look: tuple[str, str]) -> None:
    lows, highs = ([getattr(each, end) for each in estimates] for end in ("low", "high"))
    axes.plot(values, [each.value for each in estimates], color=look[0], marker=look[1], markersize=5, linewidth=1.6)
    axes.fill_between(values, lows, highs, color=look[0], alpha=0.15, linewidth=0)


def _saved(estimate: Estimate) -> Entry:
    entry = percent_entry(estimate)
    return Entry(entry.value, entry.details, "good" if estimate.low > 0 else "bad" if estimate.high < 0 else "")


def _cost(estimate: Estimate) -> Entry:
    return Entry(f"{estimate.value:.0f}", (interval_text(estimate),)) if estimate.defined else Entry(NOTHING)


def _text(estimate: Estimate) -> str:
    return f"{estimate.value:.1f} %" if np.isfinite(estimate.value) else "unknown"
