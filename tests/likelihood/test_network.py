"""The network: the paper's shape, the loss of counts against that of rows, determinism, checkpoints, early stopping."""

import itertools
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from torch import nn

from mrtask.likelihood.features import NameFeatures
from mrtask.likelihood.network import NetworkModel, build_module, predict_features
from mrtask.likelihood.network_training import Inputs, set_statistics, train_network, weighted_loss
from mrtask.likelihood.options import PAPER_LAYERS, NetworkOptions

SMALL = NetworkOptions(layers=(16, 8), max_epochs=12, patience=12, batch_size=16, device="cpu", threads=1)


class Interrupted(Exception):
    """Stands for the end of a process."""


@pytest.fixture
def problem():
    """Features of 60 triples whose probability is a logistic function of them, with counts; two halves."""
    rng = np.random.default_rng(0)
    features = rng.normal(size=(120, 6)).astype(np.float32)
    probs = 1 / (1 + np.exp(-features @ np.array([2.0, -1.0, 0.5, 0, 0, 0]) + 1))
    count = rng.integers(1, 200, 120)
    triples = pd.DataFrame({"positives": rng.binomial(count, probs), "count": count})
    return features[:80], triples[:80], features[80:], triples[80:]


def written_out(features):
    """Features in which every row is a name of its own."""
    return NameFeatures((features,), np.arange(len(features))[None])


def train(features, triples, other_features, other, *how):
    return train_network(written_out(features), triples, written_out(other_features), other, *how)


def weights_of(module):
    return {name: value.clone() for name, value in module.state_dict().items()}


def same(first, second):
    return all(torch.equal(first[name], second[name]) for name in first)


def test_shape_is_the_papers():
    module = build_module(3 * (384 + 4), PAPER_LAYERS, seed=0)
    linear = [layer for layer in module if isinstance(layer, nn.Linear)]
    assert [layer.out_features for layer in linear] == [2048, 1024, 512, 256, 128, 64, 32, 16, 8, 4, 1]
    assert linear[0].in_features == 1164
    assert sum(isinstance(layer, nn.BatchNorm1d) for layer in module) == 10
    assert sum(isinstance(layer, nn.LeakyReLU) for layer in module) == 10
    assert [layer.num_features for layer in module if isinstance(layer, nn.BatchNorm1d)] == list(PAPER_LAYERS)


def test_loss_and_gradient_of_counts_equal_those_of_single_rows(problem):
    """And so does the expectation of a draw in proportion to the counts, which is what training takes."""
    features, triples, _, _ = problem
    module = build_module(6, (16, 8), seed=0).eval()
    inputs = torch.from_numpy(features)
    positives, count = (torch.tensor(triples[name].to_numpy(), dtype=torch.float32) for name in ("positives", "count"))
    label = torch.cat([torch.tensor([1.0] * p + [0.0] * (n - p)) for p, n in triples.to_numpy()])
    row = torch.repeat_interleave(torch.arange(len(inputs)), count.long())

    by_count = weighted_loss(module(inputs).squeeze(1), positives, count) / count.sum()
    by_row = nn.BCEWithLogitsLoss()(module(inputs[row]).squeeze(1), label)
    assert by_count.item() == pytest.approx(by_row.item(), rel=1e-5)
    gradients = [torch.autograd.grad(loss, list(module.parameters())) for loss in (by_count, by_row)]
    for one, other in zip(*gradients, strict=True):
        assert torch.allclose(one, other, atol=1e-6, rtol=1e-4)
    drawn = torch.stack(
        [weighted_loss(module(inputs[[i]])[0], positives[i] / count[i], count.new_ones(1)) for i in range(80)]
    )
    assert (drawn * count / count.sum()).sum().item() == pytest.approx(by_row.item(), rel=1e-5)


def test_statistics_are_those_of_the_single_rows(problem):
    """A pass in training mode over all rows as one batch normalises alike, and its momentum of 1 keeps what it saw."""
    features, triples, _, _ = problem
    inputs, count = torch.from_numpy(features), torch.tensor(triples["count"].to_numpy(), dtype=torch.float32)
    by_count, by_row = (build_module(6, (16, 8), seed=0) for _ in range(2))
    norms = [[layer for layer in module if isinstance(layer, nn.BatchNorm1d)] for module in (by_count, by_row)]
    for layer in norms[1]:
        layer.momentum = 1.0
    with torch.no_grad():
        logits = set_statistics(by_count, by_count[0](inputs), count)
        by_row.train()(inputs[torch.repeat_interleave(torch.arange(len(inputs)), count.long())])
        assert torch.equal(logits, by_count(inputs)) and not by_count.training
    for one, other in zip(*norms, strict=True):
        assert torch.allclose(one.running_mean, other.running_mean, atol=1e-5)
        assert torch.allclose(one.running_var, other.running_var, rtol=1e-3)


@pytest.fixture
def of_names():
    """Features of 40 triples of 5, 4 and 3 names, three and two numbers wide."""
    rng = np.random.default_rng(0)
    vectors = tuple(rng.normal(size=shape).astype(np.float32) for shape in ((5, 3), (4, 2), (3, 2)))
    return NameFeatures(vectors, np.stack([rng.integers(0, len(part), 40) for part in vectors]))


def test_what_names_share_changes_neither_output_nor_gradient(of_names):
    layer, chosen = nn.Linear(7, 16), torch.tensor([3, 3, 0, 21])
    assert (len(of_names), of_names.width, of_names.rows().shape) == (40, 7, (40, 7))
    shared, rows = Inputs(of_names, torch.device("cpu")), torch.from_numpy(of_names.rows())
    assert torch.allclose(shared.through(layer), layer(rows), atol=1e-6)
    outputs = (shared.through(layer, chosen), layer(rows[chosen]))
    assert torch.allclose(*outputs, atol=1e-6)
    gradients = [torch.autograd.grad(output.square().sum(), list(layer.parameters())) for output in outputs]
    for one, other in zip(*gradients, strict=True):
        assert torch.allclose(one, other, rtol=1e-4, atol=1e-5)


def test_training_is_the_same_where_names_are_written_out(of_names):
    rng = np.random.default_rng(1)
    count = rng.integers(1, 200, 40)
    triples = pd.DataFrame({"positives": rng.binomial(count, rng.uniform(size=40)), "count": count})
    trainings = [
        train_network(features, triples, features, triples, SMALL)[0]
        for features in (of_names, written_out(of_names.rows()))
    ]
    first, second = (predict_features(module, of_names.rows()) for module in trainings)
    np.testing.assert_allclose(first, second, rtol=1e-2)


def test_deep_and_narrow_it_still_reaches_all_probabilities(problem):
    """Ranking is the easy part: without a higher rate for what sets their size, log odds stay near the base rate's."""
    options = replace(SMALL, layers=(64, 32, 16, 8, 4), max_epochs=60, patience=60)
    features, triples = problem[2:]
    frequency = (triples["positives"] / triples["count"]).to_numpy()
    error = {}
    for rate in (options.learning_rate, options.scale_learning_rate):
        module, _ = train(*problem, replace(options, scale_learning_rate=rate))
        error[rate] = np.abs(predict_features(module, features) - frequency).mean()
    assert error[options.scale_learning_rate] < 0.6 * error[options.learning_rate]


def test_learns_what_can_be_learnt(problem):
    module, history = train(*problem, replace(SMALL, max_epochs=40, patience=40))
    features, triples = problem[2:]
    frequency = triples["positives"] / triples["count"]
    base = problem[1]["positives"].sum() / problem[1]["count"].sum()
    probs = predict_features(module, features)
    assert np.abs(probs - frequency).mean() < 0.4 * np.abs(base - frequency).mean()
    assert history[0]["validation_loss"] > history[-1]["validation_loss"]


def test_same_seed_same_weights_and_history_other_seed_another(problem):
    first, history = train(*problem, SMALL)
    again, history_again = train(*problem, SMALL)
    other, _ = train(*problem, replace(SMALL, seed=1))
    assert same(weights_of(first), weights_of(again)) and history == history_again
    assert not same(weights_of(first), weights_of(other))


@pytest.mark.parametrize("dropout", [0.0, 0.2])
@pytest.mark.parametrize("stop_at", [5, 7])
def test_interrupted_training_ends_the_same(problem, tmp_path, dropout, stop_at):
    options = replace(SMALL, dropout=dropout, checkpoint_every=3)
    whole, history = train(*problem, options)

    def stop(epoch, _):
        if epoch == stop_at:
            raise Interrupted

    with pytest.raises(Interrupted):
        train(*problem, options, stop, tmp_path)
    assert len(list(tmp_path.iterdir())) == 1
    seen = []
    resumed, resumed_history = train(*problem, options, lambda epoch, _: seen.append(epoch), tmp_path)
    assert seen[0] == stop_at // 3 * 3 + 1 and seen[-1] == 12
    assert resumed_history == history and same(weights_of(resumed), weights_of(whole))
    assert list(tmp_path.iterdir()) == []


def test_checkpoint_of_other_options_or_damaged_is_not_used(problem, tmp_path):
    def stop(epoch, _):
        if epoch == 6:
            raise Interrupted

    options = replace(SMALL, checkpoint_every=2)
    with pytest.raises(Interrupted):
        train(*problem, options, stop, tmp_path)
    seen = []
    train(*problem, replace(options, seed=1), lambda epoch, _: seen.append(epoch), tmp_path)
    assert seen[0] == 1
    [path] = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:1000])
    _, history = train(*problem, options, None, tmp_path)
    assert history == train(*problem, options)[1]


def test_stops_when_validation_no_longer_improves_and_returns_the_best(problem):
    features, triples, other_features, other = problem
    contrary = other.assign(positives=other["count"] - other["positives"])
    module, history = train(features, triples, other_features, contrary, replace(SMALL, max_epochs=40, patience=3))
    losses = [entry["validation_loss"] for entry in history]
    assert len(losses) < 40 and len(losses) - 1 - int(np.argmin(losses)) == 3
    probs = predict_features(module, other_features)
    loss = -(contrary["positives"] * np.log(probs) + (contrary["count"] - contrary["positives"]) * np.log1p(-probs))
    assert loss.sum() / contrary["count"].sum() == pytest.approx(min(losses), rel=1e-5)
    assert [entry["best_validation_loss"] for entry in history] == list(itertools.accumulate(losses, min))


def test_without_validation_homes_it_trains_to_the_end(problem):
    features, triples, _, _ = problem
    _, history = train(features, triples, features[:0], triples[:0], replace(SMALL, max_epochs=4, patience=1))
    assert len(history) == 4 and np.isnan(history[0]["validation_loss"])


def test_leaves_random_state_and_threads_alone(problem):
    torch.manual_seed(5)
    before, threads = torch.get_rng_state(), torch.get_num_threads()
    train(*problem, replace(SMALL, max_epochs=2, dropout=0.1, threads=threads + 1))
    assert torch.equal(torch.get_rng_state(), before) and torch.get_num_threads() == threads


def test_prediction_does_not_depend_on_the_batch(problem):
    module, _ = train(*problem, SMALL)
    features = problem[2]
    whole = predict_features(module, features)
    assert predict_features(module, features, batch_size=7) == pytest.approx(whole, rel=1e-5)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"layers": ()}, "layers must be one or more positive widths"),
        ({"device": "tpu"}, "unknown device 'tpu'; allowed: auto, cpu, cuda, mps"),
        ({"max_epochs": 0}, "max_epochs must be at least 1, got 0"),
        ({"batch_size": 1}, "batch_size must be at least 2"),
        ({"learning_rate": 0.0}, "learning_rate and scale_learning_rate must be above 0"),
        ({"dropout": 1.0}, "0 <= dropout < 1"),
    ],
)
def test_bad_options(wrong, message):
    with pytest.raises(ValueError, match=message):
        NetworkOptions(**wrong)


@pytest.mark.skipif(torch.cuda.is_available(), reason="needs a machine without a GPU")
def test_a_gpu_asked_for_in_vain(problem):
    with pytest.raises(ValueError, match="torch sees no GPU here; give auto or cpu"):
        train(*problem, replace(SMALL, device="cuda"))


def test_too_little_to_train_on(problem):
    features, triples, _, _ = problem
    with pytest.raises(ValueError, match="at least 2 distinct training triples, got 1"):
        train(features[:1], triples[:1], features[:0], triples[:0], SMALL)


def test_stored_weights_are_no_pickle(tmp_path):
    model = NetworkModel("mlp", build_module(12, (4,), seed=0), (4,))
    model.save(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.json", "weights.safetensors"]
