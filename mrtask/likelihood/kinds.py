"""The likelihood models by kind: how each is trained, and how it is loaded from the folder where it was saved.

A new kind is a module with a model (`mrtask.likelihood.model.LikelihoodModel`) and a line in `KINDS`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from mrtask.likelihood.features import encode_triples, name_features
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.logistic import LogisticModel, train_logistic
from mrtask.likelihood.model import LikelihoodModel, ModelError, read_description
from mrtask.likelihood.options import SMOOTHINGS, EpochCallback, EpochMetrics, TrainingOptions
from mrtask.likelihood.similarity import SimilarityModel, train_similarity


@dataclass(frozen=True, eq=False)
class Job:
    """The data for training a model: triples with ``positives`` and ``count``. ``tell`` announces each long step."""

    train: pd.DataFrame
    validation: pd.DataFrame
    options: TrainingOptions
    on_epoch: EpochCallback | None
    tell: Callable[[str], None]


Fitted = tuple[LikelihoodModel, list[EpochMetrics]]
"""A trained model and, for networks, its metrics per epoch."""
Description = Mapping[str, Any]


class Kind(NamedTuple):
    """One kind of model. With ``trained_at_once``, training takes seconds, so it is also measured on unseen names."""

    train: Callable[[Job], Fitted]
    load: Callable[[Path, Description, Path | None], LikelihoodModel]
    trained_at_once: bool = False


def _train_frequency(job: Job) -> Fitted:
    model = FrequencyModel(job.train, job.options.smoothing or SMOOTHINGS[0])
    if job.options.smoothing is None:
        model = model.smoothed_by(job.validation)
    job.tell(f"smoothed by {model.strength:g} rows")
    return model, []


def _load_frequency(folder: Path, description: Description, cache_dir: Path | None) -> LikelihoodModel:
    return FrequencyModel.load(folder, description)


def _train_similarity(job: Job) -> Fitted:
    options = job.options
    job.tell("embedding names and fitting")
    model = train_similarity(job.train, options.smoothing or SMOOTHINGS[0], options.embedding, options.cache_dir)
    if options.smoothing is None:
        model = model.smoothed_by(job.validation)
    job.tell(f"smoothed by {model.strength:g} rows")
    return model, []


def _train_logistic(job: Job) -> Fitted:
    options = job.options
    job.tell("embedding names")
    features = encode_triples(job.train, options.embedding, options.cache_dir)
    job.tell("training logistic")
    return train_logistic(features, job.train, options.regularisation, options.embedding, options.cache_dir), []


def _train_network(job: Job) -> Fitted:
    from mrtask.likelihood.network import NetworkModel  # torch takes seconds to import
    from mrtask.likelihood.network_training import train_network

    options = job.options
    job.tell("embedding names")
    train, validation = (
        name_features(triples, options.embedding, options.cache_dir) for triples in (job.train, job.validation)
    )
    job.tell(f"training {options.kind}")
    module, history = train_network(
        train, job.train, validation, job.validation, options.network, job.on_epoch, options.checkpoint_dir
    )
    return NetworkModel(options.kind, module, options.network.layers, options.embedding, options.cache_dir), history


def _load_network(folder: Path, description: Description, cache_dir: Path | None) -> LikelihoodModel:
    from mrtask.likelihood.network import NetworkModel

    return NetworkModel.load(folder, description, cache_dir)


KINDS: Mapping[str, Kind] = {
    "similarity": Kind(_train_similarity, SimilarityModel.load, trained_at_once=True),
    "paper_fcnn": Kind(_train_network, _load_network),
    "mlp": Kind(_train_network, _load_network),
    "logistic": Kind(_train_logistic, LogisticModel.load),
    "frequency": Kind(_train_frequency, _load_frequency, trained_at_once=True),
}


def load_model(folder: Path, cache_dir: Path | None = None) -> LikelihoodModel:
    """Load a stored model of any kind; ``cache_dir`` keeps the embeddings of names (``embed_names``).

    Raises:
        ModelError: the model is missing, damaged, or of a kind that this version does not know.
    """
    description = read_description(folder)
    kind = description["kind"]
    if kind not in KINDS:
        raise ModelError(f"{folder}: unknown kind of model {kind!r}: update mrtask, or train the model again")
    return KINDS[kind].load(folder, description, cache_dir)
