"""The frequency table: how often containers held each object in training, smoothed, by container and room type.

Every learned model must beat this baseline. Each estimate is a count shrunk towards the next coarser one: (object,
container, room) towards (object, container), towards (object), towards all rows. An unseen name thus falls back on what
is known without it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mrtask.arrays import Floats
from mrtask.likelihood.metrics import log_loss
from mrtask.likelihood.model import check_names, clip_probs, read_triples, write_description, write_triples
from mrtask.likelihood.options import SMOOTHINGS
from mrtask.likelihood.rows import TRIPLE

KIND = "frequency"
COUNTS = ["positives", "count"]
LEVELS = (["container", "room"], ["object"], ["object", "container"], TRIPLE)
"""The levels from coarse to fine."""


@dataclass(frozen=True, eq=False)
class FrequencyModel:
    """The counts of the training triples. The coarser estimate is worth ``strength`` rows."""

    triples: pd.DataFrame
    strength: float = 5.0

    @property
    def kind(self) -> str:
        """Return ``frequency``."""
        return KIND

    def predict(self, names: pd.DataFrame) -> Floats:
        """Return probabilities ``[N]`` for a frame with the columns ``object``, ``container``, ``room``."""
        check_names(names)
        return self._probs(self._counts_of(names), self.strength)

    def smoothed_by(self, validation: pd.DataFrame) -> "FrequencyModel":
        """Return the model with the strength that predicts other homes best; see ``TrainingOptions``."""
        if not len(validation):
            return replace(self, strength=SMOOTHINGS[0])
        counts = self._counts_of(validation)
        best = min(SMOOTHINGS, key=lambda strength: log_loss(self._probs(counts, strength), validation))
        return replace(self, strength=best)

    def save(self, folder: Path) -> None:
        """Write the counts and the description."""
        folder.mkdir(parents=True, exist_ok=True)
        write_triples(self.triples, folder)
        write_description(folder, KIND, {"strength": self.strength})

    @classmethod
    def load(cls, folder: Path, description: Mapping[str, Any]) -> "FrequencyModel":
        """Load the model of a folder whose ``model.json`` has been read."""
        return cls(read_triples(folder), float(description["strength"]))

    @cached_property
    def _tables(self) -> list[pd.DataFrame]:
        """Return ``positives`` and ``count`` of each group, per level."""
        return [self.triples.groupby(level)[COUNTS].sum() for level in LEVELS]

    def _counts_of(self, names: pd.DataFrame) -> list[Floats]:
        """Return positives and count [2, N] of the groups to which the names belong, per level.

        They are 0 for a group never seen.
        """
        found = (
            names[level].merge(table, left_on=level, right_index=True, how="left")[COUNTS].fillna(0.0)
            for level, table in zip(LEVELS, self._tables, strict=True)
        )
        return [one.to_numpy(dtype=np.float64).T for one in found]

    def _probs(self, counts: Sequence[Floats], strength: float) -> Floats:
        total = self.triples[COUNTS].sum()
        estimate = np.full(counts[0].shape[1], (total["positives"] + 0.5) / (total["count"] + 1.0))
        for positives, count in counts:
            estimate = (positives + strength * estimate) / (count + strength)
        return clip_probs(estimate)
