"""Where a team believes objects to be: the likelihoods, corrected by what its searches and interactions showed.

Planners are told the likelihoods in containers that are open to search, and 0 or 1 in searched ones: an object counts
as found where it was detected and is believed to be. With perfect perception, that is the truth. Robots that err may
have missed an object in a search; then a searched container is opened again, with the posterior probabilities, as soon
as a needed object is at least as likely there as in every open container.

Legend for array shapes: C containers, O task objects.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mrtask.execution.sensor import Sensor

Seen = NDArray[np.float64] | NDArray[np.bool_]
"""[O] what a search showed, as `Sensor.posterior` takes it."""
DETECTED = 0.5
"""A detection of at least this confidence counts as one."""
BELIEVED_PROB = 0.5
"""An object that was detected counts as found from this probability on: a robot may go and interact with it."""
GIVEN_UP_ODDS = 1e-6
"""An object counts as absent once searches have lowered its odds to this share of its prior odds."""
MAX_SEARCHES = 100
"""An object that this many searches of a container did not find counts as absent there."""


class Belief:
    """The belief about one task's objects.

    Args:
        presence_prob: [C, O] the prior probability that the object is in the container; 0 or 1 in searched containers.
        searched: [C] whether the container's contents are known.
        sensor: how well searches see.
    """

    def __init__(self, presence_prob: NDArray[np.float64], searched: NDArray[np.bool_], sensor: Sensor) -> None:
        self.presence_prob, self.searched, self.sensor = presence_prob, searched, sensor
        """The belief that planners see: [C, O] and [C]."""
        self._prior = np.where(searched[:, None], presence_prob, sensor.prior(presence_prob))
        self.posterior = self._prior.copy()
        """[C, O] the actual belief, which differs from what planners see only if searches err."""
        self.detected = (presence_prob == 1.0) & searched[:, None]
        """[C, O] whether the object was ever detected there, and not ruled out since."""
        self.searches = np.zeros(len(searched), dtype=np.int64)
        """[C] how often each was searched."""

    def learned(self, container: int, seen: Seen, fresh: NDArray[np.bool_] | None = None) -> bool:
        """Take in the end of a search of the container. Return whether that is news.

        Args:
            seen: [O] the detections, as `Sensor.posterior` takes them.
            fresh: [O] the objects that the search says anything about; None: all.
        """
        told = np.ones(len(seen), dtype=bool) if fresh is None else fresh
        before = self.posterior[container]
        after = np.where(told, self.sensor.posterior(before, seen.astype(float)), before)
        self.detected[container] |= told & (seen >= DETECTED)
        self.searches[container] += 1
        believed = self.detected[container] & (after >= BELIEVED_PROB)
        prior = self._prior[container]
        unlikely = after * (1.0 - prior) <= GIVEN_UP_ODDS * prior * (1.0 - after)
        given_up = ~believed & (unlikely | (self.searches[container] >= MAX_SEARCHES))
        return self._now_searched(container, np.where(given_up, 0.0, after))

    def glimpsed(self, container: int, obj: int, seen: float) -> bool:
        """Take in a passing glance at one object; ``seen`` is as in `Sensor.posterior`. Return whether that is news."""
        row = self.posterior[container]
        self.detected[container, obj] |= seen >= DETECTED
        return self._set(container, obj, float(self.sensor.posterior(row, np.full(len(row), seen))[obj]))

    def ruled_out(self, container: int, obj: int) -> bool:
        """Take in that one object is certainly not in the container. Return whether that is news."""
        self.detected[container, obj] = False
        return self._set(container, obj, 0.0)

    def found(self, among: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
        """Return [O] whether some searched container is believed to hold the object, ``among`` these [C, O]."""
        there = (self.presence_prob > 0) & self.searched[:, None]
        return np.asarray((there if among is None else there & among).any(axis=0))

    def look_again(self, missing: NDArray[np.bool_], reachable: NDArray[np.bool_]) -> None:
        """Reopen searched containers where a missing object may have been overlooked and no open container is likelier.

        Args:
            missing: [O] the needed objects that were not found.
            reachable: [C] the containers that robots can reach.
        """
        doubtful = self.searched & reachable
        open_now = ~self.searched & reachable
        again = np.zeros_like(self.searched)
        for obj in np.flatnonzero(missing):
            prob = self.posterior[:, obj]
            again |= doubtful & (prob > 0.0) & (prob >= prob[open_now].max(initial=0.0))
        self.searched[again] = False
        self.presence_prob[again] = self.posterior[again]

    def _now_searched(self, container: int, posterior: NDArray[np.float64]) -> bool:
        self.posterior[container] = posterior
        row = (self.detected[container] & (posterior >= BELIEVED_PROB)).astype(float)
        news = not self.searched[container] or bool((row != self.presence_prob[container]).any())
        self.searched[container] = True
        self.presence_prob[container] = row
        return news

    def _set(self, container: int, obj: int, prob: float) -> bool:
        self.posterior[container, obj] = prob
        found = bool(self.detected[container, obj]) and prob >= BELIEVED_PROB
        told = float(found) if self.searched[container] else prob
        news = bool(self.presence_prob[container, obj] != told)
        self.presence_prob[container, obj] = told
        return news


def prior_belief(
    likelihood: NDArray[np.float64],
    reachable: NDArray[np.bool_],
    sensor: Sensor,
    known: Mapping[int, NDArray[np.bool_]] | None = None,
) -> Belief:
    """Return the belief of a team with these likelihoods [C, O] that knows what some containers hold (index -> [O])."""
    presence_prob, searched = likelihood.astype(float).copy(), np.zeros(len(likelihood), dtype=bool)
    for container, holds in (known or {}).items():
        presence_prob[container], searched[container] = holds, True
    presence_prob[~reachable] = 0.0
    return Belief(presence_prob, searched, sensor)
