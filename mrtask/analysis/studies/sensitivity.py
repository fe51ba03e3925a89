"""The page of a sensitivity study: what the planner saves as one factor of the experiment at a time varies."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import pandas as pd
from matplotlib.figure import Figure

from mrtask.analysis.page.charts import WIDTH_IN, legend_below, panels, planner_handles, ticks_as, with_band
from mrtask.analysis.page.exhibits import Picture
from mrtask.analysis.page.rendering import Findings, render_page, study_section
from mrtask.analysis.page.style import BLACK, house_style, planner_label, planner_looks
from mrtask.analysis.page.tables import Row, Table, block, estimate_entry, saved_entry
from mrtask.analysis.results.episodes import checked_episodes, size_classes_in_order
from mrtask.analysis.results.roles import BASELINES, OUR_PLANNER
from mrtask.analysis.results.statistics import Estimate, PairedCosts, homes_of, paired_costs

COMPARED = (*BASELINES, OUR_PLANNER)
"""The planners that every point contains."""
LOG_FROM_RATIO = 100
"""Values that span at least this ratio are drawn on a logarithmic axis."""
HEIGHT_IN = 3.4


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
        """Return the trials that all planners finished."""
        return len(self._costs(None).costs)

    @property
    def size_classes(self) -> list[str]:
        """Return the size classes from small to large."""
        return size_classes_in_order(self._rows["size_class"].unique())

    def improvement(self, baseline: str, size_class: str | None = None) -> Estimate:
        """Return what our planner saves of the baseline's mean cost, in percent, in all size classes or in one."""
        return self._costs(size_class).improvement(OUR_PLANNER, baseline)

    def cost(self, planner: str) -> Estimate:
        """Return the planner's mean cost in grid cells."""
        return self._costs(None).mean(planner)

    def _costs(self, size_class: str | None) -> PairedCosts:
        rows = self._rows if size_class is None else self._rows[self._rows["size_class"] == size_class]
        costs = paired_costs(rows, "cost_cells").reindex(columns=list(COMPARED)).dropna()
        return PairedCosts(costs, homes_of(rows))


@dataclass(frozen=True)
class Curve:
    """One factor at several values."""

    name: str
    key: str
    """The factor's key in the configuration."""
    points: tuple[Point, ...]


def render_sensitivity(curves: Sequence[Curve], experiment: str) -> str:
    """Return the page.

    Raises:
        ValueError: the episodes are not what `checked_episodes` demands.
    """
    sections = []
    for number, curve in enumerate(curves):
        caption = (
            f"{curve.key} takes these values; all else is as configured. Every point is over the trials that all three "
            "planners finished, all size classes and team sizes together; bands are 95 % paired bootstrap intervals."
        )
        picture = Picture(f"factor-{number}", curve.name, caption, draw_curve(curve))
        title = curve.name[0].upper() + curve.name[1:]
        sections.append(study_section(picture.name, title, [curve_table(curve)], curve.name, pictures=[picture]))
    return render_page(
        f"mrtask: sensitivity of {experiment}",
        f"How far does what {planner_label(OUR_PLANNER)} saves depend on what the experiment assumes?",
        findings(curves),
        sections,
        episodes=sum(len(point.episodes) for curve in curves for point in curve.points),
    )


def findings(curves: Sequence[Curve]) -> Findings:
    """Say at how many values the planner is clearly better than both baselines, and how each factor moves that."""
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
    return Findings(f"{better} of {len(points)}", headline, tuple(sentences))


def curve_table(curve: Curve) -> Table:
    """Tabulate the saving over each baseline at each value, in all size classes and in each.

    The mean costs behind it are in the table too.
    """
    classes = size_classes_in_order(name for point in curve.points for name in point.size_classes)
    parts: list[tuple[str, str | None]] = [("all", None), *((name, name) for name in classes if len(classes) > 1)]
    rows: list[Row] = []
    for baseline in BASELINES:
        lines = (
            (label, [saved_entry(point.improvement(baseline, part)) for point in curve.points]) for label, part in parts
        )
        rows += block(f"Improvement over {planner_label(baseline)}", lines)
    costs = (
        (planner_label(name), [estimate_entry(point.cost(name), 0, "") for point in curve.points]) for name in COMPARED
    )
    rows += block("Mean cost in grid cells", costs)
    return Table(tuple(("", f"{point.value:g}") for point in curve.points), tuple(rows))


@house_style()
def draw_curve(curve: Curve) -> Figure:
    """Draw the improvement over each baseline, and the mean costs, against the factor.

    Bands are 95 % intervals.
    """
    values = [point.value for point in curve.points]
    looks = planner_looks(COMPARED)
    figure, ((gains, costs),) = panels(WIDTH_IN, HEIGHT_IN, columns=2)
    for baseline in BASELINES:
        with_band(gains, values, [point.improvement(baseline) for point in curve.points], looks[baseline])
    for planner in COMPARED:
        with_band(costs, values, [point.cost(planner) for point in curve.points], looks[planner])
    gains.axhline(0, color=BLACK, linewidth=0.8)
    gains.set(title=f"saved by {planner_label(OUR_PLANNER)} (%) over", xlabel=curve.name)
    costs.set(title="mean cost (grid cells)", xlabel=curve.name)
    costs.set_ylim(bottom=0)
    log = min(values) > 0 and max(values) >= LOG_FROM_RATIO * min(values)
    for axes in (gains, costs):
        ticks_as(axes.xaxis, "{:g}".format, values, log)
    legend_below(figure, planner_handles(COMPARED))
    return figure


def _text(estimate: Estimate) -> str:
    return f"{estimate.value:.1f} %" if estimate.defined else "unknown"
