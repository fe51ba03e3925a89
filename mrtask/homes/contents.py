"""Draws which objects lie in a container, from the catalogue's counts and likelihoods by room and container.

For the generator, and for homes whose furniture is known but whose contents are not (a scanned floor).
"""

from dataclasses import replace

import numpy as np

from mrtask.arrays import Floats
from mrtask.homes.catalogue import Catalogue, load_catalogue
from mrtask.homes.home import Home

LIKELIHOOD_BOUNDS = (1e-3, 1 - 1e-3)
"""Likelihoods are kept off 0 and 1, where log odds have no end."""
LOG_TIMES_BEFORE, LOG_TIMES_AFTER, LOG_TIME_STEP = 25.0, 4.0, 0.3
"""Where `_rank_probs` integrates: from long before the first clock rings to after the last. The integrand is so smooth
that the sum over these steps is the integral to all digits."""


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


def object_probs(catalogue: Catalogue, room_type: str, container_type: str) -> dict[str, float]:
    """The probability of each object type to be among what `draw_objects` draws; none where nothing is known.

    The order of the Gumbel-shifted log odds is that in which exponential clocks ring whose rates are the odds. So a
    type is drawn when fewer others ring before it than are drawn: an integral over the time at which it rings.
    """
    facts = catalogue.objects.get(room_type, {}).get(container_type)
    if facts is None or not facts["likelihoods"]:
        return {}
    likelihood_prob = np.clip(np.array(list(facts["likelihoods"].values())), *LIKELIHOOD_BOUNDS)
    shares = np.array(facts["distinct_objects"], dtype=np.float64)
    # [n] the probability that more than n are drawn, where so many types are known.
    more_prob = (1.0 - np.cumsum(shares / shares.sum()))[: len(likelihood_prob)]
    probs = _rank_probs(likelihood_prob / (1 - likelihood_prob), len(more_prob)) @ more_prob
    return dict(zip(facts["likelihoods"], probs.tolist(), strict=True))


def _rank_probs(rates: Floats, ranks: int) -> Floats:
    """``[K, ranks]`` the probability that exactly so many of the other K - 1 exponential clocks ring before each."""
    log_times = np.arange(
        -np.log(rates.max()) - LOG_TIMES_BEFORE, -np.log(rates.min()) + LOG_TIMES_AFTER, LOG_TIME_STEP
    )
    passed = np.outer(np.exp(log_times), rates)  # [G, K]
    rung_prob = -np.expm1(-passed)
    # [K, G, ranks] of the clocks looked at so far, without the one itself, how many have rung.
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
