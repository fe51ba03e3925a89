"""Metrics on counts against scikit-learn's on single rows, and calibration against hand-made cases."""

import numpy as np
import pandas as pd
import pytest
from sklearn.metrics import average_precision_score, brier_score_loss, log_loss, roc_auc_score

from mrtask.likelihood.metrics import evaluate, evaluate_by, reliability


@pytest.fixture
def scored():
    rng = np.random.default_rng(0)
    count = rng.integers(1, 30, 60)
    probs = np.round(rng.uniform(0.01, 0.99, 60), 2)
    triples = pd.DataFrame(
        {"object": rng.choice(["a", "b", "c"], 60), "positives": rng.binomial(count, probs), "count": count}
    )
    return probs, triples


def test_equal_to_scikit_learn_on_single_rows(scored):
    probs, triples = scored
    label = np.concatenate(
        [[1] * p + [0] * (n - p) for p, n in zip(triples["positives"], triples["count"], strict=True)]
    )
    single = np.repeat(probs, triples["count"])
    found = evaluate(probs, triples)
    expected = {
        "rows": len(label),
        "positive_share": label.mean(),
        "roc_auc": roc_auc_score(label, single),
        "average_precision": average_precision_score(label, single),
        "log_loss": log_loss(label, single),
        "brier": brier_score_loss(label, single),
    }
    assert {name: found[name] for name in expected} == pytest.approx(expected)
    own = np.repeat(np.clip(triples["positives"] / triples["count"], 1e-12, 1 - 1e-12), triples["count"])
    assert found["best_log_loss"] == pytest.approx(log_loss(label, own)) and found["best_log_loss"] < found["log_loss"]


def test_calibration_error_by_hand():
    triples = pd.DataFrame({"positives": [1, 9], "count": [10, 10]})
    assert evaluate(np.array([0.1, 0.9]), triples)["ece"] == pytest.approx(0.0)
    assert evaluate(np.array([0.3, 0.8]), triples)["ece"] == pytest.approx((0.2 + 0.1) / 2)


def test_reliability_bins_hold_equally_many_rows():
    probs = np.array([0.4, 0.1, 0.2, 0.3])
    triples = pd.DataFrame({"positives": [2, 1, 0, 4], "count": [10, 10, 10, 10]})
    bins = reliability(probs, triples, bins=2)
    assert bins["rows"].tolist() == [20, 20]
    assert bins["mean_prob"].tolist() == pytest.approx([0.15, 0.35])
    assert bins["frequency"].tolist() == pytest.approx([0.05, 0.3])


def test_by_object_adds_up(scored):
    probs, triples = scored
    table = evaluate_by(probs, triples, "object")
    assert sorted(table["object"]) == ["a", "b", "c"] and table["rows"].is_monotonic_decreasing
    whole = evaluate(probs, triples)
    assert (table["log_loss"] * table["rows"]).sum() / table["rows"].sum() == pytest.approx(whole["log_loss"])


def test_one_label_only_or_no_rows():
    triples = pd.DataFrame({"positives": [0], "count": [5]})
    found = evaluate(np.array([0.2]), triples)
    assert np.isnan(found["roc_auc"]) and found["log_loss"] == pytest.approx(-np.log(0.8))
    assert np.isnan(evaluate(np.zeros(0), triples.head(0))["log_loss"])
