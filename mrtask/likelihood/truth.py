"""The true likelihoods of homes: what a model that made no error would say of an object, a container and a room.

Homes whose contents were drawn from the catalogue have them. For all others the best that can be had are the counts of
the very homes that planners are evaluated on: no model could know these, and where there are few homes, they know a
little of what is in each.
"""

from collections import Counter
from collections.abc import Sequence
from functools import cache

import pandas as pd

from mrtask.homes.catalogue import load_catalogue
from mrtask.homes.contents import object_probs
from mrtask.homes.home import Home
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.function import FunctionModel
from mrtask.likelihood.rows import TRIPLE, vocabulary


def catalogue_truth() -> FunctionModel:
    """How likely the generator is to put an object into a container."""
    catalogue = load_catalogue()

    @cache
    def probs(room: str, container: str) -> dict[str, float]:
        return object_probs(catalogue, room, container)

    return FunctionModel(lambda name, container, room: probs(room, container).get(name, 0.0))


def counted_truth(homes: Sequence[Home]) -> FrequencyModel:
    """How often an object lies in the containers of a kind in these homes; rare kinds lean on similar ones."""
    objects = vocabulary(homes)
    containers = Counter(kind for home in homes for kind in home.container_kinds())
    held = Counter(
        (name, *kind)
        for home in homes
        for container, kind in zip(home.containers, home.container_kinds(), strict=True)
        for name in set(container.objects)
    )
    rows = [(name, *kind, held[name, *kind], count) for kind, count in sorted(containers.items()) for name in objects]
    triples = pd.DataFrame(rows, columns=[*TRIPLE, "positives", "count"])
    return FrequencyModel(triples.astype(dict.fromkeys(TRIPLE, "str")))
