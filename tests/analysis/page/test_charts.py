"""The parts that all charts share."""

from itertools import pairwise

import numpy as np
import pytest

from mrtask.analysis.page.charts import WIDTH_IN, panels, stacked_bars, ticks_as, with_bars
from mrtask.analysis.page.style import house_style, seconds
from mrtask.analysis.results.statistics import UNDEFINED, Estimate


def test_stacked_bars_run_to_both_sides_of_zero():
    _, ((axes,),) = panels(3, 2)
    values = np.array([[2.0, -1.0], [-3.0, -2.0], [4.0, 5.0]])
    bars = stacked_bars(axes, [0, 1], values, ["r", "g", "b"], height=0.8)
    ends = [[sorted((bar.get_x(), bar.get_x() + bar.get_width())) for bar in part] for part in bars]
    assert ends == [[[0, 2], [-1, 0]], [[-3, 0], [-3, -1]], [[2, 6], [0, 5]]]


@pytest.mark.parametrize("sideways", [False, True])
def test_intervals_are_drawn_around_defined_values(sideways):
    _, ((axes,),) = panels(3, 2)
    estimates = [Estimate(2.0, 1.0, 4.0, 20), UNDEFINED, Estimate(3.0, np.nan, np.nan, 5)]
    with_bars(axes, [10, 20, 30], estimates, sideways=sideways, fmt="o")
    points = np.array(axes.lines[0].get_data()).T.tolist()
    assert points == ([[2, 10], [3, 30]] if sideways else [[10, 2], [30, 3]])
    bar = axes.collections[0].get_segments()[0]
    assert bar[:, 0 if sideways else 1].tolist() == [1, 4]


def test_an_axis_has_these_ticks_on_its_scale():
    figure, ((axes,),) = panels(3, 2)
    axes.plot([1, 1000], [1, 2])
    ticks_as(axes.xaxis, "{:,.0f}".format, [1, 10, 1000], log=True)
    figure.draw_without_rendering()
    assert [label.get_text() for label in axes.get_xticklabels()] == ["1", "10", "1,000"]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "linear")
    ticks_as(axes.yaxis, "{:g}".format, log=True)
    assert axes.get_yscale() == "log"


@pytest.mark.parametrize("least", [1.3e-4, 0.0021, 0.97, 40.0])
@pytest.mark.parametrize("decades", [0.1, 0.5, 1, 2, 5])
@pytest.mark.parametrize("upright", [False, True])
def test_a_logarithmic_axis_has_a_few_plain_numbers_however_long_it_is(least, decades, upright):
    with house_style():
        figure, ((axes,),) = panels(3.5 if upright else WIDTH_IN, 2.9)
        values = [least, least * 10**decades]
        axes.plot(*((1, 2), values) if upright else (values, (1, 2)))
        axis = axes.yaxis if upright else axes.xaxis
        ticks_as(axis, seconds, log=True)
        figure.draw_without_rendering()
        low, high = axis.get_view_interval()
        ticks = [tick for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
        texts = [tick.label1.get_text() for tick in ticks]
        assert 2 <= len(texts) == len(set(texts)) and all(text[0].isdigit() for text in texts)
        assert all(seconds(tick.get_loc()) == text for tick, text in zip(ticks, texts, strict=True))
        assert not any(label.get_text() for label in axis.get_minorticklabels())
        boxes = sorted((tick.label1.get_window_extent() for tick in ticks), key=lambda box: (box.x0, box.y0))
        assert not any(one.overlaps(next_one) for one, next_one in pairwise(boxes))
