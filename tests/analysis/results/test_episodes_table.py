import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.results.episodes import (
    REQUIRED_COLUMNS,
    checked_episodes,
    natural_key,
    size_classes_in_order,
    variants_in_order,
)
from tests.analysis.synthetic import make_episodes, rows


def change(**values):
    frame = make_episodes(2, ("pouct",), ("small",), (1,))
    for column, value in values.items():
        frame[column] = value
    return frame


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (change().drop(columns=["cost_s", "robots"]), "lack the columns robots, cost_s; needed are trial_id"),
        (change(status="done"), "unknown episode status 'done'; allowed are accepted, failed, error, timeout"),
        (change(robots=0), "has 0 robots; a team has at least one"),
        (change(cost_s=np.nan), "small-1-000 of pouct has cost_s nan; an accepted episode's cost is a number >= 0"),
        (change(cost_cells=-1.0), "has cost_cells -1.0"),
        (change(cost_s=np.inf), "has cost_s inf"),
        (change(trial_id="small-1-000"), "1 episodes occur twice, the first is small-1-000 of pouct"),
    ],
)
def test_refuses(frame, message):
    with pytest.raises(ValueError, match=message.replace("(", r"\(")):
        checked_episodes(frame)


def test_costs_count_only_when_accepted():
    frame = checked_episodes(change(status="timeout"))
    assert frame["cost_s"].isna().all() and frame["cost_cells"].isna().all()


def test_takes_columns_of_nulls():
    frame = checked_episodes(rows("small", 1, {"pouct": [None, None]}))
    assert frame["cost_s"].dtype == np.float64
    assert len(checked_episodes(pd.DataFrame(columns=list(REQUIRED_COLUMNS)))) == 0


def test_leaves_its_input_alone():
    frame = change(sweep="a=1")
    before = frame.copy()
    checked_episodes(frame)
    pd.testing.assert_frame_equal(frame, before)


def sweep_of(*labels):
    parts = [rows("small", team, {"pouct": [1.0]}).assign(sweep=label) for label, team in labels]
    return variants_in_order(checked_episodes(pd.concat(parts)))


def test_overrides_that_columns_say_make_no_variant():
    labels = [
        ("planner.pouct.samples=1000,evaluation.robots=[1,2]", 1),
        ("planner.pouct.samples=1000,evaluation.robots=[3]", 3),
        ("evaluation.robots=[1,2],planner.pouct.samples=200", 1),
    ]
    assert sweep_of(*labels) == ["planner.pouct.samples=200", "planner.pouct.samples=1000"]


def test_variants_stay_apart_where_their_trials_overlap():
    labels = ["evaluation.robots=[1],seed=1", "evaluation.robots=[1,2],seed=1"]
    assert sweep_of(*((label, 1) for label in labels)) == sorted(labels, key=natural_key)


def test_no_sweep_is_one_variant():
    assert sweep_of((None, 1), ("", 2)) == [""]


def test_order():
    assert sorted(["s=1e4", "s=200", "s=1000"], key=natural_key) == ["s=200", "s=1000", "s=1e4"]
    assert size_classes_in_order(["large", "hall", "small"]) == ["small", "large", "hall"]
