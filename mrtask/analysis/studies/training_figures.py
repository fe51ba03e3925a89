"""Plots of one training: how the loss fell, and how well the probabilities are calibrated."""

from collections.abc import Sequence

import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import binomtest

from mrtask.analysis.page.charts import ticks_as
from mrtask.likelihood.options import EpochMetrics

MIN_SHOWN_PROB = 1e-3
"""The probability at which the axes of an empty plot begin."""


def loss_curves(history: Sequence[EpochMetrics], frequency_log_loss: float | None = None) -> Figure:
    """Draw training and validation log loss by epoch, and the frequency table's validation loss for reference."""
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axes = figure.subplots()
    epochs = [entry["epoch"] for entry in history]
    for key, label in (("train_loss", "training homes"), ("validation_loss", "validation homes")):
        axes.plot(epochs, [entry[key] for entry in history], label=label)
    if frequency_log_loss is not None:
        axes.axhline(frequency_log_loss, color="gray", linestyle="--", label="frequency table, validation homes")
    axes.set(xlabel="epoch", ylabel="log loss")
    axes.legend()
    return figure


def reliability_plot(reliability: pd.DataFrame) -> Figure:
    """Draw the observed frequency against the mean probability of the bins of ``metrics.reliability``, on log axes.

    The bins have Wilson's 95 % intervals, as if the rows were independent. A bin without a found object shows only its
    interval.
    """
    figure = Figure(figsize=(5.0, 5.0), layout="constrained")
    axes = figure.subplots()
    tests = [
        binomtest(round(frequency * rows), round(rows)).proportion_ci(method="wilson")
        for frequency, rows in zip(reliability["frequency"], reliability["rows"], strict=True)
    ]
    smallest = reliability[["mean_prob", "frequency"]].to_numpy().ravel()
    low = min((float(value) for value in smallest if value > 0), default=MIN_SHOWN_PROB) / 2
    axes.plot([low, 1.0], [low, 1.0], color="gray", linestyle="--", label="perfect")
    axes.vlines(reliability["mean_prob"], [max(test.low, low) for test in tests], [test.high for test in tests])
    found = reliability[reliability["frequency"] > 0]
    axes.plot(found["mean_prob"], found["frequency"], "o", label="test homes, bins of equally many rows")
    for axis in (axes.xaxis, axes.yaxis):
        ticks_as(axis, "{:g}".format, log=True)
    axes.set(xlabel="mean predicted probability", ylabel="observed frequency")
    axes.set_ylim(bottom=low)
    axes.legend()
    return figure
