"""The plots of a training show their data."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from mrtask.analysis.studies.training_figures import loss_curves, reliability_plot


def test_reliability_plot_has_every_bin_and_wilsons_interval():
    bins = pd.DataFrame({"mean_prob": [0.001, 0.2], "frequency": [0.0, 0.25], "rows": [400.0, 100.0]})
    axes = reliability_plot(bins).axes[0]
    intervals = [segment[:, 1] for segment in axes.collections[0].get_segments()]
    z = norm.ppf(0.975)
    middle, half = (0.25 + z**2 / 200) / (1 + z**2 / 100), z * np.sqrt(0.1875 / 100 + z**2 / 40000) / (1 + z**2 / 100)
    assert intervals[1] == pytest.approx([middle - half, middle + half], rel=1e-6)
    assert intervals[0] == pytest.approx([axes.get_ylim()[0], z**2 / (400 + z**2)], rel=1e-6)
    assert axes.lines[1].get_xydata().tolist() == [[0.2, 0.25]]
    axes.figure.draw_without_rendering()
    for labels in (axes.get_xticklabels(), axes.get_yticklabels()):
        assert {"0.001", "0.01", "0.1", "1"} <= {label.get_text() for label in labels}


def test_loss_curves_have_both_losses_and_the_reference():
    history = [
        {"epoch": 1.0, "train_loss": 0.3, "validation_loss": 0.4},
        {"epoch": 2.0, "train_loss": 0.1, "validation_loss": 0.2},
    ]
    lines = loss_curves(history, 0.15).axes[0].lines
    assert [list(line.get_ydata()) for line in lines] == [[0.3, 0.1], [0.4, 0.2], [0.15, 0.15]]
