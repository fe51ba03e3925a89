"""Logistic regression on the embeddings: the simplest model that can score unseen names."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file
from scipy.special import expit

from mrtask.arrays import Floats
from mrtask.likelihood.features import encode_triples
from mrtask.likelihood.model import check_names, clip_probs, write_description
from mrtask.likelihood.options import BUNDLED

KIND = "logistic"
WEIGHTS_FILE = "weights.safetensors"


@dataclass(frozen=True, eq=False)
class LogisticModel:
    """``sigmoid(features @ coefficients + intercept)`` with ``coefficients [F]``."""

    coefficients: Floats
    intercept: float
    embedding: str = BUNDLED
    cache_dir: Path | None = None

    @property
    def kind(self) -> str:
        """Return ``logistic``."""
        return KIND

    def predict(self, names: pd.DataFrame) -> Floats:
        """Return probabilities ``[N]`` for a frame with the columns ``object``, ``container``, ``room``."""
        check_names(names)
        if not len(names):
            return np.zeros(0)
        features = encode_triples(names, self.embedding, self.cache_dir).astype(np.float64)
        return clip_probs(expit(features @ self.coefficients + self.intercept))

    def save(self, folder: Path) -> None:
        """Write weights and description."""
        folder.mkdir(parents=True, exist_ok=True)
        save_file({"coefficients": self.coefficients, "intercept": np.array([self.intercept])}, folder / WEIGHTS_FILE)
        write_description(folder, KIND, {"embedding": self.embedding})

    @classmethod
    def load(cls, folder: Path, description: Mapping[str, Any], cache_dir: Path | None = None) -> "LogisticModel":
        """Load the model of a folder whose ``model.json`` has been read."""
        weights = load_file(folder / WEIGHTS_FILE)
        return cls(weights["coefficients"], float(weights["intercept"][0]), str(description["embedding"]), cache_dir)


def train_logistic(
    features: NDArray[np.float32],
    triples: pd.DataFrame,
    regularisation: float = 1.0,
    embedding: str = BUNDLED,
    cache_dir: Path | None = None,
) -> LogisticModel:
    """Fit on triples with counts; ``regularisation`` is the inverse strength of the L2 penalty (scikit-learn's C)."""
    from sklearn.linear_model import LogisticRegression

    positives, count = triples["positives"].to_numpy(), triples["count"].to_numpy()
    label = np.repeat([1, 0], len(triples))
    weight = np.concatenate([positives, count - positives]).astype(np.float64)
    used = weight > 0
    fitted = LogisticRegression(C=regularisation, solver="newton-cholesky")
    fitted.fit(np.tile(features.astype(np.float64), (2, 1))[used], label[used], sample_weight=weight[used])
    return LogisticModel(fitted.coef_[0].copy(), float(fitted.intercept_[0]), embedding, cache_dir)
