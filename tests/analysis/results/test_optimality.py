import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.report.cell_tables import optimality_table
from mrtask.analysis.results.optimality import summarise_optimality
from tests.analysis.synthetic import in_homes


def make_rows(trials=12, robots=(1, 2)):
    return pd.DataFrame(
        [
            {
                "trial_id": f"small-{team}-{number:03d}",
                "size_class": "small",
                "robots": team,
                "planner": "pouct",
                "failed": 1 if number == 0 else 0,
                "cost_s": 10.0 + number,
                "bound_s": (10.0 + number) / 1.25 if number < 3 else (10.0 + number) / 1.1,
                "clairvoyant_s": 5.0,
                "kind": "exact" if number % 2 else "penalised",
                "bound_seconds": 0.5,
            }
            for team in robots
            for number in range(trials)
        ]
    )


def test_gaps_of_means_and_of_the_median_trial():
    rows = make_rows()
    one, two = summarise_optimality(rows)
    assert (one.cell, two.cell) == (("small", 1), ("small", 2))
    own = rows[rows["robots"] == 1]
    assert one.gap_percent.value == pytest.approx(100 * (own["cost_s"].mean() / own["bound_s"].mean() - 1))
    assert one.gap_percent.low < one.gap_percent.value < one.gap_percent.high
    assert one.median_gap_percent.value == pytest.approx(10)
    assert one.median_gap_percent.low == pytest.approx(10)
    assert (one.exact_share, one.bound_seconds, one.failed) == (0.5, 0.5, 1)


def test_too_few_trials_have_no_interval_and_unfinished_ones_do_not_count():
    rows = make_rows(trials=4, robots=(1,))
    rows.loc[0, ["cost_s", "bound_s"]] = np.nan
    (cell,) = summarise_optimality(rows)
    assert cell.gap_percent.n == 3
    assert not cell.gap_percent.has_interval
    assert not cell.median_gap_percent.has_interval


def test_the_table_says_cell_gap_and_interval():
    table = optimality_table(summarise_optimality(make_rows()))
    assert [row.label for row in table.rows] == ["small, 1 robot", "small, 2 robots"]
    shown = dict(zip([column[1] for column in table.columns], table.rows[0].entries, strict=True))
    assert shown["median trial"].value == "10.0 %"
    assert shown["median trial"].details == ("[10.0, 17.5]",)
    assert shown["exact"].value == "50 %"


def test_repeating_trials_in_their_homes_narrows_no_interval():
    rows = make_rows(15, (1,))
    rows["bound_s"] = rows["cost_s"] / np.random.default_rng(0).uniform(1.0, 1.5, len(rows))
    (once,), (thrice,) = (summarise_optimality(each) for each in (rows, in_homes(rows, 3)))
    for name in ("cost_s", "gap_percent", "median_gap_percent"):
        one, other = getattr(once, name), getattr(thrice, name)
        assert (other.low, other.high) == pytest.approx((one.low, one.high)) and one.low < one.high
        assert (other.n, other.homes) == (3 * one.n, one.n)
