"""How well robots see: a search may miss an object that is there, or report one that is not.

`Perception` has these rates for each type of object; by default robots see all there is. Legend: O task objects.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mrtask.arrays import Bools, Floats
from mrtask.names import name_to_text

DOUBT_PROB = 1e-3
"""No prior is surer than this where detections can err, and what was ruled out for certain is detected with this prior:
a likelihood of 1e-9 is a guess, and against it no number of detections would help."""


@dataclass(frozen=True)
class Rates:
    """How likely a search detects an object that is there (a hit), and one that is not (a false alarm)."""

    true_positive_prob: float = 1.0
    false_positive_prob: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.false_positive_prob < self.true_positive_prob <= 1.0:
            raise ValueError(
                f"false_positive_prob ({self.false_positive_prob}) must be >= 0 and less than true_positive_prob "
                f"({self.true_positive_prob}), which is at most 1; otherwise a detection says nothing"
            )


@dataclass(frozen=True)
class Perception:
    """The rates of all types of objects, and of those that have rates of their own, by name."""

    rates: Rates = field(default_factory=Rates)
    by_object: Mapping[str, Rates] = field(default_factory=dict, hash=False)

    @property
    def sees_all(self) -> bool:
        """Whether robots see all there is, and nothing else."""
        return all(one == Rates() for one in (self.rates, *self.by_object.values()))

    def sensor(self, objects: Sequence[str]) -> "Sensor":
        """The rates of a task's objects."""
        own = {name_to_text(name): rates for name, rates in self.by_object.items()}
        rates = [own.get(name_to_text(name), self.rates) for name in objects]
        return Sensor(
            np.array([one.true_positive_prob for one in rates]), np.array([one.false_positive_prob for one in rates])
        )


@dataclass(frozen=True, eq=False)
class Sensor:
    """[O] the probability that a search detects each task object where it is, and where it is not."""

    true_positive_prob: Floats
    false_positive_prob: Floats

    def prior(self, likelihood: Floats) -> Floats:
        """[..., O] likelihoods as priors, which leave some doubt where detections can err."""
        least = np.where(self.false_positive_prob > 0.0, DOUBT_PROB, 0.0)
        most = np.where(self.true_positive_prob < 1.0, 1.0 - DOUBT_PROB, 1.0)
        return np.clip(likelihood, least, most)

    def detect(self, present: Bools, seed: int) -> Bools:
        """[O] what a search detects where these objects are present."""
        chance = np.where(present, self.true_positive_prob, self.false_positive_prob)
        return np.asarray(np.random.default_rng(seed).random(len(present)) < chance)

    def posterior(self, prior: Floats, seen: Floats) -> Floats:
        """[O] the probabilities that the objects are there, after a search.

        Args:
            prior: [O] those before it.
            seen: [O] the probability that each object was detected: 1 or 0, or a detector's confidence, which weighs
                the posterior after a detection against that after none (Jeffrey's rule).
        """
        there = np.where(prior == 0.0, DOUBT_PROB, prior)
        after_hit = _bayes(there, self.true_positive_prob, self.false_positive_prob)
        after_miss = _bayes(prior, 1.0 - self.true_positive_prob, 1.0 - self.false_positive_prob)
        return seen * after_hit + (1.0 - seen) * after_miss


def _bayes(prior: Floats, if_present: Floats, if_absent: Floats) -> Floats:
    """The posterior after evidence with these likelihoods; 0 where it is impossible either way."""
    joint = prior * if_present
    total = joint + (1.0 - prior) * if_absent
    return np.divide(joint, total, out=np.zeros_like(total), where=total > 0.0)
