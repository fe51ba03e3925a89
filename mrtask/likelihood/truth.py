"""The true likelihoods of homes: what a model without errors would say of an object, a container and a room.

Homes whose contents were drawn from the catalogue have true likelihoods. For all others, the best substitute is the
counts in the very homes on which planners are evaluated. No model could know these, and with few homes they reveal a
little about the contents of each.
"""

from collections.abc import Sequence
from functools import cache

from mrtask.homes.catalogue import load_catalogue
from mrtask.homes.contents import object_probs
from mrtask.homes.home import Home
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.function import FunctionModel
from mrtask.likelihood.rows import count_triples


def catalogue_truth() -> FunctionModel:
    """Return how likely the generator is to put an object into a container."""
    catalogue = load_catalogue()

    @cache
    def probs(room: str, container: str) -> dict[str, float]:
        return object_probs(catalogue, room, container)

    return FunctionModel(lambda name, container, room: probs(room, container).get(name, 0.0))


def counted_truth(homes: Sequence[Home]) -> FrequencyModel:
    """Return how often an object lies in the containers of a kind in these homes.

    Rare kinds borrow from similar ones.
    """
    return FrequencyModel(count_triples(homes))
