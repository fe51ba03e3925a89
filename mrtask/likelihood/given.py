"""Choose the likelihoods that planners see, wrong on purpose if wanted, to measure what a model's errors cost.

By default planners see the model's own. The true likelihoods (`mrtask.likelihood.truth`) show what a better model could
save; likelihoods mixed with ignorance or noise show what a worse one costs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logit

from mrtask.arrays import Floats
from mrtask.likelihood.model import clip_probs

SOURCES = ("model", "truth")


@dataclass(frozen=True)
class GivenOptions:
    """What planners see in place of the model's likelihoods; by default the model's.

    ``uniform_mix``: this share of each likelihood is the mean over all containers of the home; with 1, planners know
    how common an object is, but not where it lies. ``noise_sd``: the standard deviation, in log odds, of an
    error that is the same for all containers of a kind.
    """

    source: str = "model"
    """One of `SOURCES`."""
    uniform_mix: float = 0.0
    noise_sd: float = 0.0

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            raise ValueError(f"source must be {' or '.join(map(repr, SOURCES))}, not {self.source!r}")
        if not 0 <= self.uniform_mix <= 1 or self.noise_sd < 0:
            raise ValueError(f"0 <= uniform_mix <= 1 and noise_sd >= 0 needed, got {self}")


def given_likelihood(likelihood: Floats, kinds: Sequence[tuple[str, str]], options: GivenOptions, seed: int) -> Floats:
    """Return what planners see for ``likelihood [C, O]`` of containers of these C ``kinds``: first mixed, then noisy.

    The noise of an object does not depend on which objects come after it.
    """
    if options.uniform_mix > 0:
        likelihood = (1 - options.uniform_mix) * likelihood + options.uniform_mix * likelihood.mean(axis=0)
    if options.noise_sd > 0:
        distinct = sorted(set(kinds))
        noise = np.random.default_rng(seed).normal(0.0, options.noise_sd, (likelihood.shape[1], len(distinct)))
        of_container = [distinct.index(kind) for kind in kinds]
        likelihood = clip_probs(expit(logit(clip_probs(likelihood)) + noise[:, of_container].T))
    return likelihood
