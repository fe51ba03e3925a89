"""Plots of one training: how the loss fell, and how far the probabilities can be taken at their word."""

from collections.abc import Sequence

import pandas as pd
from matplotlib.figure import Figure

from mrtask.likelihood.network import EpochMetrics


def loss_curves(history: Sequence[EpochMetrics], frequency_log_loss: float | None = None) -> Figure:
    """Training and validation log loss by epoch, with the frequency table's on the validation homes for reference."""
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axes = figure.subplots()
    epochs = [entry["epoch"] for entry in history]
    for key, label in (("train_loss", "training (with batch statistics)"), ("validation_loss", "validation homes")):
        axes.plot(epochs, [entry[key] for entry in history], label=label)
    if frequency_log_loss is not None:
        axes.axhline(frequency_log_loss, color="gray", linestyle="--", label="frequency table, validation homes")
    axes.set(xlabel="epoch", ylabel="log loss", yscale="log")
    axes.legend()
    return figure


def reliability_plot(reliability: pd.DataFrame) -> Figure:
    """Observed frequency against mean probability of the bins of ``metrics.reliability``, on log axes."""
    figure = Figure(figsize=(5.0, 5.0), layout="constrained")
    axes = figure.subplots()
    shown = reliability[(reliability["frequency"] > 0) & (reliability["mean_prob"] > 0)]
    low = float(shown[["mean_prob", "frequency"]].to_numpy().min()) if len(shown) else 1e-3
    axes.plot([low, 1.0], [low, 1.0], color="gray", linestyle="--", label="perfect")
    axes.plot(shown["mean_prob"], shown["frequency"], marker="o", label="test homes, bins of equally many rows")
    axes.set(xlabel="mean predicted probability", ylabel="observed frequency", xscale="log", yscale="log")
    axes.legend()
    return figure
