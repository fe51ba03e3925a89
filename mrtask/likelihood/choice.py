"""Which likelihoods a planner plans with: the model's, the true ones, or a version made worse on purpose.

The true likelihoods (`mrtask.likelihood.truth`) show what a better model could save. Likelihoods mixed with ignorance,
or with noise, show what a worse one costs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from mrtask.likelihood.model import clip_probs

SOURCES = ("model", "truth")


@dataclass(frozen=True)
class LikelihoodChoice:
    """The likelihoods that a planner plans with; by default the model's own.

    ``uniform_mix`` replaces this share of each likelihood by its mean over all containers of the home; with 1, a
    planner knows how often an object lies anywhere, but not where. ``noise_sd`` is the standard deviation, in log odds,
    of an error that all containers of a kind share.
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


def chosen_likelihood(
    likelihood: NDArray[np.float64], kinds: Sequence[tuple[str, str]], choice: LikelihoodChoice, seed: int
) -> NDArray[np.float64]:
    """Return ``likelihood [C, O]`` of containers of these C ``kinds``, mixed first and then made noisy, as chosen.

    The noise of an object does not depend on which objects come after it.
    """
    if choice.uniform_mix > 0:
        likelihood = (1 - choice.uniform_mix) * likelihood + choice.uniform_mix * likelihood.mean(axis=0)
    if choice.noise_sd > 0:
        distinct = sorted(set(kinds))
        noise = np.random.default_rng(seed).normal(0.0, choice.noise_sd, (likelihood.shape[1], len(distinct)))
        of_container = [distinct.index(kind) for kind in kinds]
        likelihood = clip_probs(expit(logit(clip_probs(likelihood)) + noise[:, of_container].T))
    return likelihood
