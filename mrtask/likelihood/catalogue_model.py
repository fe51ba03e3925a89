"""A likelihood model that needs no training data: the similarity model on the catalogue's counts.

Use it on a map of your own before you have trained anything. It knows ProcTHOR's rates as far as the catalogue has them
(`mrtask.homes.catalogue`). Names that are not in the catalogue get the rates of similar names.
"""

from functools import cache
from pathlib import Path

import pandas as pd

from mrtask.homes.catalogue import load_catalogue
from mrtask.likelihood.rows import TRIPLE
from mrtask.likelihood.similarity import SimilarityModel, train_similarity

CONTAINERS_OF_A_KIND = 100
"""The weight of each (container type, room type), since the catalogue has the rates but not the counts behind them."""


def catalogue_triples() -> pd.DataFrame:
    """Return ``object, container, room, positives, count`` for all objects and kinds of containers of the catalogue."""
    kinds = [
        (container, room, facts["likelihoods"])
        for room, containers in load_catalogue().objects.items()
        for container, facts in containers.items()
    ]
    names = sorted({name for _, _, likelihoods in kinds for name in likelihoods})
    rows = [
        (name, container, room, round(CONTAINERS_OF_A_KIND * likelihoods.get(name, 0.0)), CONTAINERS_OF_A_KIND)
        for container, room, likelihoods in kinds
        for name in names
    ]
    return pd.DataFrame(rows, columns=[*TRIPLE, "positives", "count"]).astype(dict.fromkeys(TRIPLE, "str"))


@cache
def catalogue_model(cache_dir: Path | None = None) -> SimilarityModel:
    """Return the model; the first call embeds a few hundred names (seconds), which ``cache_dir`` keeps."""
    return train_similarity(catalogue_triples(), cache_dir=cache_dir)
