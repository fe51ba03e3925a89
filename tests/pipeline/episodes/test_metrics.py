import numpy as np
import pytest

from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.statistics import summarise
from pipeline.episodes.metrics import headline_of, metrics_of
from tests.analysis.synthetic import rows


def test_metrics_have_means_and_intervals_of_a_cell_and_of_everything() -> None:
    costs = np.linspace(1, 2, 12)
    summary = summarise(checked_episodes(rows("medium", 2, {"pouct": 3 * costs, "learned_myopic": 5 * costs[::-1]})))
    metrics = metrics_of(summary)
    for cell in ("medium_2", "all"):
        name = f"pouct/{cell}/percent_better_than_learned_myopic"
        assert metrics[name] == pytest.approx(40)
        assert metrics[f"{name}_low"] < 40 < metrics[f"{name}_high"]
    assert metrics["pouct/medium_2/accepted"] == 1
    assert "lower than learned_myopic" in headline_of(summary)
