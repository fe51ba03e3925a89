"""What a search that may err detects, and what a detection says: the rates of `Perception` for one task's objects.

Legend: O task objects.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mrtask.arrays import Bools, Floats
from mrtask.execution.perception import Perception
from mrtask.names import name_to_text

DOUBT_PROB = 1e-3
"""Where detections can err, no prior is closer to certainty than this, and an object that was ruled out has this prior
if it is detected after all: a likelihood of 1e-9 is a guess, and no number of detections could overcome it."""


@dataclass(frozen=True, eq=False)
class Sensor:
    """[O] the probability that a search detects each task object if it is present, and if it is absent."""

    true_positive_prob: Floats
    false_positive_prob: Floats

    @classmethod
    def of(cls, perception: Perception, objects: Sequence[str]) -> "Sensor":
        """Return the rates of a task's objects."""
        own = {name_to_text(name): rates for name, rates in perception.by_object.items()}
        rates = [own.get(name_to_text(name), perception.rates) for name in objects]
        return cls(
            np.array([one.true_positive_prob for one in rates]), np.array([one.false_positive_prob for one in rates])
        )

    def prior(self, likelihood: Floats) -> Floats:
        """Return [..., O] likelihoods as priors, which leave some doubt where detections can err."""
        least = np.where(self.false_positive_prob > 0.0, DOUBT_PROB, 0.0)
        most = np.where(self.true_positive_prob < 1.0, 1.0 - DOUBT_PROB, 1.0)
        return np.clip(likelihood, least, most)

    def detect(self, present: Bools, seed: int) -> Bools:
        """Return [O] what a search detects where these objects are present."""
        chance = np.where(present, self.true_positive_prob, self.false_positive_prob)
        return np.asarray(np.random.default_rng(seed).random(len(present)) < chance)

    def posterior(self, prior: Floats, seen: Floats) -> Floats:
        """Return [O] the probabilities that the objects are present, after a search.

        Args:
            prior: [O] the probabilities before it.
            seen: [O] the probability that each object was detected: 1 or 0, or a detector's confidence, which weighs
                the posterior after a detection against the one after no detection (Jeffrey's rule).
        """
        there = np.where(prior == 0.0, DOUBT_PROB, prior)
        after_hit = _bayes(there, self.true_positive_prob, self.false_positive_prob)
        after_miss = _bayes(prior, 1.0 - self.true_positive_prob, 1.0 - self.false_positive_prob)
        return seen * after_hit + (1.0 - seen) * after_miss


def _bayes(prior: Floats, if_present: Floats, if_absent: Floats) -> Floats:
    """Return the posterior after evidence with these likelihoods, or 0 if the evidence is impossible either way."""
    joint = prior * if_present
    total = joint + (1.0 - prior) * if_absent
    return np.divide(joint, total, out=np.zeros_like(total), where=total > 0.0)
