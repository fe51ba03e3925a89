"""Turn a dataset into a trained model with its metrics, as ``pipeline.train`` does, without MLflow."""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np
import pandas as pd

from mrtask.errors import InputError
from mrtask.homes.home import Home
from mrtask.likelihood.dataset import Dataset
from mrtask.likelihood.kinds import KINDS, Job
from mrtask.likelihood.metrics import evaluate
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.options import EpochCallback, EpochMetrics, TrainingOptions
from mrtask.likelihood.rows import SPLITS, distinct_triples, label_rows, vocabulary

UNSEEN_FOLDS = 5


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """A model, its ``metrics`` (``metrics.evaluate``) and, for networks, its ``history`` per epoch.

    ``metrics`` has the keys ``train``, ``validation``, ``test`` and, for kinds that are ``trained_at_once``,
    ``unseen`` (``score_unseen``).
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
    """Train on the train split, stop early by the validation split, and measure on train, validation and test.

    ``on_epoch(epoch, {"train_loss", "validation_loss", ...})`` is called after each epoch, ``on_phase(text)`` before
    each long step.
    """
    model, history = fit(dataset.triples("train"), dataset.triples("validation"), options, on_epoch, on_phase)
    if on_phase is not None:
        on_phase("measuring")
    metrics = {split: score(model, dataset.triples(split)) for split in SPLITS}
    if KINDS[options.kind].trained_at_once:
        metrics["unseen"] = score_unseen({split: dataset.triples(split) for split in SPLITS}, options)
    return TrainedModel(model, options, metrics, history)


def fit(
    train: pd.DataFrame,
    validation: pd.DataFrame,
    options: TrainingOptions,
    on_epoch: EpochCallback | None = None,
    on_phase: Callable[[str], None] | None = None,
) -> tuple[LikelihoodModel, list[EpochMetrics]]:
    """Fit a model to triples with ``positives`` and ``count``; return it and a network's history (see ``train_model``).

    Raises:
        ValueError: the kind is unknown.
    """
    if options.kind not in KINDS:
        raise ValueError(f"unknown likelihood model {options.kind!r}; allowed: {', '.join(KINDS)}")
    return KINDS[options.kind].train(Job(train, validation, options, on_epoch, on_phase or _say_nothing))


def fit_on_homes(
    train: Iterable[Home], validation: Iterable[Home] = (), options: TrainingOptions | None = None
) -> LikelihoodModel:
    """Train a model on homes; by default the frequency table, which needs neither torch nor embeddings.

    The ``validation`` homes decide when networks stop and how counts are smoothed. Other kinds, such as
    ``TrainingOptions(kind="similarity")``, need the extra ``mrtask[train]``.
    """
    options = options or TrainingOptions(kind="frequency")
    if options.kind != "frequency" and find_spec("sklearn") is None:
        raise InputError(f"a model of kind {options.kind!r} needs more packages: pip install 'mrtask[train]'")
    homes = list(train)
    objects = vocabulary(homes)
    if not objects:
        raise ValueError("there is nothing to learn from: no home has an object in a container")
    learned_from, checked_on = (
        distinct_triples(pd.concat([label_rows(home, objects) for home in part])) if part else pd.DataFrame()
        for part in (homes, list(validation))
    )
    return fit(learned_from, checked_on, options)[0]


def _say_nothing(phase: str) -> None:
    """Ignore the phases, for callers that do not follow them."""


def score(model: LikelihoodModel, triples: pd.DataFrame) -> dict[str, float]:
    """Return ``metrics.evaluate`` of a model on triples with ``positives`` and ``count``."""
    return evaluate(model.predict(triples), triples)


def score_unseen(
    triples: Mapping[str, pd.DataFrame], options: TrainingOptions, column: str = "object", folds: int = UNSEEN_FOLDS
) -> dict[str, float]:
    """Return metrics on the test homes for names never seen.

    A model trained without a fold's names predicts them. ``triples`` are those of each split, and ``column`` is
    ``object`` or ``container``. Names are dealt to the folds in the order of their hashes, so that the folds are the
    same for every model.
    """
    train, validation, test = (triples[split] for split in SPLITS)
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
