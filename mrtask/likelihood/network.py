"""The likelihood network: the paper's (section IV), and smaller ones with the same structure.

The inputs are embeddings and kind tags (``features.encode_triples``). Fully connected layers follow, each with batch
norm and leaky ReLU, and one sigmoid output. `mrtask.likelihood.network_training` trains it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from mrtask.arrays import Floats
from mrtask.likelihood.features import encode_triples
from mrtask.likelihood.model import ModelError, check_names, clip_probs, write_description
from mrtask.likelihood.options import BUNDLED

WEIGHTS_FILE = "weights.safetensors"


@dataclass(frozen=True, eq=False)
class NetworkModel:
    """A trained network, with the name of the embedding on which it was trained."""

    kind: str
    module: nn.Sequential
    layers: tuple[int, ...]
    embedding: str = BUNDLED
    cache_dir: Path | None = None

    def predict(self, names: pd.DataFrame) -> Floats:
        """Return probabilities ``[N]`` for a frame with the columns ``object``, ``container``, ``room``."""
        check_names(names)
        if not len(names):
            return np.zeros(0)
        return predict_features(self.module, encode_triples(names, self.embedding, self.cache_dir))

    def save(self, folder: Path) -> None:
        """Write weights and description."""
        folder.mkdir(parents=True, exist_ok=True)
        save_file(self.module.state_dict(), folder / WEIGHTS_FILE)
        content = {"embedding": self.embedding, "layers": self.layers, "input_size": self.module[0].in_features}
        write_description(folder, self.kind, content)

    @classmethod
    def load(cls, folder: Path, description: Mapping[str, Any], cache_dir: Path | None = None) -> "NetworkModel":
        """Load the model of a folder whose ``model.json`` has been read."""
        try:
            layers = tuple(int(width) for width in description["layers"])
            module = build_module(int(description["input_size"]), layers, seed=0)
            module.load_state_dict(load_file(folder / WEIGHTS_FILE))
        except (KeyError, RuntimeError, SafetensorError) as error:
            raise ModelError(f"{folder} holds no usable network ({error}); train the model again") from error
        return cls(str(description["kind"]), module.eval(), layers, str(description["embedding"]), cache_dir)


def build_module(input_size: int, layers: tuple[int, ...], seed: int, dropout: float = 0.0) -> nn.Sequential:
    """Build linear, batch norm and leaky ReLU per width in ``layers``, then one linear output (the logit).

    The seed decides the initial weights.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        parts: list[nn.Module] = []
        width = input_size
        for size in layers:
            parts += [nn.Linear(width, size), nn.BatchNorm1d(size), nn.LeakyReLU()]
            if dropout:
                parts.append(nn.Dropout(dropout))
            width = size
        return nn.Sequential(*parts, nn.Linear(width, 1))


def output_layer(module: nn.Sequential) -> nn.Linear:
    """Return the last layer, whose output is the logit."""
    last = module[-1]
    assert isinstance(last, nn.Linear)
    return last


def predict_features(module: nn.Module, features: NDArray[np.float32], batch_size: int = 4096) -> Floats:
    """Return the sigmoid of the network's output, ``[N]``, for features ``[N, F]``.

    This puts the network in evaluation mode.
    """
    device = next(module.parameters()).device
    module.eval()
    with torch.inference_mode():
        parts = [
            torch.sigmoid(module(torch.from_numpy(features[start : start + batch_size]).to(device)).double()).squeeze(1)
            for start in range(0, len(features), batch_size)
        ]
    return clip_probs(torch.cat(parts).cpu().numpy())
