import io

import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.page.tables import ABOVE, BELOW, LEVEL, Table
from mrtask.analysis.report.cell_tables import paper_table, real_world_table, variant_table
from mrtask.analysis.report.planner_table import planner_table, result_table
from mrtask.analysis.report.wins import pair_table
from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.published import load_published
from mrtask.analysis.results.statistics import summarise
from tests.analysis.synthetic import fail, make_episodes, rows

PUBLISHED = load_published()


def entries(table: Table, label: str, after: str = "") -> list[list[str]]:
    """The texts of the first row called ``label`` below the heading that starts with ``after``."""
    labels = [row.label for row in table.rows]
    start = next(i for i, row in enumerate(table.rows) if row.heading and row.label.startswith(after)) if after else 0
    row = table.rows[labels.index(label, start)]
    return [[entry.value, *entry.details] for entry in row.entries]


def summary_of(frame: pd.DataFrame):
    return summarise(checked_episodes(frame))


def test_csv_by_hand():
    frame = rows("small", 2, {"pouct": [1.0, 3.0, None], "learned_myopic": [2.0, 6.0, 4.0]})
    frame = pd.concat([frame, rows("large", 1, {"pouct": [7.0]})])
    table = result_table({"": summary_of(frame)}, PUBLISHED)
    table = pd.read_csv(io.StringIO(table.to_csv(index=False))).set_index(["size_class", "robots", "planner"])
    assert list(table.index) == [
        *(("small", 2, "learned_myopic"), ("small", 2, "pouct"), ("large", 1, "pouct")),
        *(("all", 0, "learned_myopic"), ("all", 0, "pouct")),
    ]
    pooled = table.loc["all", 0, "pouct"]
    assert (pooled["episodes"], pooled["n"], pooled["pairs_learned_myopic"]) == (4, 3, 2)
    assert pooled["mean_cost_s"] == pytest.approx(11 / 3)
    assert pooled["improvement_over_learned_myopic_percent"] == pytest.approx(50), "as the headline says"
    row = table.loc["small", 2, "pouct"]
    assert (row["episodes"], row["n"], row["failed"], row["error"], row["timeout"]) == (3, 2, 1, 0, 0)
    assert (row["mean_cost_s"], row["mean_cost_cells"]) == (2.0, 40.0)
    assert (row["published_cost_cells"], row["published_planner"]) == (145.67, "multi-robot planner")
    assert row["improvement_over_learned_myopic_percent"] == pytest.approx(50)
    assert row["published_improvement_over_learned_myopic_percent"] == 8.97
    assert (row["pairs_learned_myopic"], row["wins_learned_myopic"], row["losses_learned_myopic"]) == (2, 2, 0)
    assert np.isnan(row["improvement_over_nonlearned_myopic_percent"]) and row["pairs_nonlearned_myopic"] == 0
    assert np.isnan(table.loc["large", 1, "pouct"]["improvement_over_learned_myopic_percent"])


def test_csv_has_the_same_columns_without_episodes():
    none, some = make_episodes(1).head(0), make_episodes(1, ["greedy"], ["small"], [1])
    assert list(result_table({"": summary_of(none)}, PUBLISHED)) == list(
        result_table({"": summary_of(some)}, PUBLISHED)
    )


def test_csv_names_variants():
    summary = summary_of(make_episodes(2, ["greedy"], ["small"], [1]))
    table = result_table({"samples=10": summary, "samples=20": summary}, PUBLISHED)
    assert (
        list(table.columns[:2]) == ["sweep", "size_class"]
        and list(table["sweep"]) == ["samples=10"] * 2 + ["samples=20"] * 2
    )


def test_paper_table_shows_all_published_cells():
    table = paper_table(summary_of(make_episodes(3, robots=[1, 4], size_classes=["small"])), PUBLISHED, "pouct")
    assert table.spans == [("small", 4), ("medium", 3), ("large", 3)]
    assert [lower for _, lower in table.columns[:4]] == ["1 robot", "2 robots", "3 robots", "4 robots"]
    cost = entries(table, "pouct")
    assert cost[0][2] == "paper 215.22" and cost[1] == ["\N{EN DASH}", "paper 145.67"] and len(cost[3]) == 2
    improvement = entries(table, "improvement", "Improvement of pouct over learned_myopic")
    assert improvement[0][2] == "paper 15.71 %" and improvement[4] == ["\N{EN DASH}", "paper 28.53 %"]


def test_paper_table_tells_what_did_not_run_and_what_did_not_finish():
    table = paper_table(summary_of(rows("small", 1, {"greedy": [2.0, 4.0, None]})), PUBLISHED, "greedy")
    labels = [row.label for row in table.rows]
    for label in ("nonlearned_myopic (not run)", "learned_myopic (not run)", "multi-robot planner (not run)"):
        assert label in labels
    assert entries(table, "greedy")[0][0] == "60.0" and entries(table, "greedy")[0][-1] == "2/3 finished"


@pytest.mark.parametrize(("saved", "mark", "tone"), [(0.9, ABOVE, "good"), (0.0, BELOW, "bad"), (0.2, LEVEL, "")])
def test_marks_against_the_published_improvement(saved, mark, tone):
    rng = np.random.default_rng(0)
    baseline = rng.uniform(10, 12, 40)
    costs = {"learned_myopic": baseline, "pouct": baseline * (1 - saved) * rng.lognormal(0, 0.1, 40)}
    table = paper_table(summary_of(rows("small", 1, costs)), PUBLISHED, "pouct")
    row = next(row for row in table.rows if row.label == "improvement")
    assert row.entries[0].value.endswith(mark) and row.entries[0].tone == tone


def test_planner_table_counts_what_was_lost():
    frame = make_episodes(5, ["learned_myopic", "pouct"], ["small"], [1])
    is_pouct = frame["planner"] == "pouct"
    frame = fail(fail(frame, is_pouct & (frame["trial_id"] < "small-1-002")), is_pouct & (frame.index == 9), "timeout")
    table = planner_table(summary_of(frame), PUBLISHED)
    assert entries(table, "pouct")[:2] == [["5"], ["3", "2 failed", "1 timeout"]]
    assert entries(table, "learned_myopic")[:2] == [["5"], ["0"]]


def test_pair_table_has_cells_classes_and_all():
    table = pair_table(summary_of(make_episodes(3, ["learned_myopic", "pouct"], ["small"], [1, 2])), "pouct")
    assert [row.label for row in table.rows] == [
        "against learned_myopic", "small, 1 robot", "small, 2 robots", "small", "all",
    ]  # fmt: skip
    assert entries(table, "all")[0] == ["6"]
    assert pair_table(summary_of(make_episodes(3, ["pouct"])), "pouct") is None


def test_variant_table_of_different_cells():
    first = summary_of(make_episodes(3, ["learned_myopic", "pouct"], ["small"], [1]))
    second = summary_of(make_episodes(3, ["learned_myopic", "pouct"], ["small"], [2]))
    table = variant_table({"seed=1": first, "seed=2": second}, "pouct")
    assert table.columns == (("small", "1 robot"), ("small", "2 robots"), ("all", "all teams"))
    assert entries(table, "seed=1")[1] == ["\N{EN DASH}"] and entries(table, "seed=2")[0] == ["\N{EN DASH}"]
    assert variant_table({"": first}, "pouct") is None


def test_real_world_table():
    assert [entry.value for entry in real_world_table(PUBLISHED).rows[0].entries] == ["23.72 m", "7.79 m", "67.2 %"]
