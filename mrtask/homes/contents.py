"""Draw the objects in a container from the catalogue's counts and likelihoods, by room and container.

The generator uses this, and so do homes whose furniture is known but whose contents are not (a scanned floor).
"""

from dataclasses import replace

import numpy as np

from mrtask.arrays import Floats
from mrtask.homes.catalogue import Catalogue, load_catalogue
from mrtask.homes.home import Home

LIKELIHOOD_BOUNDS = (1e-3, 1 - 1e-3)
"""Likelihoods stay away from 0 and 1, where the log odds are infinite."""
LOG_TIMES_BEFORE, LOG_TIMES_AFTER, LOG_TIME_STEP = 25.0, 4.0, 0.3
"""The range over which `_rank_probs` integrates: from long before the first clock rings to long after the last. The
integrand is so smooth that the sum over these steps equals the integral to all digits."""


def draw_objects(catalogue: Catalogue, room_type: str, container_type: str, rng: np.random.Generator) -> list[str]:
    """Draw distinct object types.

    Their number follows the catalogue's shares; the types are then drawn by likelihood without replacement.
    """
    facts = catalogue.objects.get(room_type, {}).get(container_type)
    if facts is None or not facts["likelihoods"]:
        return []
    kinds = list(facts["likelihoods"])
    likelihood_prob = np.clip(np.array(list(facts["likelihoods"].values())), *LIKELIHOOD_BOUNDS)
    shares = np.array(facts["distinct_objects"])
    count = min(int(rng.choice(len(shares), p=shares / shares.sum())), len(kinds))
    # The largest Gumbel-shifted log odds are a draw without replacement, which nearly preserves the likelihoods.
    keys = np.log(likelihood_prob / (1 - likelihood_prob)) + rng.gumbel(size=len(kinds))
    return [kinds[index] for index in np.argsort(-keys, kind="stable")[:count]]


def object_probs(catalogue: Catalogue, room_type: str, container_type: str) -> dict[str, float]:
    """Return the probability of each object type to be among the types that `draw_objects` draws.

    The result is empty where nothing is known. The order of the Gumbel-shifted log odds is the order in which
    exponential clocks ring whose rates are the odds. A type is therefore drawn if fewer others ring before it than are
    drawn: an integral over the time at which it rings.
    """
    facts = catalogue.objects.get(room_type, {}).get(container_type)
    if facts is None or not facts["likelihoods"]:
        return {}
    likelihood_prob = np.clip(np.array(list(facts["likelihoods"].values())), *LIKELIHOOD_BOUNDS)
    shares = np.array(facts["distinct_objects"], dtype=np.float64)
    # [n] the probability that more than n types are drawn, for each n below the number of known types.
    more_prob = (1.0 - np.cumsum(shares / shares.sum()))[: len(likelihood_prob)]
    probs = _rank_probs(likelihood_prob / (1 - likelihood_prob), len(more_prob)) @ more_prob
    return dict(zip(facts["likelihoods"], probs.tolist(), strict=True))


def _rank_probs(rates: Floats, ranks: int) -> Floats:
    """Return the probability ``[K, ranks]`` that 0, 1, ... of the other K - 1 exponential clocks ring before each."""
    log_times = np.arange(
        -np.log(rates.max()) - LOG_TIMES_BEFORE, -np.log(rates.min()) + LOG_TIMES_AFTER, LOG_TIME_STEP
    )
    passed = np.outer(np.exp(log_times), rates)  # [G, K]
    rung_prob = -np.expm1(-passed)
    # [K, G, ranks] how many of the clocks considered so far have rung, not counting the clock itself.
    counts = np.zeros((len(rates), len(log_times), ranks))
    counts[:, :, 0] = 1.0
    for other in range(len(rates)):
        rung = rung_prob[:, other, None]
        after = counts * (1 - rung)
        after[:, :, 1:] += counts[:, :, :-1] * rung
        after[other] = counts[other]
        counts = after
    density = passed * np.exp(-passed) * LOG_TIME_STEP  # [G, K], of the log of the time at which it rings
    return np.asarray(np.einsum("gk,kgr->kr", density, counts))


def rooms_with(catalogue: Catalogue, container_type: str) -> list[str]:
    """Return the room types, sorted, in which the catalogue knows the contents of such a container."""
    return sorted(room for room, containers in catalogue.objects.items() if container_type in containers)


def fill_home(home: Home, rng: np.random.Generator) -> Home:
    """Return the home with newly drawn contents of its containers.

    If the catalogue knows no container of that type in that room, the contents are drawn as in another room. If it does
    not know the type at all, the container stays empty (call `rooms_with` first).
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
