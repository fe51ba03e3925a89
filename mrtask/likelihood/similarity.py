"""A model that uses counts where training has them, and elsewhere the counts of similar names.

A prior for any names, seen or not, is a logistic regression on four numbers: how often anything lies in this kind of
container, how often objects with similar names do, and how similar the object's name is to the container's and to the
room's. It is fitted with each training object's own counts left out, so it learns how far similarity can be trusted for
an unseen object. Where training counts exist, they then correct it: per object, per object and room, per object and
container type (by the ratio of observed to expected finds, shrunk to 1), and per triple (the mean of prior and
frequency). With few data it is the prior; with many it becomes the frequency table.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import logit

from mrtask.arrays import Floats
from mrtask.likelihood.embeddings import embed_names
from mrtask.likelihood.metrics import log_loss
from mrtask.likelihood.model import ModelError, check_names, clip_probs, read_triples, write_description, write_triples
from mrtask.likelihood.options import BUNDLED, SMOOTHINGS
from mrtask.likelihood.rows import TRIPLE
from mrtask.names import name_to_text

KIND = "similarity"
OBJECT_TEMPERATURE, KIND_TEMPERATURE = 0.05, 0.1
"""How fast the weight of another name falls with the cosine similarity; chosen on real homes, checked on generated
ones."""
PSEUDO_ROWS = 1.0
BASE_SHARE = 0.02
EPSILON = float(np.finfo(np.float64).tiny)
WEAK_PENALTY = 1e3
"""Scikit-learn's C: the fit has five numbers and thousands of rows."""
LEVELS = (["object"], ["object", "room"], ["object", "container"])


@dataclass(frozen=True, eq=False)
class SimilarityModel:
    """Training triples in words, the prior's ``weights [5]`` (four features and a constant), and the prior's strength.

    For a triple, the prior is worth ``strength`` rows; for a coarser group, ``strength`` expected finds.
    """

    triples: pd.DataFrame
    weights: Floats
    strength: float = 5.0
    embedding: str = BUNDLED
    cache_dir: Path | None = None

    @property
    def kind(self) -> str:
        """Return ``similarity``."""
        return KIND

    def predict(self, names: pd.DataFrame) -> Floats:
        """Return probabilities ``[N]`` for a frame with the columns ``object``, ``container``, ``room``."""
        check_names(names)
        if not len(names):
            return np.zeros(0)
        names = _as_texts(names)
        return self._probs(names, self._odds(names), self.strength)

    def smoothed_by(self, validation: pd.DataFrame) -> "SimilarityModel":
        """Return the model with the strength that predicts other homes best; see ``TrainingOptions``."""
        if not len(validation):
            return replace(self, strength=SMOOTHINGS[0])
        names = _as_texts(validation)
        odds = self._odds(names)
        best = min(SMOOTHINGS, key=lambda strength: log_loss(self._probs(names, odds, strength), validation))
        return replace(self, strength=best)

    def save(self, folder: Path) -> None:
        """Write counts and description."""
        folder.mkdir(parents=True, exist_ok=True)
        write_triples(self.triples, folder)
        content = {"embedding": self.embedding, "strength": self.strength, "weights": self.weights.tolist()}
        write_description(folder, KIND, content)

    @classmethod
    def load(cls, folder: Path, description: Mapping[str, Any], cache_dir: Path | None = None) -> "SimilarityModel":
        """Load the model of a folder whose ``model.json`` has been read."""
        weights = np.array(description["weights"], dtype=np.float64)
        if weights.shape != (5,):
            raise ModelError(f"{folder}: expected 5 weights, found shape {weights.shape}; train the model again")
        return cls(
            read_triples(folder), weights, float(description["strength"]), str(description["embedding"]), cache_dir
        )

    @cached_property
    def _known(self) -> "_Known":
        return _Known(self.triples, self.embedding, self.cache_dir)

    @cached_property
    def _own_odds(self) -> Floats:
        return self._odds(self.triples)

    def _odds(self, names: pd.DataFrame) -> Floats:
        """Return the prior's odds for any names in words."""
        return np.asarray(np.exp(self._known.features(names) @ self.weights[:-1] + self.weights[-1]))

    def _probs(self, names: pd.DataFrame, odds: Floats, strength: float) -> Floats:
        for level, ratio in zip(LEVELS, self._ratios(strength), strict=True):
            odds = odds * _look_up(names, level, ratio, 1.0)
        prior = odds / (1.0 + odds)
        counts = self.triples.set_index(TRIPLE)
        positives, count = (_look_up(names, TRIPLE, counts[column], 0.0) for column in ("positives", "count"))
        return clip_probs((positives + strength * prior) / (count + strength))

    def _ratios(self, strength: float) -> list[pd.Series]:
        """Return the ratio of observed to expected finds of each group, per level.

        Each level's expectation includes the levels before it.
        """
        odds, ratios = self._own_odds, []
        for level in LEVELS:
            expected = odds / (1.0 + odds) * self.triples["count"].to_numpy()
            finds = self.triples.assign(expected=expected).groupby(level)[["positives", "expected"]].sum()
            ratio = (finds["positives"] + strength) / (finds["expected"] + strength)
            odds = odds * _look_up(self.triples, level, ratio, 1.0)
            ratios.append(ratio)
        return ratios


def train_similarity(
    triples: pd.DataFrame, strength: float = 5.0, embedding: str = BUNDLED, cache_dir: Path | None = None
) -> SimilarityModel:
    """Fit the prior by weighted maximum likelihood; each training object is predicted from the others."""
    from sklearn.linear_model import LogisticRegression

    counts = triples[["positives", "count"]].reset_index(drop=True)
    triples = _as_texts(triples).join(counts).groupby(TRIPLE, as_index=False).sum()
    features = _Known(triples, embedding, cache_dir).features(triples)
    positives, count = triples["positives"].to_numpy(), triples["count"].to_numpy()
    fitted = LogisticRegression(C=WEAK_PENALTY, max_iter=2000)
    label = np.repeat([1, 0], len(triples))
    fitted.fit(np.tile(features, (2, 1)), label, sample_weight=np.concatenate([positives, count - positives]))
    weights = np.append(fitted.coef_[0], fitted.intercept_[0])
    return SimilarityModel(triples, weights, strength, embedding, cache_dir)


class _Known:
    """Training counts ``[O, K]`` of O objects and K kinds of containers, and the embeddings of their names."""

    def __init__(self, triples: pd.DataFrame, embedding: str, cache_dir: Path | None) -> None:
        self.embedding, self.cache_dir = embedding, cache_dir
        kinds = triples[["container", "room"]].drop_duplicates().sort_values(["container", "room"])
        row, objects = pd.factorize(triples["object"])
        column = pd.MultiIndex.from_frame(kinds).get_indexer(pd.MultiIndex.from_frame(triples[["container", "room"]]))
        self.positives, self.count = np.zeros((2, len(objects), len(kinds)))
        self.positives[row, column] = triples["positives"]
        self.count[row, column] = triples["count"]
        self.objects = self._embed(objects)
        self.containers, self.rooms = self._embed(kinds["container"]), self._embed(kinds["room"])

    def features(self, names: pd.DataFrame) -> Floats:
        """Return ``[N, 4]`` features; a training object's own counts are left out of its features."""
        row, objects = pd.factorize(names["object"])
        kinds = names[["container", "room"]].drop_duplicates()
        column = pd.MultiIndex.from_frame(kinds).get_indexer(pd.MultiIndex.from_frame(names[["container", "room"]]))
        object_, container, room = (self._embed(part) for part in (objects, kinds["container"], kinds["room"]))

        closeness = container @ self.containers.T + room @ self.rooms.T - 2.0
        kind_weight = np.exp(closeness / KIND_TEMPERATURE)
        # [O, M]: finds and rows of each training object in containers like each of the M requested ones
        finds, rows = self.positives @ kind_weight.T, self.count @ kind_weight.T
        likeness = object_ @ self.objects.T
        other = likeness < 1.0 - 1e-5
        overall = self.positives.sum() / self.count.sum()
        base = (other @ finds + PSEUDO_ROWS * overall) / (other @ rows + PSEUDO_ROWS)
        weight = np.exp((likeness - 1.0) / OBJECT_TEMPERATURE) * other
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), EPSILON)
        alike = weight @ ((finds + PSEUDO_ROWS * overall) / (rows + PSEUDO_ROWS))
        alike = (alike + BASE_SHARE * base) / (1.0 + BASE_SHARE)
        columns = [logit(np.clip(grid, 1e-4, 1 - 1e-4))[row, column] for grid in (base, alike)]
        columns += [(object_ @ part.T)[row, column] for part in (container, room)]
        return np.stack(columns, axis=1)

    def _embed(self, names: Any) -> Floats:
        vectors = embed_names(list(names), self.embedding, self.cache_dir).astype(np.float64)
        return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), EPSILON))


def _as_texts(names: pd.DataFrame) -> pd.DataFrame:
    """Return the three columns in words, so that ``RemoteControl`` and ``remote control`` are one name."""
    return pd.DataFrame({kind: pd.array([name_to_text(name) for name in names[kind]], dtype="str") for kind in TRIPLE})


def _look_up(names: pd.DataFrame, level: list[str], values: "pd.Series[float]", default: float) -> Floats:
    index = pd.MultiIndex.from_frame(names[level]) if len(level) > 1 else pd.Index(names[level[0]])
    return np.asarray(values.reindex(index).fillna(default), dtype=np.float64)
