"""Likelihoods of objects that are known to exist in the home, as all task objects are."""

import numpy as np

from mrtask.arrays import Floats
from mrtask.likelihood.model import clip_probs


def given_existence(probs: Floats) -> Floats:
    """Return ``P(object in container | it is in some container)``, ``[C, O]``, for independent containers."""
    return clip_probs(probs / -np.expm1(np.log1p(-clip_probs(probs)).sum(axis=0)))
