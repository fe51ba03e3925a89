"""Training of every kind on a world whose likelihoods are known, and on real homes where there are some."""

import numpy as np
import pandas as pd
import pytest

from mrtask.homes.procthor import read_houses
from mrtask.likelihood.dataset import build_dataset
from mrtask.likelihood.kinds import KINDS
from mrtask.likelihood.options import SMOOTHINGS, NetworkOptions, TrainingOptions
from mrtask.likelihood.rows import SPLITS, TRIPLE
from mrtask.likelihood.training import fit, score, score_unseen, train_model

NETWORK = NetworkOptions(layers=(32, 16), max_epochs=150, patience=150, batch_size=64, device="cpu", threads=1)


@pytest.mark.parametrize("kind", KINDS)
def test_comes_near_the_true_likelihoods(made_up_dataset, true_probs, embedding_cache, kind):
    epochs, phases = [], []
    options = TrainingOptions(kind, network=NETWORK, cache_dir=embedding_cache)
    trained = train_model(made_up_dataset, options, lambda epoch, metrics: epochs.append(epoch), phases.append)
    truth = pd.DataFrame(
        [(name, *place, prob) for place, probs in true_probs.items() for name, prob in probs.items()],
        columns=["object", "container", "room", "prob"],
    )
    error = np.abs(trained.model.predict(truth) - truth["prob"])
    assert error.mean() < (0.25 if kind == "logistic" else 0.05)
    assert phases[-1] == "measuring"
    assert epochs == [entry["epoch"] for entry in trained.history] and bool(epochs) == (kind in ("paper_fcnn", "mlp"))
    share = trained.metrics["test"]["positive_share"]
    guess = -(share * np.log(share) + (1 - share) * np.log1p(-share))
    assert trained.metrics["test"]["log_loss"] < (guess if kind == "logistic" else 0.7 * guess)
    assert trained.metrics["test"]["rows"] == 80 * 25


def test_unknown_kind(made_up_dataset):
    with pytest.raises(ValueError, match="unknown likelihood model 'oracle'; allowed: similarity, paper_fcnn, mlp"):
        train_model(made_up_dataset, TrainingOptions("oracle"))
    with pytest.raises(ValueError, match="regularisation and smoothing must be above 0"):
        TrainingOptions(smoothing=0.0)


@pytest.mark.parametrize("kind", ["frequency", "similarity"])
def test_smoothing_is_what_predicts_other_homes_best(embedding_cache, kind):
    """Little where each object has places of its own, much where it is the place alone that matters."""
    rng = np.random.default_rng(0)
    objects, containers = ["Apple", "Bread", "Egg", "Fork", "Pillow", "Book"], ["Fridge", "Drawer", "Bed", "Desk"]
    names = pd.DataFrame([(name, place, "Kitchen") for name in objects for place in containers], columns=TRIPLE)
    places = np.tile([0.05, 0.1, 0.2, 0.4], len(objects))
    found = []
    for probs in (rng.permutation(np.repeat([0.02, 0.9], len(names) // 2)), places):
        train, validation = (names.assign(positives=rng.binomial(rows, probs), count=rows) for rows in (20, 500))
        losses = {}
        for strength in SMOOTHINGS:
            options = TrainingOptions(kind, smoothing=strength, cache_dir=embedding_cache)
            losses[strength] = score(fit(train, validation, options)[0], validation)["log_loss"]
        options = TrainingOptions(kind, cache_dir=embedding_cache)
        found.append(fit(train, validation, options)[0].strength)
        assert found[-1] == min(losses, key=losses.get)
        assert fit(train, validation.head(0), options)[0].strength == SMOOTHINGS[0]
    assert found[0] == SMOOTHINGS[0] < found[1]


def test_unseen_names_are_predicted_without_their_counts(made_up_dataset):
    """The frequency table then knows no more than the kind of container."""
    found = score_unseen({split: made_up_dataset.triples(split) for split in SPLITS}, TrainingOptions("frequency"))
    seen = train_model(made_up_dataset, TrainingOptions("frequency")).metrics
    assert found["rows"] == seen["test"]["rows"] and found["log_loss"] > seen["test"]["log_loss"] + 0.1
    assert seen["unseen"] == found


def test_on_real_homes_names_help(shared_homes, embedding_cache):
    """The default is at least level with the frequency table on seen names, and clearly better on unseen ones."""
    files = [shared_homes / "procthor-4to10room.jsonl.gz"]
    homes = sorted(read_houses(files, shared_homes / "asset-database.json"), key=lambda home: home.id)
    split = {"train": homes[:40], "validation": homes[40:50], "test": homes[50:]}
    dataset = build_dataset(split, source="real", seed=0, code_version="test")
    table = train_model(dataset, TrainingOptions("frequency", cache_dir=embedding_cache)).metrics
    ours = train_model(dataset, TrainingOptions(cache_dir=embedding_cache)).metrics
    assert ours["test"]["log_loss"] <= table["test"]["log_loss"]
    assert ours["test"]["roc_auc"] >= table["test"]["roc_auc"] - 0.002
    assert ours["unseen"]["log_loss"] < table["unseen"]["log_loss"] - 0.005
    assert ours["unseen"]["roc_auc"] > table["unseen"]["roc_auc"] + 0.03
