"""The parts of the gap: checked against sums by hand, and the ladder of planners whose steps they are."""

import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.page import exhibits
from mrtask.analysis.report.gap import draw_gaps, find_ladder, gap_sentences, gap_table, gaps_of
from mrtask.analysis.report.report_page import render_report
from mrtask.analysis.results.optimality import CellOptimality
from mrtask.analysis.results.statistics import ALL_TEAMS, EVERYTHING, UNDEFINED, Estimate, summarise

MODEL = {"source": "model", "uniform_mix": 0.0, "noise_sd": 0.0}
TRUTH = MODEL | {"source": "truth"}
BEHIND = {
    "learned_myopic": "learned_myopic",
    "few": "pouct",
    "pouct": "pouct",
    "noisy": "pouct",
    "truth": "pouct",
    "informed": "learned_myopic",
    "known": "known",
}
MANIFEST = {
    "behind": BEHIND,
    "likelihood": dict.fromkeys(BEHIND, MODEL)
    | {"truth": TRUTH, "informed": TRUTH, "noisy": MODEL | {"noise_sd": 1.0}},
    "planner_options": {
        name: {"samples": samples} for name, samples in {"few": 10, "pouct": 1000, "truth": 1000, "noisy": 9999}.items()
    },
}
LADDER = find_ladder(MANIFEST, tuple(BEHIND))


def episodes(seed=0, trials=12):
    """Every planner on the same trials of four cells, at random costs; one planner could not finish one trial."""
    rng = np.random.default_rng(seed)
    rows = [
        {
            "trial_id": f"{size_class}-{robots}-{number:03d}",
            "size_class": size_class,
            "robots": robots,
            "planner": planner,
            "status": "accepted",
            "cost_s": cost_s,
            "cost_cells": cost_s * 20,
        }
        for size_class in ("small", "large")
        for robots in (1, 2)
        for number in range(trials)
        for planner in BEHIND
        for cost_s in [rng.uniform(5, 50)]
    ]
    frame = pd.DataFrame(rows)
    lost = (frame["trial_id"] == "small-1-003") & (frame["planner"] == "few")
    frame.loc[lost, ["status", "cost_s", "cost_cells"]] = ["failed", np.nan, np.nan]
    return frame


def test_the_ladder_follows_likelihoods_and_samples():
    assert LADDER.truth == "truth" and LADDER.model == "pouct"
    assert set(LADDER.decided) == {"learned_myopic", "few", "pouct"}
    assert LADDER.informed == ("informed",)
    for missing in ("truth", "known"):
        assert find_ladder(MANIFEST, tuple(name for name in BEHIND if name != missing)) is None
    assert find_ladder({}, tuple(BEHIND)) is None


def test_parts_add_up_to_the_whole_of_the_trials_that_all_finished():
    frame = episodes()
    gaps = gaps_of(frame, summarise(frame), LADDER)
    assert [gap.cell for gap in gaps[::4]] == [
        EVERYTHING, ("small", ALL_TEAMS), ("large", ALL_TEAMS), ("small", 1), ("small", 2), ("large", 1), ("large", 2),
    ]  # fmt: skip
    costs = frame.pivot(index="trial_id", columns="planner", values="cost_cells").drop(index="small-1-003")
    for gap in gaps:
        start = (
            ""
            if gap.cell == EVERYTHING
            else gap.cell[0]
            if gap.cell[1] == ALL_TEAMS
            else f"{gap.cell[0]}-{gap.cell[1]}"
        )
        means = costs[costs.index.str.startswith(start)].mean()
        assert gap.whole.n == costs.index.str.startswith(start).sum()
        assert gap.whole.value == pytest.approx(100 * (means[gap.planner] / means["known"] - 1))
        assert sum(part.value for part in gap.parts) == pytest.approx(gap.whole.value, abs=1e-9)
        not_knowing, error, deciding = (part.value * means["known"] / 100 for part in gap.parts)
        assert not_knowing == pytest.approx(means["truth"] - means["known"])
        informed = gap.planner == "informed"
        assert error == pytest.approx(0 if informed else means["pouct"] - means["truth"])
        assert deciding == pytest.approx(means[gap.planner] - means["truth" if informed else "pouct"])
        assert all(part.low <= part.value <= part.high for part in (gap.whole, *gap.parts) if gap.planner == "few")


def test_an_interval_is_that_of_the_paired_difference():
    """A part that is the same on every trial is known exactly, however much the trials' costs differ."""
    frame = episodes()
    by_trial = frame[frame["planner"] == "known"].set_index("trial_id")["cost_cells"]
    for planner, share in (("truth", 1.2), ("pouct", 1.5)):
        own = frame["planner"] == planner
        frame.loc[own, "cost_cells"] = frame.loc[own, "trial_id"].map(by_trial) * share
    gap = next(one for one in gaps_of(frame, summarise(frame), LADDER) if one.planner == "pouct")
    for part, expected in zip((gap.whole, *gap.parts), (50, 20, 30, 0), strict=True):
        assert (part.low, part.value, part.high) == pytest.approx((expected,) * 3, abs=1e-6)


def test_the_table_has_the_certified_bound_where_there_is_one():
    frame = episodes()
    bound = CellOptimality(
        ("small", 2), "pouct", *[UNDEFINED] * 3, Estimate(7.25, 3.0, 9.0, 20), UNDEFINED, 0.0, 0.0, 0
    )
    gaps = gaps_of(frame, summarise(frame), LADDER, [bound])
    table = gap_table(gaps)
    assert table.columns[-1] == ("certified", "above bound")
    shown = [row.entries[-1].value for row in table.rows if row.entries]
    assert shown.count("7.2 %") == 1 and len(set(shown)) == 2
    assert gap_table(gaps_of(frame, summarise(frame), LADDER)).columns[-1][0] == "of which"
    assert len(draw_gaps(gaps).axes) == 2
    sentences = gap_sentences(gaps)
    assert len(sentences) == 4 and all("more than knowing everything" in one for one in sentences)


def test_the_section_is_in_the_report_of_a_run_that_has_the_ladder(monkeypatch):
    monkeypatch.setattr(exhibits, "svg_bytes", lambda figure: b"")
    frame = episodes(trials=4)
    assert 'id="gap"' in render_report(frame, MANIFEST | {"true_likelihoods": "counted"}, {}).page
    assert 'id="gap"' not in render_report(frame, {}, {}).page
