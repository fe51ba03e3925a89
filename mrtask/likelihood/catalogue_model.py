"""A likelihood model that needs no training data: the similarity model on the catalogue's counts.

For a map of one's own before anything was trained. What it knows are ProcTHOR's rates, as far as the catalogue keeps
them (`mrtask.homes.catalogue`); names that are not in it get those of similar names.
"""

from functools import cache
from pathlib import Path

import pandas as pd

from mrtask.homes.catalogue import load_catalogue
from mrtask.likelihood.rows import TRIPLE
from mrtask.likelihood.similarity import SimilarityModel, train_similarity

CONTAINERS_OF_A_KIND = 100
"""What each (container type, room type) counts for: the catalogue has the rates, not the numbers behind them."""


def catalogue_triples() -> pd.DataFrame:
    """``object, container, room, positives, count`` for all objects and kinds of containers of the catalogue."""
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
    """The model; the first call embeds some hundred names (seconds), which ``cache_dir`` keeps."""
    return train_similarity(catalogue_triples(), cache_dir=cache_dir)
