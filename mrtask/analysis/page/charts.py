"""The common parts of all charts: panels, axes, legends, and estimates with their intervals."""

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.container import BarContainer
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator
from numpy.typing import NDArray

from mrtask.analysis.page.style import new_figure, planner_label, planner_looks
from mrtask.analysis.results.statistics import Estimate
from mrtask.arrays import Floats

Look = tuple[str, str]
"""Colour and marker."""

WIDTH_IN = 10.5
"""The width of a chart that fills the page."""
LINE: dict[str, Any] = {"markersize": 5, "linewidth": 1.6}
BAND_ALPHA = 0.15
MAX_ROUND_TICKS = 4
MAX_DECADES_WITH_PARTS = 2.5
"""A longer logarithmic axis has numbers at powers of ten alone."""


class RoundLogTicks(LogLocator):
    """Ticks at round numbers, a few on however short a logarithmic axis.

    Within a decade they are evenly spaced; over a few decades they are at 1, 2 and 5 times a power of ten.
    """

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        """The ticks from ``vmin`` to ``vmax``."""
        low, high = sorted((vmin, vmax))
        decades = np.log10(high / low) if low > 0 else np.inf
        if decades <= 1:
            ticks = MaxNLocator(MAX_ROUND_TICKS, steps=[1, 2, 5, 10]).tick_values(low, high)
            return [tick for tick in ticks if tick > 0]
        self.set_params(subs=(1.0, 2.0, 5.0) if decades <= MAX_DECADES_WITH_PARTS else (1.0,))
        return super().tick_values(vmin, vmax)


def panels(width_in: float, height_in: float, rows: int = 1, columns: int = 1, **sharing: Any) -> tuple[Figure, Any]:
    """A figure with its axes, [rows, columns]; ``sharing`` as `Figure.subplots` takes it."""
    figure = new_figure(width_in, height_in)
    return figure, figure.subplots(rows, columns, squeeze=False, **sharing)


def legend_below(figure: Figure, handles: Sequence[Artist], columns: int | None = None) -> None:
    """One legend for all panels; in one line by default."""
    figure.legend(handles=handles, loc="outside lower center", ncols=columns or len(handles))


def planner_handles(planners: Sequence[str], dashed: Collection[str] = ()) -> list[Line2D]:
    """A legend's entry for each planner; those of ``dashed`` are level lines without a marker."""
    looks = planner_looks(planners)
    lines: dict[str, dict[str, Any]] = {
        name: {"linestyle": "--"} if name in dashed else {"marker": looks[name][1]} for name in planners
    }
    return [Line2D([], [], color=looks[name][0], label=planner_label(name), **lines[name]) for name in planners]


def ticks_as(axis: Axis, text: Callable[[float], str], ticks: Sequence[float] | None = None, log: bool = False) -> None:
    """Label an axis with plain numbers, at ``ticks`` if there are any; ``log``: on a logarithmic scale."""
    if log:
        axis.axes.set(**{"xscale" if axis is axis.axes.xaxis else "yscale": "log"})
        axis.set_major_locator(RoundLogTicks())
    if ticks is not None:
        axis.set_major_locator(FixedLocator(ticks))
        axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: text(value)))
    axis.set_minor_formatter(NullFormatter())


def with_band(axes: Axes, places: Sequence[float], estimates: Sequence[Estimate], look: Look) -> None:
    """A line through the values, and a band from the lower to the upper ends of their intervals."""
    values, lows, highs = _arrays(estimates)
    axes.plot(places, values, color=look[0], marker=look[1], **LINE)
    axes.fill_between(list(places), lows, highs, color=look[0], alpha=BAND_ALPHA, linewidth=0)


def with_bars(
    axes: Axes, places: Iterable[float], estimates: Sequence[Estimate], *, sideways: bool = False, **looks: Any
) -> None:
    """The defined values with their intervals as bars with caps; ``sideways``: values run from left to right."""
    kept = [(place, each) for place, each in zip(places, estimates, strict=True) if each.defined]
    if not kept:
        return
    values, lows, highs = _arrays([each for _, each in kept])
    lengths = np.maximum([values - lows, highs - values], 0)
    shown = [place for place, _ in kept]
    if sideways:
        axes.errorbar(values, shown, xerr=lengths, **looks)
    else:
        axes.errorbar(shown, values, yerr=lengths, **looks)


def stacked_bars(
    axes: Axes, places: Sequence[float], values: Floats, colors: Sequence[str], height: float
) -> list[BarContainer]:
    """Bars of ``values`` [parts, places]: parts above zero run to the right one after the other, others to the left."""
    ends = np.where(
        values >= 0, np.cumsum(np.clip(values, 0, None), axis=0), np.cumsum(np.clip(values, None, 0), axis=0)
    )
    return [
        axes.barh(places, part, height, left=end - part, color=color)
        for part, end, color in zip(values, ends, colors, strict=True)
    ]


def _arrays(estimates: Sequence[Estimate]) -> NDArray[np.float64]:
    """[3, N] values, lower and upper ends."""
    return np.array([[each.value, each.low, each.high] for each in estimates]).T
