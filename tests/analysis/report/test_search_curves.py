"""The anytime curve and the curves by team size show the means of the same trials."""

import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.report import search_curves
from mrtask.analysis.results.episodes import checked_episodes
from tests.analysis.synthetic import fail, make_episodes

BUDGETS = (10, 100, 1000)


def sweep(rise: float = 1.0) -> pd.DataFrame:
    """`pouct` gets cheaper with its budget; the others are the same in every cell of the sweep."""
    cells = []
    for index, budget in enumerate(BUDGETS):
        frame = make_episodes(12, size_classes=["small"], robots=[1, 2])
        own = frame["planner"] == "pouct"
        frame.loc[own, ["cost_s", "cost_cells"]] *= 1 + rise / 10**index
        frame[search_curves.BUDGET] = np.where(own, budget, np.nan)
        cells.append(frame.assign(sweep=f"planner.pouct.samples={budget}"))
    return checked_episodes(pd.concat(cells, ignore_index=True))


def test_the_curve_has_the_mean_of_the_trials_that_all_finished():
    episodes = sweep()
    lost = episodes[(episodes["planner"] == "greedy") & (episodes["robots"] == 2)]["trial_id"].iloc[0]
    episodes.loc[(episodes["planner"] == "greedy") & (episodes["trial_id"] == lost), "cost_cells"] = np.nan
    figure = search_curves.draw_sample_curves(search_curves.sample_curves(episodes, "pouct"))
    upper, lower = figure.axes[1], figure.axes[3]
    assert upper.get_title() == "2 robots, 11 trials"
    kept = episodes[(episodes["robots"] == 2) & (episodes["trial_id"] != lost)]
    means = kept.groupby(["planner", search_curves.BUDGET], dropna=False)["cost_cells"].mean()
    drawn = {tuple(line.get_xdata()): line.get_ydata() for line in upper.lines}
    assert drawn[BUDGETS] == pytest.approx([means["pouct", budget] for budget in BUDGETS])
    level = [line.get_ydata()[0] for line in upper.lines if line.get_linestyle() == "--"]
    [greedy] = kept.loc[kept["planner"] == "greedy"].groupby("sweep")["cost_cells"].mean().unique()
    assert any(value == pytest.approx(greedy) for value in level)
    above = next(line.get_ydata() for line in lower.lines if tuple(line.get_xdata()) == BUDGETS)
    assert above == pytest.approx([100 * (2.0 / 1.01 - 1), 100 * (1.1 / 1.01 - 1), 0])


def test_no_curve_without_several_budgets_or_when_more_was_swept():
    episodes = sweep()
    assert (
        search_curves.sample_curves(
            episodes[episodes[search_curves.BUDGET].isin([10]) | episodes[search_curves.BUDGET].isna()], "pouct"
        )
        is None
    )
    assert search_curves.sample_curves(episodes.drop(columns=search_curves.BUDGET), "pouct") is None
    other = episodes.assign(cost_cells=episodes["cost_cells"] + 1, variant="other")
    assert search_curves.sample_curves(pd.concat([episodes, other]), "pouct") is None


def test_by_team_where_search_helps():
    frame = checked_episodes(make_episodes(40, size_classes=["small"], robots=[1, 2, 3, 4]))
    own, rule = ((frame["planner"] == name).to_numpy() for name in ("pouct", "greedy"))
    costs = frame.loc[rule, ["cost_s", "cost_cells"]].to_numpy()
    few = (frame.loc[rule, "robots"] <= 2).to_numpy()[:, None]
    frame.loc[own, ["cost_s", "cost_cells"]] = np.where(few, 0.8 * costs, costs)
    worth = search_curves.worth_by_team(frame, "pouct", "greedy")
    assert worth == search_curves.Worth(clear=(1, 2), unclear=(3, 4))
    figure = search_curves.by_team(frame, "pouct")
    lines = [line.get_ydata() for line in figure.axes[1].lines]
    assert any(np.shape(each) == (4,) and each == pytest.approx([20, 20, 0, 0]) for each in lines)
    assert search_curves.worth_by_team(frame[~rule], "pouct", "greedy") is None
    assert search_curves.by_team(frame[frame["robots"] <= 3], "pouct") is None


def test_unfinished_trials_are_in_no_panel():
    frame = make_episodes(12, size_classes=["small"], robots=[1, 2, 3, 4])
    frame = checked_episodes(fail(frame, (frame["planner"] == "greedy") & (frame["robots"] == 4)))
    assert search_curves.by_team(frame, "pouct") is not None
    assert search_curves.worth_by_team(frame, "pouct", "greedy").unclear[-1] == 4
