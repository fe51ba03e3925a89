import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.report.by_template import draw_templates, results_by_template, template_table
from mrtask.analysis.report.wins import draw_wins
from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.statistics import ALL_TEAMS, summarise
from tests.analysis.synthetic import make_episodes, rows


@pytest.fixture
def frame():
    first = rows("small", 1, {"pouct": [1.0, 3.0, None], "learned_myopic": [2.0, 6.0, 4.0]}).assign(template="seq2")
    second = rows("large", 2, {"pouct": [7.0], "learned_myopic": [7.0]}).assign(template="own")
    return checked_episodes(pd.concat([second, first]))


def test_templates_by_hand(frame):
    results = results_by_template(frame, "pouct")
    assert results.size_classes == ("seq2", "own"), "ours first"
    seq2 = ("seq2", ALL_TEAMS)
    found = results.planner_cells[seq2, "pouct"]
    assert (found.episodes, found.accepted, found.cost_cells.value) == (3, 2, 40.0)
    assert results.improvement(seq2, "pouct", "learned_myopic").value == pytest.approx(50)
    assert results.comparisons[seq2, "pouct", "learned_myopic"].only_baseline == 1
    assert not results.improvement(seq2, "pouct", "greedy").defined
    table = template_table(results, "pouct")
    assert [row.label for row in table.rows] == ["seq2: a then b", "own"]
    assert [column[1] for column in table.columns] == ["run", "finished", "cells", "learned_myopic"]
    [axes] = draw_templates(results, "pouct").axes
    assert axes.lines[0].get_xdata().tolist() == pytest.approx([50, 0])


def test_one_template_of_many_is_its_trials_alone():
    frame = make_episodes(20, ["learned_myopic", "pouct"], ["small"], [1])
    frame["template"] = np.where(frame["trial_id"] < "small-1-012", "and2", "seq2")
    alone = summarise(checked_episodes(frame[frame["template"] == "and2"]))
    found, and2 = results_by_template(checked_episodes(frame), "pouct"), ("and2", ALL_TEAMS)
    compared = ("pouct", "learned_myopic")
    assert found.improvement(and2, *compared) == alone.improvement(("small", 1), *compared)
    own, whole = found.cost(and2, "pouct"), alone.cost(("small", 1), "pouct")
    assert [own.value, own.low] == pytest.approx([whole.value, whole.low])


def test_rows_without_templates(frame):
    assert results_by_template(frame.drop(columns="template"), "pouct") is None
    assert results_by_template(frame, None) is None
    alone = results_by_template(frame[frame["planner"] == "pouct"], "pouct")
    assert draw_templates(alone, "pouct") is None


def test_bars_are_shares(frame):
    summary = summarise(frame)
    [axes] = draw_wins(summary, "pouct").axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["small, 1 robot", "large, 2 robots", "all"]
    widths = np.array([bar.get_width() for bar in axes.patches]).reshape(3, -1).T
    assert widths == pytest.approx(np.array([[100, 0, 0], [0, 100, 0], [200 / 3, 100 / 3, 0]]))
    assert draw_wins(summarise(checked_episodes(make_episodes(2, ["pouct"]))), "pouct") is None
