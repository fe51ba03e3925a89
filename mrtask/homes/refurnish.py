"""Give homes other contents: as many objects as before, of other types, where people say that they put them.

The number of objects in a home, the number of their types, and the number of containers in which a type lies all stay
the same (for a ProcTHOR home, as ProcTHOR has them). Which types lie where is drawn from the votes. A home belongs to
one household: for each object it follows one annotator, so that things of one type lie where that household keeps them.
A place is the likelier, the better the annotator ranks it and the more of the other annotators call it right. (The
annotators were asked room by room, never which room is best.) Some objects lie misplaced; their places are drawn in the
same way from those where they may be found misplaced.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mrtask.arrays import Floats
from mrtask.homes.home import Home
from mrtask.homes.receptacles import Match
from mrtask.homes.votes import Votes


@dataclass(frozen=True, eq=False)
class Refurnisher:
    """Draws contents from ``votes`` for containers that stand for their places according to ``match``.

    ``misplaced_prob`` is the probability that an object lies where an annotator says that it may be found misplaced.
    """

    votes: Votes
    match: Match
    misplaced_prob: float

    def __post_init__(self) -> None:
        if not 0 <= self.misplaced_prob <= 1:
            raise ValueError(f"misplaced_prob must be within 0 and 1, got {self.misplaced_prob}")

    def refurnish(self, home: Home, rng: np.random.Generator) -> Home:
        """Return the home with newly drawn contents.

        If its containers stand for no place of the votes, they stay empty.
        """
        if not home.containers:
            return home
        places = [self.match.places[kind] for kind in home.container_kinds()]
        right, misplaced = (_by_container(weights, places) for weights in self._weights)
        before = Counter(name for container in home.containers for name in container.objects)
        containers_each, left = sorted(before.values(), reverse=True), before.total()
        held: list[set[str]] = [set() for _ in home.containers]
        for number, index in enumerate(rng.permutation(len(self.votes.objects))):
            if not left:
                break
            wanted = min(left, containers_each[number] if number < len(containers_each) else 1)
            chosen = self._places_of(right[:, index], misplaced[:, index], wanted, rng)
            left -= len(chosen)
            for container in chosen:
                held[container].add(self.votes.objects[index])
        return replace(
            home,
            containers=tuple(
                replace(container, objects=tuple(sorted(objects)))
                for container, objects in zip(home.containers, held, strict=True)
            ),
        )

    @cached_property
    def _weights(self) -> tuple[Floats, Floats]:
        """Return the weights ``[K, O, A]`` of right places and of places for misplaced objects.

        A weight is the inverse rank times the share of the annotators who agree.
        """
        votes, shares = self.votes, (self.votes.share_right, self.votes.share_misplaced)
        inverse = np.divide(1.0, votes.ranks, out=np.zeros(votes.ranks.shape), where=votes.ranks != 0)
        right, misplaced = (
            np.maximum(sign * inverse, 0.0) * share[:, :, None] for sign, share in zip((1, -1), shares, strict=True)
        )
        return right, misplaced

    def _places_of(self, right: Floats, misplaced: Floats, wanted: int, rng: np.random.Generator) -> list[int]:
        """Return distinct containers for up to ``wanted`` objects of one type, given its weights ``[C, A]``."""
        annotators = np.flatnonzero(right.any(axis=0))
        if not len(annotators):
            return []
        household = rng.choice(annotators)
        weights = [right[:, household].copy(), misplaced[:, household].copy()]
        chosen: list[int] = []
        while len(chosen) < wanted and any(weight.any() for weight in weights):
            astray = int(rng.random() < self.misplaced_prob)
            weight = weights[astray] if weights[astray].any() else weights[1 - astray]
            if weight is weights[1] and not self.misplaced_prob:
                break
            container = int(rng.choice(len(weight), p=weight / weight.sum()))
            chosen.append(container)
            for each in weights:
                each[container] = 0.0
        return chosen


def _by_container(weights: Floats, places: Sequence[Sequence[int]]) -> Floats:
    """Return the mean ``[C, O, A]`` over the places that each container stands for, or 0 if it stands for no place."""
    return np.stack([weights[list(of)].mean(axis=0) if of else np.zeros(weights.shape[1:]) for of in places])
