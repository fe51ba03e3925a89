"""Likelihoods of objects that are known to be somewhere, as every task's object is."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import elementwise

from mrtask.likelihood.model import clip_probs

Floats = NDArray[np.float64]

LEAST_EXISTENCE = 0.01
"""Of likelihoods under which an object is in one container at most: with this, in one and hardly ever in two."""


def given_existence(probs: Floats) -> Floats:
    """``P(object in container | it is in some container)``, ``[C, O]``, where containers are independent."""
    return clip_probs(probs / -np.expm1(np.log1p(-clip_probs(probs)).sum(axis=0)))


def before_existence(given: Floats) -> Floats:
    """The inverse of `given_existence`: likelihoods ``[C, O]`` that lead there once an object is known to exist.

    They are ``given`` times the probability ``e`` that the object exists: ``e = 1 - product(1 - e * given)``. Where
    ``given`` sums to 1 or less, nothing above 0 solves that, and `LEAST_EXISTENCE` takes its place.
    """

    def excess(exists: Floats, number: NDArray[np.int64]) -> Floats:
        return np.asarray(1.0 - np.prod(1.0 - exists * given[:, number.astype(np.intp)], axis=0) - exists)

    number = np.arange(given.shape[1])
    least, most = np.full(number.shape, LEAST_EXISTENCE), np.ones(number.shape)
    found = elementwise.find_root(excess, (least, most), args=(number,))
    return clip_probs(given * np.where(found.success, found.x, LEAST_EXISTENCE))
