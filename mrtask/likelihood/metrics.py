"""Measure how good probabilities are: ranking (ROC AUC, average precision), sharpness (log loss, Brier), calibration.

Everything is computed on distinct triples with counts, which gives exactly the row-wise values.
"""

import numpy as np
import pandas as pd

from mrtask.arrays import Floats

CALIBRATION_BINS = 10


def evaluate(probs: Floats, triples: pd.DataFrame) -> dict[str, float]:
    """Return the metrics of ``probs [N]`` on N triples with ``positives`` and ``count``.

    ``roc_auc`` and ``average_precision`` are NaN if only one label occurs. ``best_log_loss`` is the log loss of the
    triples' own frequencies: no model on names alone can do better on these rows.
    """
    from sklearn.metrics import average_precision_score, roc_auc_score  # comes with mrtask[train]

    positives = triples["positives"].to_numpy(dtype=np.float64)
    count = triples["count"].to_numpy(dtype=np.float64)
    negatives, rows = count - positives, count.sum()
    result = {"rows": float(rows), "positive_share": float(positives.sum() / rows) if rows else float("nan")}
    if 0 < positives.sum() < rows:
        label = np.repeat([1, 0], len(triples))
        weight = np.concatenate([positives, negatives])
        result["roc_auc"] = float(roc_auc_score(label, np.tile(probs, 2), sample_weight=weight))
        result["average_precision"] = float(average_precision_score(label, np.tile(probs, 2), sample_weight=weight))
    else:
        result["roc_auc"] = result["average_precision"] = float("nan")
    if not rows:
        return result | dict.fromkeys(("log_loss", "best_log_loss", "brier", "ece"), float("nan"))
    own = positives / count
    result["log_loss"] = log_loss(probs, triples)
    result["best_log_loss"] = log_loss(np.clip(own, 1e-12, 1 - 1e-12), triples)
    result["brier"] = float((positives * (1 - probs) ** 2 + negatives * probs**2).sum() / rows)
    bins = reliability(probs, triples)
    result["ece"] = float((bins["rows"] * (bins["mean_prob"] - bins["frequency"]).abs()).sum() / rows)
    return result


def reliability(probs: Floats, triples: pd.DataFrame, bins: int = CALIBRATION_BINS) -> pd.DataFrame:
    """Compare predicted with observed: ``mean_prob, frequency, rows`` per bin of about equally many rows, lowest first.

    The bins have equal mass because nearly all probabilities are small; bins of equal width would put them all in one.
    """
    count = triples["count"].to_numpy(dtype=np.float64)
    order = np.argsort(probs, kind="stable")
    mass = np.cumsum(count[order]) - count[order] / 2
    which = np.empty(len(probs), dtype=np.int64)
    which[order] = np.minimum((mass / count.sum() * bins).astype(np.int64), bins - 1)
    frame = pd.DataFrame(
        {
            "bin": which,
            "rows": count,
            "prob": probs * count,
            "positives": triples["positives"].to_numpy(dtype=np.float64),
        }
    )
    summed = frame.groupby("bin").sum()
    return pd.DataFrame(
        {
            "mean_prob": summed["prob"] / summed["rows"],
            "frequency": summed["positives"] / summed["rows"],
            "rows": summed["rows"],
        }
    ).reset_index(drop=True)


def evaluate_by(probs: Floats, triples: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return ``evaluate`` for each value of ``object``, ``container`` or ``room``, most rows first."""
    records = []
    for value, index in triples.reset_index(drop=True).groupby(column).groups.items():
        part = index.to_numpy()
        records.append({column: value, **evaluate(probs[part], triples.iloc[part])})
    return pd.DataFrame(records).sort_values(["rows", column], ascending=[False, True], ignore_index=True)


def log_loss(probs: Floats, triples: pd.DataFrame) -> float:
    """Return the mean log loss of ``probs [N]`` over the rows behind N triples with ``positives`` and ``count``."""
    positives = triples["positives"].to_numpy(dtype=np.float64)
    count = triples["count"].to_numpy(dtype=np.float64)
    total = (positives * np.log(probs) + (count - positives) * np.log1p(-probs)).sum()
    return float(-total / count.sum())
