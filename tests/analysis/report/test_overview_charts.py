import base64
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from mrtask.analysis.page.exhibits import Picture
from mrtask.analysis.page.style import planner_label, planner_looks, seconds, svg_bytes
from mrtask.analysis.report import overview_charts
from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.published import load_published
from mrtask.analysis.results.roles import BASELINES
from mrtask.analysis.results.statistics import summarise
from tests.analysis.synthetic import fail, make_episodes, rows

PUBLISHED = load_published()


@pytest.fixture(scope="module")
def episodes():
    frame = make_episodes(5, size_classes=["small", "large"])
    return checked_episodes(fail(frame, frame.index.to_series() == 4))  # pouct's first small trial


@pytest.fixture(scope="module")
def summary(episodes):
    return summarise(episodes)


def test_scatter_has_a_point_per_pair(episodes, summary):
    figure = overview_charts.scatter(episodes, summary, "pouct", BASELINES)
    assert len(figure.axes) == 4
    costs = episodes.pivot(index="trial_id", columns="planner", values="cost_cells")
    for axes, (baseline, size_class) in zip(
        figure.axes, [(b, c) for b in BASELINES for c in ("small", "large")], strict=True
    ):
        drawn = np.concatenate([dots.get_offsets() for dots in axes.collections[1:]])
        pairs = costs.loc[costs.index.str.startswith(size_class), [baseline, "pouct"]].dropna()
        assert sorted(map(tuple, drawn.tolist())) == sorted(map(tuple, pairs.to_numpy().tolist()))


def test_improvement_bars(summary):
    figure = overview_charts.improvements(summary, PUBLISHED, "pouct", BASELINES)
    for axes, baseline in zip(figure.axes, BASELINES, strict=True):
        heights = [bar.get_height() for bar in axes.patches]
        printed = [PUBLISHED.improvement_of("pouct", baseline, cell) for cell in summary.cells]
        ours = [summary.comparisons[cell, "pouct", baseline].improvement.value for cell in summary.cells]
        assert heights == pytest.approx([*printed, *ours])


def test_mean_cost_lines(summary):
    figure = overview_charts.mean_costs(summary, PUBLISHED)
    heights = [tuple(line.get_ydata()) for line in figure.axes[0].lines]
    means = tuple(summary.planner_cells[("small", robots), "greedy"].cost_cells.value for robots in (1, 2, 3))
    assert (215.22, 145.67, 130.86) in heights and means in heights


def test_planning_times(episodes, summary):
    axes = overview_charts.planning_times(episodes, summary.planners).axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == list(summary.planners)
    assert len(axes.patches) == 3 * len(summary.planners)


def test_sweep_has_the_values_as_ticks(summary):
    variants = {f"planner.pouct.samples={count}": summary for count in (10, 1000)}
    axes = overview_charts.sweep(variants, "pouct", BASELINES).axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["10", "1000"]
    assert axes.get_xlabel() == "planner.pouct.samples"
    mixed = overview_charts.sweep({"a=1,b=2": summary, "": summary}, "pouct", BASELINES).axes[0]
    assert [label.get_text() for label in mixed.get_xticklabels()] == ["a=1\nb=2", "as configured"]


def test_nothing_to_draw(summary):
    empty = checked_episodes(make_episodes(1).head(0))
    none = summarise(empty)
    assert overview_charts.scatter(empty, none, "pouct", BASELINES) is None
    assert overview_charts.mean_costs(none, PUBLISHED) is None
    assert overview_charts.improvements(none, PUBLISHED, "pouct", BASELINES) is None
    assert overview_charts.planning_times(empty, ()) is None
    assert overview_charts.sweep({"": summary}, "pouct", BASELINES) is None
    failed = checked_episodes(rows("small", 1, {"pouct": [None], "learned_myopic": [1.0]}))
    assert overview_charts.scatter(failed, summarise(failed), "pouct", BASELINES) is None
    assert overview_charts.planning_times(failed, ("pouct",)) is None


def test_costs_of_zero_are_drawn():
    frame = checked_episodes(rows("small", 1, {"pouct": [0.0, 0.0], "learned_myopic": [0.0, 0.0]}))
    svg_bytes(overview_charts.scatter(frame, summarise(frame), "pouct", BASELINES))
    svg_bytes(overview_charts.improvements(summarise(frame), PUBLISHED, "pouct", BASELINES))


def test_files_are_the_same_each_time(summary):
    first, second = (Picture("costs", "Costs", "", overview_charts.mean_costs(summary, PUBLISHED)) for _ in range(2))
    assert ElementTree.fromstring(first.svg).tag.endswith("svg") and first.svg == second.svg
    assert first.uri == "data:image/svg+xml;base64," + base64.b64encode(first.svg).decode()
    pdf = first.pdf
    assert pdf.startswith(b"%PDF") and pdf == second.pdf
    assert b"/CreationDate" not in pdf and b"/Type3" not in pdf, "publishers refuse Type 3 fonts"


def test_many_points_stay_small():
    episodes = checked_episodes(make_episodes(850, ["learned_myopic", "pouct"], ["small"], [1, 2]))
    assert len(svg_bytes(overview_charts.scatter(episodes, summarise(episodes), "pouct", BASELINES))) < 400_000


def test_looks():
    looks = planner_looks(["pouct", "my.A", "my.B", "known"])
    assert len(set(looks.values())) == 4
    assert planner_label("my_lab.planners.Mine") == "Mine"


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0123, "12.3 ms"), (5, "5 s"), (125, "2 min 05 s"), (3725, "1 h 02 min"), (float("nan"), "\N{EN DASH}")],
)
def test_seconds(value, text):
    assert seconds(value) == text
