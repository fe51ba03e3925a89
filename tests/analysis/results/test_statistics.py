import numpy as np
import pandas as pd
import pytest
from scipy import stats

from mrtask.analysis.results import statistics as library
from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.statistics import (
    ALL_CLASSES,
    ALL_TEAMS,
    Bootstrap,
    PairedCosts,
    compare,
    improvement_percent,
    summarise,
)
from mrtask.planning.planners import planners_in_order
from tests.analysis.synthetic import fail, in_homes, make_episodes, naive_bca, rows

NAN = float("nan")
SMALL_ONE = ("small", 1)


def paired_costs(n, seed=0, spread=0.4):
    rng = np.random.default_rng(seed)
    baseline = rng.gamma(3, 10, n)
    return baseline * 0.7 * rng.lognormal(0, spread, n), baseline


def test_improvement_is_of_the_means():
    assert improvement_percent(np.array([1.0, 9.0]), np.array([2.0, 10.0])).value == pytest.approx(100 * (1 - 10 / 12))


def test_improvement_without_spread():
    baseline = 2.0 ** np.arange(12)
    estimate = improvement_percent(baseline / 2, baseline)
    assert (estimate.value, estimate.low, estimate.high, estimate.n) == (50, 50, 50, 12)
    same = improvement_percent(baseline, baseline)
    assert (same.value, same.low, same.high) == (0, 0, 0)


@pytest.mark.parametrize(("n", "has_value"), [(0, False), (1, True), (9, True)])
def test_too_few_trials_for_an_interval(n, has_value):
    estimate = improvement_percent(np.ones(n), np.full(n, 2.0))
    assert estimate.defined == has_value and np.isnan([estimate.low, estimate.high]).all() and estimate.n == n


def test_improvement_over_nothing_is_undefined():
    assert not improvement_percent(np.zeros(4), np.zeros(4)).defined


@pytest.mark.parametrize(("n", "seed"), [(10, 1), (23, 2), (60, 3)])
def test_interval_equals_its_naive_twin(n, seed):
    cost, baseline = paired_costs(n, seed)
    estimate = Bootstrap(np.column_stack([cost, baseline]), resamples=300, seed=seed).estimate(
        library.improvement_of_means
    )
    assert (estimate.low, estimate.high) == pytest.approx(naive_bca(cost.tolist(), baseline.tolist(), 300, seed))


@pytest.mark.parametrize(("n", "spread"), [(15, 0.8), (100, 0.4)])
def test_interval_agrees_with_scipys(n, spread):
    cost, baseline = paired_costs(n, 7, spread)
    ours = improvement_percent(cost, baseline)

    def statistic(a, b, axis=-1):
        return 100 * (1 - a.mean(axis=axis) / b.mean(axis=axis))

    options = {"paired": True, "vectorized": True, "n_resamples": 20_000, "rng": np.random.default_rng(1)}
    theirs = stats.bootstrap((cost, baseline), statistic, method="BCa", **options).confidence_interval
    assert (ours.low, ours.high) == pytest.approx(tuple(theirs), abs=0.06 * (theirs.high - theirs.low))


def test_interval_covers_the_truth_as_often_as_it_says():
    covered = 0
    for seed in range(300):
        cost, baseline = paired_costs(50, seed)
        estimate = Bootstrap(np.column_stack([cost, baseline]), resamples=500).estimate(library.improvement_of_means)
        covered += estimate.low <= 100 * (1 - 0.7 * np.exp(0.4**2 / 2)) <= estimate.high
    assert 0.90 <= covered / 300 <= 0.98


def test_batches_draw_the_same_trials(monkeypatch):
    whole = improvement_percent(*paired_costs(40))
    monkeypatch.setattr(library, "MAX_BATCH_CELLS", 1000)
    assert improvement_percent(*paired_costs(40)) == whole


def test_comparison_by_hand():
    cost = np.array([1.0, 5.0, 3.0, NAN, 2.0, NAN, 8.0])
    baseline = np.array([2.0, 4.0, 3.0 + 1e-9, 9.0, NAN, NAN, NAN])
    found = compare(cost, baseline)
    assert (found.wins, found.ties, found.losses) == (1, 1, 1)
    assert (found.only_planner, found.only_baseline) == (2, 1)
    assert found.improvement.n == 3 and found.improvement.value == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("saved", [[1, 2, -3, 4, 5], [0, 0, 1, 1, -2, 3], [2, 2, 2, -2, 0], [-1, -1, 0, 0, -3, 4]])
def test_wilcoxon_of_few_trials_is_scipys(saved):
    expected = stats.wilcoxon(np.array(saved, dtype=float), zero_method="zsplit").pvalue
    found = compare(np.zeros(len(saved)), np.array(saved, dtype=float))
    assert found.p_value == pytest.approx(expected)
    decided = np.array([value for value in saved if value], dtype=float)
    assert found.p_value_without_ties == pytest.approx(stats.wilcoxon(decided, method=stats.PermutationMethod()).pvalue)


def test_wilcoxon_without_ties_of_many_trials_is_scipys_default():
    saved = np.concatenate([np.zeros(30), np.random.default_rng(3).normal(0.2, 1, 80)])
    found = compare(np.zeros(len(saved)), saved)
    assert found.p_value_without_ties == pytest.approx(stats.wilcoxon(saved).pvalue)
    assert found.p_value == pytest.approx(stats.wilcoxon(saved, zero_method="zsplit").pvalue)
    assert compare(np.ones(20), np.ones(20)).p_value_without_ties == 1


def test_wilcoxon_by_hand():
    # All five differences point one way: of the 2^5 signs, only this one and its mirror are as extreme.
    assert compare(np.arange(5.0), np.arange(5.0) + np.arange(1, 6)).p_value == pytest.approx(2 / 32)
    assert compare(np.ones(9), np.ones(9)).p_value == 1
    assert np.isnan(compare(np.ones(1), np.zeros(1)).p_value)


def test_gap_by_hand():
    frame = rows(
        "small", 1, {"learned_myopic": [8.0, 12.0], "known": [3.0, 5.0], "pouct": [6.0, 8.0], "greedy": [12.0, 14.0]}
    )
    gaps = summarise(checked_episodes(frame)).gaps
    assert gaps[SMALL_ONE, "pouct"].value == pytest.approx(50)
    assert gaps[SMALL_ONE, "greedy"].value == pytest.approx(-50)
    assert (SMALL_ONE, "learned_myopic") not in gaps and (SMALL_ONE, "known") not in gaps


def test_a_gap_of_zero_is_undefined():
    frame = rows("small", 1, {"learned_myopic": [4.0, 4.0], "known": [4.0, 4.0], "pouct": [3.0, 5.0]})
    assert not summarise(checked_episodes(frame)).gaps[SMALL_ONE, "pouct"].defined


def test_failures_are_counted_and_in_no_mean():
    frame = rows("small", 1, {"pouct": [1.0, None, 3.0, 5.0], "learned_myopic": [2.0, 100.0, None, 7.0]})
    summary = summarise(checked_episodes(frame))
    pouct = summary.planner_cells[SMALL_ONE, "pouct"]
    assert pouct.counts == {"accepted": 3, "failed": 1, "error": 0, "timeout": 0}
    assert (pouct.episodes, pouct.accepted, pouct.cost_s, pouct.cost_cells.value) == (4, 3, 3.0, 60.0)
    found = summary.comparisons[SMALL_ONE, "pouct", "learned_myopic"]
    assert found.improvement.value == pytest.approx(100 * (1 - 6 / 9)) and found.improvement.n == 2
    assert (found.only_planner, found.only_baseline) == (1, 1)


def test_summary_against_a_naive_twin():
    frame = make_episodes(15, size_classes=["small", "medium"], robots=[1, 3])
    frame = fail(frame, frame.index.to_series() % 11 == 3)
    summary = summarise(checked_episodes(frame))
    cost = {(row.trial_id, row.planner): row.cost_s for row in frame.itertuples() if row.status == "accepted"}
    trials = {row.trial_id: (row.size_class, row.robots) for row in frame.itertuples()}
    for cell in [*summary.cells, ("medium", ALL_TEAMS), (ALL_CLASSES, ALL_TEAMS)]:
        members = [t for t, (c, r) in trials.items() if cell[0] in (c, ALL_CLASSES) and cell[1] in (r, ALL_TEAMS)]
        for planner, baseline in (("pouct", "learned_myopic"), ("greedy", "nonlearned_myopic"), ("known", "greedy")):
            both = [t for t in members if (t, planner) in cost and (t, baseline) in cost]
            ratio = sum(cost[t, planner] for t in both) / sum(cost[t, baseline] for t in both)
            found = summary.comparisons[cell, planner, baseline].improvement
            assert (found.n, found.value) == (len(both), pytest.approx(100 * (1 - ratio)))
            assert found.low < found.value < found.high


def test_shared_draws_change_nothing():
    """An estimate does not depend on the other planners of its cell."""
    frame = fail(make_episodes(20, size_classes=["small"], robots=[1]), pd.Series([True] + [False] * 119))
    whole = summarise(checked_episodes(frame))
    cost = frame.pivot(index="trial_id", columns="planner", values="cost_s")[["pouct", "learned_myopic"]].dropna()
    alone = improvement_percent(cost["pouct"].to_numpy(), cost["learned_myopic"].to_numpy())
    shared = whole.comparisons[SMALL_ONE, "pouct", "learned_myopic"].improvement
    assert (shared.value, shared.low, shared.high) == pytest.approx((alone.value, alone.low, alone.high), rel=1e-12)


def test_each_estimate_is_over_the_trials_that_its_planners_finished():
    frame = pd.DataFrame({"a": [1.0, 2.0, NAN], "b": [2.0, NAN, 6.0], "c": [4.0, 4.0, 4.0]})
    costs = PairedCosts(frame, pd.Series(["x", "y", "z"]))
    assert [costs.mean(name).value for name in "abc"] == [1.5, 4.0, 4.0]
    assert (costs.improvement("a", "b").value, costs.improvement("a", "b").n) == (50, 1)
    assert (costs.improvement("a", "c").value, costs.above("c", "b").value) == (62.5, 0)


def intervals(estimate):
    return (estimate.value, estimate.low, estimate.high)


@pytest.mark.parametrize("homes", [11, 30])
def test_homes_are_resampled_with_all_of_their_trials(homes):
    """Homes of one to four trials, against a naive twin in exact fractions."""
    sizes = 1 + np.arange(homes) % 4
    cost, baseline = paired_costs(sizes.sum(), homes)
    home_of = np.repeat(np.arange(homes), sizes)
    mixed = np.random.default_rng(homes).permutation(len(home_of))
    first = pd.unique(home_of[mixed])
    estimate = Bootstrap(np.column_stack([cost, baseline])[mixed], home_of[mixed], resamples=300, seed=2).estimate(
        library.improvement_of_means
    )
    groups = [np.flatnonzero(home_of == home) for home in first]
    expected = naive_bca(cost.tolist(), baseline.tolist(), 300, 2, groups)
    assert (estimate.low, estimate.high) == pytest.approx(expected)
    assert (estimate.n, estimate.homes) == (sizes.sum(), homes)


def test_repeating_trials_in_their_homes_narrows_no_interval():
    frame = make_episodes(12, size_classes=["small", "large"], robots=[1, 2])
    once, thrice = (summarise(checked_episodes(each)) for each in (frame, in_homes(frame, 3)))
    for key, found in once.comparisons.items():
        assert intervals(thrice.comparisons[key].improvement) == pytest.approx(intervals(found.improvement))
        assert thrice.comparisons[key].p_value == pytest.approx(found.p_value)
        assert thrice.comparisons[key].by_home.won == found.wins
        assert thrice.comparisons[key].wins == 3 * found.wins
    for key, gap in once.gaps.items():
        assert intervals(thrice.gaps[key]) == pytest.approx(intervals(gap))
    for key, cell in once.planner_cells.items():
        assert intervals(thrice.planner_cells[key].cost_cells) == pytest.approx(intervals(cell.cost_cells))
        assert (thrice.planner_cells[key].cost_cells.n, cell.cost_cells.homes) == (
            3 * cell.cost_cells.n,
            cell.cost_cells.n,
        )


def test_homes_that_do_not_repeat_change_nothing():
    frame = make_episodes(15, size_classes=["small"], robots=[1])
    one, other = (summarise(checked_episodes(each)) for each in (frame, frame.drop(columns="home_id")))
    assert repr(one) == repr(other)
    assert one.comparisons[SMALL_ONE, "pouct", "learned_myopic"].by_home is None


def test_intervals_over_homes_cover_what_intervals_over_trials_miss():
    covered = {"homes": 0, "trials": 0}
    for seed in range(200):
        rng = np.random.default_rng(seed)
        ratio = np.repeat(0.7 * rng.lognormal(0, 0.3, 25), 8)
        baseline = rng.gamma(3, 10, 200)
        costs = np.column_stack([baseline * ratio * rng.lognormal(0, 0.2, 200), baseline])
        truth = 100 * (1 - 0.7 * np.exp((0.3**2 + 0.2**2) / 2))
        for name, homes in (("homes", np.repeat(np.arange(25), 8)), ("trials", None)):
            found = Bootstrap(costs, homes, resamples=400).estimate(library.improvement_of_means)
            covered[name] += found.low <= truth <= found.high
    assert covered["homes"] > 0.88 * 200
    assert covered["trials"] < 0.8 * 200


@pytest.mark.parametrize(("homes", "has_interval"), [(1, True), (2, False), (9, False), (10, True)])
def test_few_homes_say_nothing_of_others_and_one_home_only_of_itself(homes, has_interval):
    cost, baseline = paired_costs(60)
    found = improvement_percent(cost, baseline, np.arange(60) % homes)
    assert (found.has_interval, found.homes) == (has_interval, homes)
    if homes == 1:
        assert intervals(found) == intervals(improvement_percent(cost, baseline))


def test_order_of_rows_does_not_matter():
    frame = make_episodes(6, size_classes=["small"], robots=[1, 2])
    assert repr(summarise(checked_episodes(frame.sample(frac=1, random_state=1)))) == repr(
        summarise(checked_episodes(frame))
    )


def test_cells_that_were_not_run_are_absent():
    frame = pd.concat([make_episodes(2, ("pouct",), ("large",), (3,)), make_episodes(2, ("pouct",), ("small",), (1,))])
    assert summarise(checked_episodes(frame)).cells == [("small", 1), ("large", 3)]


def test_no_episodes():
    summary = summarise(checked_episodes(make_episodes(1).head(0)))
    assert summary.planners == () and summary.cells == [] and summary.planner_cells == {}


def test_planning_time_per_decision():
    frame = rows("small", 1, {"pouct": [1.0, 2.0, 3.0]}).assign(planning_s=[1.0, 5.0, None], decisions=[1, 2, 3])
    assert summarise(checked_episodes(frame)).planner_cells[SMALL_ONE, "pouct"].decision_s == 2.0


def test_planner_order():
    names = ["known", "pouct", "my_lab.Mine", "learned_myopic", "nonlearned_myopic"]
    assert planners_in_order(names) == ("nonlearned_myopic", "learned_myopic", "pouct", "my_lab.Mine", "known")
