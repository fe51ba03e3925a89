"""From a dataset to a trained model with its metrics: what ``pipeline.train`` calls. Knows nothing of MLflow."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from mrtask.likelihood.dataset import Dataset
from mrtask.likelihood.embeddings import BUNDLED
from mrtask.likelihood.features import encode_triples
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.logistic import train_logistic
from mrtask.likelihood.metrics import evaluate
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.network import EpochCallback, EpochMetrics, NetworkModel, NetworkOptions, train_network
from mrtask.likelihood.rows import SPLITS
from mrtask.likelihood.similarity import train_similarity

UNSEEN_FOLDS = 5
NETWORK_KINDS = ("paper_fcnn", "mlp")
TRAINED_AT_ONCE = ("similarity", "frequency")
MODEL_KINDS = ("similarity", "paper_fcnn", "mlp", "logistic", "frequency")


@dataclass(frozen=True)
class TrainingOptions:
    """Which model, on which embedding, and the options of each kind.

    ``network`` is for ``paper_fcnn`` and ``mlp``; ``regularisation`` for ``logistic`` (scikit-learn's C); ``smoothing``
    for ``frequency`` and ``similarity``: how many rows the coarser estimate is worth.
    """

    kind: str = "similarity"
    embedding: str = BUNDLED
    network: NetworkOptions = field(default_factory=NetworkOptions)
    regularisation: float = 1.0
    smoothing: float = 5.0
    cache_dir: Path | None = None
    checkpoint_dir: Path | None = None

    def __post_init__(self) -> None:
        if self.kind not in MODEL_KINDS:
            raise ValueError(f"unknown likelihood model {self.kind!r}; allowed: {', '.join(MODEL_KINDS)}")
        if self.regularisation <= 0 or self.smoothing <= 0:
            raise ValueError(
                f"regularisation and smoothing must be above 0, got {self.regularisation}, {self.smoothing}"
            )


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """A model, its ``metrics`` (``metrics.evaluate``) and, for networks, its ``history`` per epoch.

    ``metrics`` has the keys ``train``, ``validation``, ``test`` and, for ``TRAINED_AT_ONCE``, ``unseen``
    (``score_unseen``).
    """

    model: LikelihoodModel
    options: TrainingOptions
    metrics: dict[str, dict[str, float]]
    history: list[EpochMetrics]


def train_model(
    dataset: Dataset,
    options: TrainingOptions,
    on_epoch: EpochCallback | None = None,
    on_phase: Callable[[str], None] | None = None,
) -> TrainedModel:
    """Train on the train split, stop by the validation split, and measure on train, validation and test.

    ``on_epoch(epoch, {"train_loss", "validation_loss", ...})`` is called after each epoch, ``on_phase(text)`` before
    each long step.
    """
    model, history = fit(dataset.triples("train"), dataset.triples("validation"), options, on_epoch, on_phase)
    if on_phase is not None:
        on_phase("measuring")
    metrics = {split: score(model, dataset.triples(split)) for split in SPLITS}
    if options.kind in TRAINED_AT_ONCE:
        metrics["unseen"] = score_unseen(dataset, options)
    return TrainedModel(model, options, metrics, history)


def fit(
    train: pd.DataFrame,
    validation: pd.DataFrame,
    options: TrainingOptions,
    on_epoch: EpochCallback | None = None,
    on_phase: Callable[[str], None] | None = None,
) -> tuple[LikelihoodModel, list[EpochMetrics]]:
    """A model of triples with ``positives`` and ``count``, and for networks its history; see ``train_model``."""
    tell = on_phase or (lambda text: None)
    history: list[EpochMetrics] = []
    model: LikelihoodModel
    if options.kind == "frequency":
        model = FrequencyModel(train, options.smoothing)
    elif options.kind == "similarity":
        tell("embedding names and fitting")
        model = train_similarity(train, options.smoothing, options.embedding, options.cache_dir)
    else:
        tell("embedding names")
        features = encode_triples(train, options.embedding, options.cache_dir)
        tell(f"training {options.kind}")
        if options.kind == "logistic":
            model = train_logistic(features, train, options.regularisation, options.embedding, options.cache_dir)
        else:
            module, history = train_network(
                features,
                train,
                encode_triples(validation, options.embedding, options.cache_dir),
                validation,
                options.network,
                on_epoch,
                options.checkpoint_dir,
            )
            model = NetworkModel(options.kind, module, options.network.layers, options.embedding, options.cache_dir)
    return model, history


def score(model: LikelihoodModel, triples: pd.DataFrame) -> dict[str, float]:
    """``metrics.evaluate`` of a model on triples with ``positives`` and ``count``."""
    return evaluate(model.predict(triples), triples)


def score_unseen(
    dataset: Dataset, options: TrainingOptions, column: str = "object", folds: int = UNSEEN_FOLDS
) -> dict[str, float]:
    """Metrics on the test homes for names never seen: each fold's names are predicted by a model trained without them.

    ``column``: ``object`` or ``container``. Names are dealt to the folds by their hash, the same for every model.
    """
    train, validation, test = (dataset.triples(split) for split in SPLITS)
    fold_of = {
        name: place % folds
        for place, name in enumerate(
            sorted(train[column].unique(), key=lambda name: hashlib.sha256(name.encode()).digest())
        )
    }
    probs, scored = [], []
    options = replace(options, checkpoint_dir=None)
    for fold in range(min(folds, len(fold_of))):
        held = [frame[column].map(fold_of) == fold for frame in (train, validation, test)]
        if not (~held[0]).any() or not held[2].any():
            continue
        model, _ = fit(train[~held[0]], validation[~held[1]], options)
        scored.append(test[held[2]])
        probs.append(model.predict(scored[-1]))
    if not scored:
        return evaluate(np.zeros(0), test.head(0))
    return evaluate(np.concatenate(probs), pd.concat(scored))
