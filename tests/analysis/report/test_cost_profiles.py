import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.report.cost_profiles import MAX_STEPS, cost_ratios, draw_costs, draw_profile, profile_table
from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.statistics import summarise
from tests.analysis.synthetic import make_episodes, rows


def test_ratios_by_hand():
    costs = {
        "learned_myopic": [2.0, 3.0, None, None, 0.0],
        "pouct": [4.0, 3.0, 5.0, None, 1.0],
        "known": [1.0, 1.0, 1.0, 1.0, 0.0],
    }
    frame = pd.concat([rows("small", 1, costs), rows("large", 1, {"pouct": [1.0]})])
    found = cost_ratios(checked_episodes(frame))
    assert found.planners == ("learned_myopic", "pouct"), "one that knows everything takes no part"
    inf = np.inf
    expected = [[1, 2], [1, 1], [inf, 1], [1, inf]]
    assert found.ratios.tolist() == expected, "nobody finished the fourth; the large home's was run by one alone"
    assert found.within(1.0).tolist() == [75, 50] and found.within(2.0).tolist() == [75, 75]
    assert found.finished.tolist() == [75, 100]
    table = profile_table(found)
    assert [entry.value for entry in table.rows[1].entries] == ["50 %", "50 %", "50 %", "50 %", "75 %", "100 %"]


def test_nothing_to_compare():
    assert cost_ratios(checked_episodes(make_episodes(2, ["pouct"]))) is None
    apart = pd.concat([rows("small", 1, {"pouct": [1.0]}), rows("large", 1, {"greedy": [1.0]})])
    assert cost_ratios(checked_episodes(apart)) is None, "no trial was run by both"
    assert cost_ratios(checked_episodes(rows("small", 1, {"pouct": [None], "greedy": [None]}))) is None
    assert profile_table(None) is None
    failed = checked_episodes(rows("small", 1, {"pouct": [None]}))
    assert draw_costs(failed, summarise(failed)) is None


def share_below(line, x: float) -> float:
    places, shares = line.get_data()
    return shares[np.flatnonzero(np.asarray(places) <= x)[-1]]


@pytest.mark.parametrize("trials", [7, 3 * MAX_STEPS])
def test_curves_are_shares(trials):
    frame = make_episodes(trials, ["learned_myopic", "pouct"], ["small"], [2])
    frame.loc[frame["trial_id"] < "small-2-003", ["status", "cost_s", "cost_cells"]] = ["failed", np.nan, np.nan]
    frame = checked_episodes(frame)
    tolerance = 100 / MAX_STEPS if trials > MAX_STEPS else 1e-9
    [axes] = draw_costs(frame, summarise(frame)).axes
    own = frame.loc[frame["planner"] == "pouct", "cost_cells"]
    for x in (0.0, *own.quantile([0.2, 0.5, 0.9])):
        assert share_below(axes.lines[1], x) == pytest.approx(100 * (own <= x).sum() / trials, abs=tolerance)
    assert axes.lines[1].get_ydata()[-1] <= 100 * (trials - 3) / trials + 1e-9, "failures never arrive"
    ratios = cost_ratios(frame)
    [axes] = draw_profile(ratios).axes
    assert share_below(axes.lines[1], 1.5) == pytest.approx(ratios.within(1.5)[1], abs=tolerance)


def test_a_cell_that_did_not_run_or_finish_says_so():
    frame = pd.concat([rows("small", 1, {"pouct": [1.0]}), rows("large", 2, {"pouct": [None]})])
    frame = checked_episodes(frame)
    texts = [text.get_text() for axes in draw_costs(frame, summarise(frame)).axes for text in axes.texts]
    assert texts == ["not run", "not run", "nothing finished"]
