"""Which likelihoods a planner plans with: the model's, the true ones, or a version made worse on purpose.

The true likelihoods (`mrtask.likelihood.truth`) show what a better model could save. Likelihoods mixed with ignorance,
or with noise, show what a worse one costs.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from mrtask.likelihood.model import clip_probs
from mrtask.likelihood.options import LikelihoodChoice


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
