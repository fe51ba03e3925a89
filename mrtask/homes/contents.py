"""Draws which objects lie in a container, from the catalogue's counts and likelihoods by room and container.

For the generator, and for homes whose furniture is known but whose contents are not (a scanned floor).
"""

from dataclasses import replace

import numpy as np

from mrtask.homes.catalogue import Catalogue, load_catalogue
from mrtask.homes.home import Home

LIKELIHOOD_BOUNDS = (1e-3, 1 - 1e-3)
"""Likelihoods are kept off 0 and 1, where log odds have no end."""


def draw_objects(catalogue: Catalogue, room_type: str, container_type: str, rng: np.random.Generator) -> list[str]:
    """Distinct object types: their number from the catalogue's shares, then by likelihood without replacement."""
    facts = catalogue.objects.get(room_type, {}).get(container_type)
    if facts is None or not facts["likelihoods"]:
        return []
    kinds = list(facts["likelihoods"])
    likelihood_prob = np.clip(np.array(list(facts["likelihoods"].values())), *LIKELIHOOD_BOUNDS)
    shares = np.array(facts["distinct_objects"])
    count = min(int(rng.choice(len(shares), p=shares / shares.sum())), len(kinds))
    # The largest Gumbel-shifted log odds are a draw without replacement, which keeps the likelihoods nearly.
    keys = np.log(likelihood_prob / (1 - likelihood_prob)) + rng.gumbel(size=len(kinds))
    return [kinds[index] for index in np.argsort(-keys, kind="stable")[:count]]


def rooms_with(catalogue: Catalogue, container_type: str) -> list[str]:
    """The room types in which the catalogue knows what such a container holds, sorted."""
    return sorted(room for room, containers in catalogue.objects.items() if container_type in containers)


def fill_home(home: Home, rng: np.random.Generator) -> Home:
    """The home with its containers' contents drawn anew.

    A container in a room where the catalogue knows none of its type holds what one of another room does; one of a type
    that the catalogue does not know at all stays empty (ask `rooms_with` first).
    """
    catalogue = load_catalogue()
    filled = []
    for container, (container_type, room_type) in zip(home.containers, home.container_kinds(), strict=True):
        known = rooms_with(catalogue, container_type)
        if room_type not in known and known:
            room_type = known[int(rng.integers(len(known)))]
        objects = draw_objects(catalogue, room_type, container_type, rng)
        filled.append(replace(container, objects=tuple(sorted(objects))))
    return replace(home, containers=tuple(filled))
