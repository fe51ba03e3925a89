"""The input of a model on embeddings for (object, container type, room type): three embeddings, each with its kind.

As in the paper, each part is the embedding of a name (D numbers) and a one-hot of the kind of thing that it names, D +
4 numbers in all.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mrtask.arrays import Ints
from mrtask.likelihood.embeddings import embed_names
from mrtask.likelihood.rows import TRIPLE

KINDS = ("home", "room", "container", "object")


@dataclass(frozen=True, eq=False)
class NameFeatures:
    """The features of N triples, once per distinct name: part ``p`` of row ``n`` is ``vectors[p][codes[p, n]]``."""

    vectors: tuple[NDArray[np.float32], ...]
    codes: Ints

    def __len__(self) -> int:
        return int(self.codes.shape[1])

    @property
    def width(self) -> int:
        """Return the length of a row."""
        return sum(part.shape[1] for part in self.vectors)

    def rows(self) -> NDArray[np.float32]:
        """Return all features written out, ``[N, width]``."""
        return np.hstack([part[codes] for part, codes in zip(self.vectors, self.codes, strict=True)])


def name_features(names: pd.DataFrame, embedding: str, cache_dir: Path | None = None) -> NameFeatures:
    """Return the features of a frame with the columns ``object``, ``container``, ``room``.

    They are three parts of ``D + 4`` numbers.
    """
    vectors, codes = [], []
    for kind in TRIPLE:
        code, distinct = pd.factorize(names[kind])
        embedded = embed_names(list(distinct), embedding, cache_dir)
        tag = np.zeros(len(KINDS), dtype=np.float32)
        tag[KINDS.index(kind)] = 1.0
        vectors.append(np.hstack([embedded, np.tile(tag, (len(embedded), 1))]))
        codes.append(code)
    return NameFeatures(tuple(vectors), np.stack(codes).astype(np.int64))


def encode_triples(names: pd.DataFrame, embedding: str, cache_dir: Path | None = None) -> NDArray[np.float32]:
    """Return ``[N, 3 * (D + 4)]`` for a frame with the columns ``object``, ``container``, ``room``."""
    return name_features(names, embedding, cache_dir).rows()
