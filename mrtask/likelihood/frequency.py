"""The frequency table: how often each (object, container type, room type) held true in training, smoothed.

The baseline that every learned model must justify itself against. Each estimate is a count shrunk towards the next
coarser one: (object, container, room) towards (object, container), towards (object), towards all rows; so a name never
seen backs off to what is known without it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mrtask.likelihood.metrics import log_loss
from mrtask.likelihood.model import check_names, clip_probs, read_triples, write_description, write_triples
from mrtask.likelihood.options import SMOOTHINGS
from mrtask.likelihood.rows import TRIPLE

KIND = "frequency"


@dataclass(frozen=True, eq=False)
class FrequencyModel:
    """Counts of the training triples; ``strength``: how many rows the coarser estimate is worth."""

    triples: pd.DataFrame
    strength: float = 5.0

    @property
    def kind(self) -> str:
        """``frequency``."""
        return KIND

    def predict(self, names: pd.DataFrame) -> NDArray[np.float64]:
        """Probabilities ``[N]`` for a frame with the columns ``object``, ``container``, ``room``."""
        check_names(names)
        total = self.triples[["positives", "count"]].sum()
        estimate = np.full(len(names), (total["positives"] + 0.5) / (total["count"] + 1.0))
        for level in (["container", "room"], ["object"], ["object", "container"], TRIPLE):
            table = self.triples.groupby(level)[["positives", "count"]].sum()
            found = names[level].merge(table, left_on=level, right_index=True, how="left")[["positives", "count"]]
            found = found.fillna(0.0)
            estimate = (found["positives"].to_numpy() + self.strength * estimate) / (
                found["count"].to_numpy() + self.strength
            )
        return clip_probs(estimate)

    def save(self, folder: Path) -> None:
        """Write the counts and the description."""
        folder.mkdir(parents=True, exist_ok=True)
        write_triples(self.triples, folder)
        write_description(folder, KIND, {"strength": self.strength})

    @classmethod
    def load(cls, folder: Path, description: Mapping[str, Any]) -> "FrequencyModel":
        """The model of a folder whose ``model.json`` has been read."""
        return cls(read_triples(folder), float(description["strength"]))


def best_smoothing(triples: pd.DataFrame, validation: pd.DataFrame) -> float:
    """The strength that predicts other homes best; see ``TrainingOptions``."""
    if not len(validation):
        return SMOOTHINGS[0]
    return min(
        SMOOTHINGS, key=lambda strength: log_loss(FrequencyModel(triples, strength).predict(validation), validation)
    )
