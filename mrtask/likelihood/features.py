"""What a model on embeddings sees of (object, container type, room type): three embeddings, each followed by its kind.

The paper's input: the embedding of a name (D numbers) and a one-hot of what kind of thing it names, D + 4 in all.
"""

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mrtask.likelihood.embeddings import embed_names
from mrtask.likelihood.rows import TRIPLE

KINDS = ("home", "room", "container", "object")


def encode_triples(names: pd.DataFrame, embedding: str, cache_dir: Path | None = None) -> NDArray[np.float32]:
    """``[N, 3 * (D + 4)]`` for a frame with the columns ``object``, ``container``, ``room``."""
    blocks = []
    for kind in TRIPLE:
        codes, distinct = pd.factorize(names[kind])
        vectors = embed_names(list(distinct), embedding, cache_dir)
        tag = np.zeros(len(KINDS), dtype=np.float32)
        tag[KINDS.index(kind)] = 1.0
        blocks.append(np.hstack([vectors, np.tile(tag, (len(vectors), 1))])[codes])
    return np.hstack(blocks)
