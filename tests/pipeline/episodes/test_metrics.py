import numpy as np
import pytest

from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.statistics import summarise
from pipeline.episodes.metrics import MOST_PLANNERS, headline_of, metrics_of, most_telling, table_of
from tests.analysis.synthetic import rows


def test_metrics_have_means_and_intervals_of_a_cell_and_of_everything() -> None:
    costs = np.linspace(1, 2, 12)
    summary = summarise(checked_episodes(rows("medium", 2, {"pouct": 3 * costs, "learned_myopic": 5 * costs[::-1]})))
    metrics = metrics_of(summary, summary.planners)
    for cell in ("medium_2", "all"):
        name = f"pouct/{cell}/percent_better_than_learned_myopic"
        assert metrics[name] == pytest.approx(40)
        assert metrics[f"{name}_low"] < 40 < metrics[f"{name}_high"]
    assert metrics["pouct/medium_2/accepted"] == 1
    assert "lower than learned_myopic" in headline_of(summary)


def test_of_many_variants_the_best_are_listed_and_all_are_in_a_table() -> None:
    costs = np.linspace(1, 2, 12)
    variants = {f"variant_{number:03}": (100 - number) * costs for number in range(40)}
    worse = {"pouct": 300 * costs, "learned_myopic": 500 * costs}
    summary = summarise(checked_episodes(rows("medium", 2, worse | variants)))
    listed = most_telling(summary)
    assert listed[:2] == ["pouct", "learned_myopic"] and len(listed) == MOST_PLANNERS
    assert listed[2:] == [f"variant_{number:03}" for number in range(39, 29, -1)]
    table = table_of(summary)
    assert table["planner"].nunique() == 42 and set(table["cell"]) == {"all", "medium_2"}
    one = table[(table["planner"] == "variant_000") & (table["cell"] == "all")].set_index("metric")["value"]
    assert one["accepted"] == 1 and one["percent_better_than_learned_myopic"] == pytest.approx(80)
    assert len(metrics_of(summary, listed)) < len(table) / 3
