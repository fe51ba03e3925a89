"""Train the likelihood network.

Training uses distinct triples drawn in proportion to their counts, with the share of positives as label. In
expectation, the loss and the batch statistics are then those of the single rows, at a hundredth of the cost. Few names
make many triples, so the output of the first and widest layer for a name is computed once per step and added up for
each triple.

Batch norm undoes whatever size the weight matrices give to a layer's output. How far the log odds can spread is
therefore left to a few vectors: the norms' scales and shifts, the biases and the output layer. Adam moves each number
by about its learning rate per step. At a rate that suits the wide matrices, these vectors are still far from their
optimum when training ends: names are ranked well, but all probabilities are too near the base rate. These vectors
therefore have a higher rate, and no weight decay. The output starts at the training rows' log odds, and both rates rise
and fall once (Smith & Topin 2017, "1cycle").
"""

import contextlib
import hashlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn import functional

from mrtask.errors import InputError
from mrtask.likelihood.features import NameFeatures
from mrtask.likelihood.network import build_module, output_layer
from mrtask.likelihood.options import EpochCallback, EpochMetrics, NetworkOptions

WARM_UP = 0.2


def weighted_loss(logits: Tensor, positives: Tensor, count: Tensor) -> Tensor:
    """Return the summed binary cross-entropy of all rows behind N triples.

    Each triple stands for ``positives`` ones; its other rows are zeros.
    """
    negatives = count - positives
    return (positives * functional.softplus(-logits) + negatives * functional.softplus(logits)).sum()


class Inputs:
    """The features of N triples on a device."""

    def __init__(self, features: NameFeatures, device: torch.device) -> None:
        self.vectors = [torch.from_numpy(vectors).to(device) for vectors in features.vectors]
        self.codes = torch.from_numpy(features.codes).to(device)

    def through(self, layer: nn.Module, rows: Tensor | None = None) -> Tensor:
        """Return the linear layer's output ``[N, H]``, or some of its rows; each distinct name is multiplied once."""
        assert isinstance(layer, nn.Linear)
        parts = torch.split(layer.weight, [vectors.shape[1] for vectors in self.vectors], dim=1)
        codes = self.codes if rows is None else self.codes[:, rows]
        output: Tensor = layer.bias
        for vectors, weight, code in zip(self.vectors, parts, codes, strict=True):
            # Not index_select, whose gradient on a GPU varies from run to run.
            output = output + functional.embedding(code, vectors @ weight.T)
        return output


def set_statistics(module: nn.Sequential, hidden: Tensor, count: Tensor) -> Tensor:
    """Give each batch norm the exact mean and variance over the rows behind N triples.

    ``hidden [N, H]`` is the first layer's output. The running statistics lag behind the weights and contain the noise
    of the last batches. Returns the logits ``[N, 1]`` and leaves the network in evaluation mode.
    """
    module.eval()
    weight = (count / count.sum()).unsqueeze(1)
    for layer in list(module)[1:]:
        if isinstance(layer, nn.BatchNorm1d):
            mean = (weight * hidden).sum(dim=0)
            layer.running_mean = mean
            layer.running_var = (weight * (hidden - mean).square()).sum(dim=0)
        hidden = layer(hidden)
    return hidden


def train_network(
    features: NameFeatures,
    triples: pd.DataFrame,
    validation_features: NameFeatures,
    validation: pd.DataFrame,
    options: NetworkOptions,
    on_epoch: EpochCallback | None = None,
    checkpoint_dir: Path | None = None,
) -> tuple[nn.Sequential, list[EpochMetrics]]:
    """Train until the validation log loss has not improved for ``patience`` epochs; return the best epoch's network.

    ``features`` belong to ``triples`` (columns ``positives``, ``count``). Without validation triples, train for
    ``max_epochs`` and return the last network. The history has one entry per epoch, with the mean log losses of the
    rows at its end: ``epoch, train_loss, validation_loss, best_validation_loss``. With ``checkpoint_dir``, an
    interrupted training continues where it stopped, with the same result.
    """
    if len(features) < 2:
        raise ValueError(f"a network needs at least 2 distinct training triples, got {len(features)}")
    device = find_device(options.device)
    with _threads(options.threads):
        run = _Run(features, triples, validation_features, validation, options, device)
        path = None if checkpoint_dir is None else checkpoint_dir / f"{run.fingerprint[:16]}.safetensors"
        if path is not None:
            run.resume(path)
        while run.unfinished():
            entry = run.epoch()
            if on_epoch is not None:
                on_epoch(int(entry["epoch"]), entry)
            if path is not None and len(run.history) % options.checkpoint_every == 0:
                run.checkpoint(path)
        if path is not None:
            path.unlink(missing_ok=True)
        run.module.load_state_dict(run.best)
    return run.module.cpu().eval(), run.history


class _Run:
    """The state of one training, which can be saved in and restored from a checkpoint."""

    def __init__(
        self,
        features: NameFeatures,
        triples: pd.DataFrame,
        validation_features: NameFeatures,
        validation: pd.DataFrame,
        options: NetworkOptions,
        device: torch.device,
    ) -> None:
        self.options = options
        self.device = device
        self.inputs = Inputs(features, device)
        self.positives, self.count = _weights(triples, device)
        self.validation_inputs = Inputs(validation_features, device)
        self.validation_positives, self.validation_count = _weights(validation, device)
        self.module = build_module(features.width, options.layers, options.seed, options.dropout).to(device)
        share = (float(triples["positives"].sum()) + 0.5) / (float(triples["count"].sum()) + 1.0)
        nn.init.constant_(output_layer(self.module).bias, math.log(share / (1.0 - share)))
        self.optimizer = torch.optim.AdamW(_parameter_groups(self.module, options), fused=True)
        self.batches = math.ceil(len(features) / options.batch_size)
        self.generator = torch.Generator().manual_seed(options.seed)
        self.history: list[EpochMetrics] = []
        self.best = {name: value.clone() for name, value in self.module.state_dict().items()}
        self.fingerprint = _fingerprint(features, triples, validation, options)

    def unfinished(self) -> bool:
        if len(self.history) >= self.options.max_epochs:
            return False
        return not self.history or self._epochs_since_best() < self.options.patience

    def _epochs_since_best(self) -> int:
        if not len(self.validation_count):
            return 0
        losses = [entry["validation_loss"] for entry in self.history]
        return len(losses) - 1 - int(np.argmin(losses))

    def epoch(self) -> EpochMetrics:
        self.module.train()
        first, layers = self.module[0], self.module[1:]
        size = self.options.batch_size
        drawn = torch.multinomial(self.count.cpu(), self.batches * size, replacement=True, generator=self.generator)
        # The random state of dropout belongs to the epoch, so that a resumed training draws the same.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.options.seed + len(self.history))
            for number, batch in enumerate(torch.split(drawn.to(self.device), size)):
                rate = self._rate(len(self.history) * self.batches + number)
                for group in self.optimizer.param_groups:
                    group["lr"] = group["highest_lr"] * rate
                logits = layers(self.inputs.through(first, batch)).squeeze(1)
                share = self.positives[batch] / self.count[batch]
                loss = weighted_loss(logits, share, torch.ones_like(share)) / size
                self.optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                self.optimizer.step()
        with torch.no_grad():
            logits = set_statistics(self.module, self.inputs.through(first), self.count)
            validation_logits = layers(self.validation_inputs.through(first))
        entry: EpochMetrics = {
            "epoch": float(len(self.history) + 1),
            "train_loss": _log_loss(logits, self.positives, self.count),
            "validation_loss": _log_loss(validation_logits, self.validation_positives, self.validation_count),
        }
        self.history.append(entry)
        if self._epochs_since_best() == 0:
            self.best = {name: value.clone() for name, value in self.module.state_dict().items()}
        entry["best_validation_loss"] = min(past["validation_loss"] for past in self.history)
        return entry

    def _rate(self, step: int) -> float:
        """Return the share of the highest learning rates that a step uses."""
        position = (step + 1) / (self.options.max_epochs * self.batches)
        if position < WARM_UP:
            return position / WARM_UP
        return 0.5 * (1.0 + math.cos(math.pi * (position - WARM_UP) / (1.0 - WARM_UP)))

    def checkpoint(self, path: Path) -> None:
        tensors = {f"module.{name}": value for name, value in self.module.state_dict().items()}
        tensors |= {f"best.{name}": value for name, value in self.best.items()}
        for index, state in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{index}.{name}": value for name, value in state.items()}
        tensors["generator"] = self.generator.get_state()
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        metadata = {"fingerprint": self.fingerprint, "history": json.dumps(self.history)}
        save_file({name: value.contiguous().cpu() for name, value in tensors.items()}, temporary, metadata)
        os.replace(temporary, path)

    def resume(self, path: Path) -> None:
        """Restore the checkpoint if it exists, is whole and belongs to this training; otherwise start afresh."""
        if not path.is_file():
            return
        try:
            with safe_open(path, framework="pt") as file:
                metadata = file.metadata() or {}
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no mapping)
        except (OSError, SafetensorError):
            return
        if metadata.get("fingerprint") != self.fingerprint:
            return
        self.module.load_state_dict(_part(tensors, "module."))
        self.best = {name: value.to(self.device) for name, value in _part(tensors, "best.").items()}
        state: dict[int, dict[str, Tensor]] = {}
        for name, value in _part(tensors, "optimizer.").items():
            index, key = name.split(".")
            state.setdefault(int(index), {})[key] = value
        self.optimizer.load_state_dict({**self.optimizer.state_dict(), "state": state})
        self.generator.set_state(tensors["generator"])
        self.history = json.loads(metadata["history"])


def _log_loss(logits: Tensor, positives: Tensor, count: Tensor) -> float:
    """Return the mean log loss of the rows, or NaN without rows."""
    if not len(count):
        return float("nan")
    summed = weighted_loss(logits.squeeze(1).double(), positives.double(), count.double())
    return float(summed / count.double().sum())


def _parameter_groups(module: nn.Sequential, options: NetworkOptions) -> list[dict[str, Any]]:
    """Return the weight matrices, and separately the parameters that set the size of the log odds."""
    output = output_layer(module).weight
    scales = [value for value in module.parameters() if value.ndim == 1 or value is output]
    matrices = [value for value in module.parameters() if value.ndim > 1 and value is not output]
    return [
        {"params": matrices, "highest_lr": options.learning_rate, "weight_decay": options.weight_decay},
        {"params": scales, "highest_lr": options.scale_learning_rate, "weight_decay": 0.0},
    ]


def _part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _weights(triples: pd.DataFrame, device: torch.device) -> tuple[Tensor, Tensor]:
    positives = torch.tensor(triples["positives"].to_numpy(dtype=np.float32), device=device)
    return positives, torch.tensor(triples["count"].to_numpy(dtype=np.float32), device=device)


def _fingerprint(
    features: NameFeatures, triples: pd.DataFrame, validation: pd.DataFrame, options: NetworkOptions
) -> str:
    digest = hashlib.sha256(json.dumps(asdict(replace(options, checkpoint_every=1)), sort_keys=True).encode())
    for vectors in features.vectors:
        digest.update(vectors.tobytes())
    digest.update(features.codes.tobytes())
    for frame in (triples, validation):
        digest.update(frame[["positives", "count"]].to_numpy().tobytes())
    return digest.hexdigest()


def find_device(name: str) -> torch.device:
    """Return the device of that name; ``auto`` is a GPU if the machine has one.

    Raises:
        InputError: this machine or this version of torch does not have it.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name == "cuda" and not torch.cuda.is_available():
        raise InputError("device cuda: torch sees no GPU here; give auto or cpu")
    if name == "mps" and not torch.backends.mps.is_available():
        raise InputError("device mps: torch sees none here; give auto or cpu")
    return torch.device(name)


@contextlib.contextmanager
def _threads(number: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(number or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)
