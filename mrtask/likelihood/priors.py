"""Priors that no model was trained for, to compare a model's with: one that knows nothing, and one that knows best.

``uniform``: every container is as likely to hold an object, whatever the two are. ``oracle``: how often each kind of
container holds the object in the very homes that are asked about; no model by names alone can know more, and none that
is to be used can know as much.
"""

from collections.abc import Iterable, Sequence
from typing import Literal, get_args

import numpy as np
import pandas as pd

from mrtask.homes.home import Home
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.function import FunctionModel
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.rows import TRIPLE, vocabulary
from mrtask.likelihood.table import LikelihoodTable, build_table

Prior = Literal["model", "uniform", "oracle"]
PRIORS = get_args(Prior)
"""``model``: what a likelihood model says."""
ORACLE_SMOOTHING = 0.5
"""Rows that a coarser frequency is worth: just enough to keep what was never seen from being impossible."""


def prior_table(
    prior: Prior, model: LikelihoodModel, homes: Sequence[Home], extra_objects: Iterable[str] = ()
) -> LikelihoodTable:
    """The table of a prior for these homes; ``model`` is the one of the prior of that name.

    Raises:
        ValueError: an unknown prior.
    """
    if prior == "uniform":
        model = uniform_model(homes)
    elif prior == "oracle":
        model = FrequencyModel(count_triples(homes), ORACLE_SMOOTHING)
    elif prior != "model":
        raise ValueError(f"unknown prior {prior!r}; allowed: {', '.join(PRIORS)}")
    return build_table(model, homes, extra_objects)


def uniform_model(homes: Sequence[Home]) -> LikelihoodModel:
    """Every object is in every container with the share of pairs for which that is so in the homes."""
    containers = [container for home in homes for container in home.containers]
    share = sum(len(set(container.objects)) for container in containers) / (len(containers) * len(vocabulary(homes)))
    return FunctionModel(lambda object_, container, room: share)


def count_triples(homes: Sequence[Home], about: Sequence[str] | None = None) -> pd.DataFrame:
    """``object, container, room, positives, count`` of the homes: what `distinct_triples` makes of their rows.

    ``about``: these objects; by default all that the homes hold.
    """
    objects = {name: index for index, name in enumerate(vocabulary(homes) if about is None else about)}
    kinds = {kind: index for index, kind in enumerate(sorted({k for home in homes for k in home.container_kinds()}))}
    positives, count = np.zeros((len(objects), len(kinds)), dtype=np.int64), np.zeros(len(kinds), dtype=np.int64)
    for home in homes:
        for container, kind in zip(home.containers, home.container_kinds(), strict=True):
            count[kinds[kind]] += 1
            for name in objects.keys() & container.objects:
                positives[objects[name], kinds[kind]] += 1
    names = pd.DataFrame([(name, *kind) for name in objects for kind in kinds], columns=TRIPLE, dtype="str")
    return names.assign(positives=positives.ravel(), count=np.tile(count, len(objects)))
