"""The page of a sensitivity study: one curve for each factor."""

import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.studies.sensitivity import (
    COMPARED,
    Curve,
    Point,
    curve_table,
    draw_curve,
    findings,
    render_sensitivity,
)
from tests.analysis.synthetic import in_homes


def episodes(saved_percent, trials=24, seed=0):
    """Our planner saves this share of each baseline's cost, give or take two per cent."""
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(trials):
        base = rng.uniform(80, 120)
        for planner in COMPARED:
            saved = 1 - saved_percent / 100 if planner == "pouct" else 1.0
            cost = base * saved * rng.uniform(0.98, 1.02)
            size_class = ("small", "large")[number % 2]
            rows.append((f"{size_class}-1-{number:03d}", size_class, 1, planner, "accepted", cost / 20, cost))
    return pd.DataFrame(rows, columns=["trial_id", "size_class", "robots", "planner", "status", "cost_s", "cost_cells"])


@pytest.fixture(scope="module")
def curves():
    steady = tuple(Point(value, episodes(30, seed=int(value))) for value in (10.0, 100.0, 1000.0))
    falling = tuple(Point(value, episodes(saved, seed=1)) for value, saved in ((0.0, 20), (0.5, 0), (1.0, -20)))
    return [Curve("samples", "planner.pouct.samples", steady), Curve("noise", "likelihood.noise_sd", falling)]


def test_a_point_compares_the_trials_that_all_planners_finished():
    frame = episodes(25)
    lost = (frame["trial_id"] == "small-1-000") & (frame["planner"] == "learned_myopic")
    frame.loc[lost, ["status", "cost_s", "cost_cells"]] = ["failed", np.nan, np.nan]
    point = Point(1.0, frame)
    assert point.trials == 23
    means = frame[frame["trial_id"] != "small-1-000"].groupby("planner")["cost_cells"].mean()
    found = point.improvement("nonlearned_myopic")
    assert found.value == pytest.approx(100 * (1 - means["pouct"] / means["nonlearned_myopic"]))
    assert found.low < found.value < found.high
    large = point.improvement("nonlearned_myopic", "large")
    assert large.n == 12 and large.value != found.value


def test_repeating_trials_in_their_homes_narrows_no_interval():
    once, thrice = (Point(1.0, frame) for frame in (episodes(25), in_homes(episodes(25), 3)))
    for estimate in (lambda point: point.improvement("learned_myopic"), lambda point: point.cost("pouct")):
        one, other = estimate(once), estimate(thrice)
        assert (other.low, other.high) == pytest.approx((one.low, one.high)) and other.n == 3 * one.n


def test_the_answer_says_where_the_planner_is_better_and_where_not(curves):
    found = findings(curves)
    assert found.verdict == "4 of 6"
    steady, falling = found.sentences
    assert "not clearly better" not in steady
    assert "over learned_myopic 20" in falling and "at 0 and" in falling
    assert falling.endswith("not clearly better than nonlearned_myopic at 0.5, 1 and learned_myopic at 0.5, 1.")


def test_tables_and_curves_have_every_value(curves):
    table = curve_table(curves[1])
    assert [lower for _, lower in table.columns] == ["0", "0.5", "1"]
    by_label = [row for row in table.rows if row.label == "all"]
    assert [entry.tone for entry in by_label[0].entries] == ["good", "", "bad"]
    axes = draw_curve(curves[0]).axes
    assert [one.get_xscale() for one in axes] == ["log", "log"]
    assert {one.get_xscale() for one in draw_curve(curves[1]).axes} == {"linear"}
    line = axes[0].get_lines()[0]
    assert line.get_ydata() == pytest.approx([point.improvement(COMPARED[0]).value for point in curves[0].points])


def test_names_are_text_on_the_page(curves):
    evil = Curve("<script>alert(1)</script>", "a.b", curves[0].points)
    page = render_sensitivity([evil, curves[1]], "<b>test</b>")
    assert "<script>alert" not in page and "<b>test" not in page
    assert page.count("data:image/svg+xml") == 2
