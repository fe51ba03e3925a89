"""Adapt a belief in a home: searches correct what a likelihood model says about this household.

The model of a household: each kind of container (type and room type) has a habit ``v``, because this household puts
more or less of everything there than the likelihood model thinks. Within a kind, each object has a habit ``w`` too.
Both add to the log odds:

    P(object in container) = sigmoid(b + v + w),   v ~ kind_sd * N,   w ~ object_sd * N,

where ``b`` is chosen such that the probability equals the likelihood model's before anything was seen. Between one task
and the next, whether a container holds an object is drawn again with probability ``forget``, and otherwise stays the
same. ``N`` is the standard normal distribution on the ``NODES`` points of Gauss-Hermite quadrature. Bayes' rule is
therefore exact: sums over ``w`` within an object and over ``v`` within a kind. Kinds are independent.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import elementwise
from scipy.special import expit, logit

from mrtask.arrays import Floats
from mrtask.homes.home import Home
from mrtask.likelihood.model import clip_probs

NODES = 7

Cell = tuple[int, int]
"""``(container, object)``, by their places in the matrix."""


@dataclass(frozen=True)
class AdaptOptions:
    """How far households differ from the likelihood model, and how soon they move things elsewhere.

    ``kind_sd`` and ``object_sd`` are standard deviations in log odds, chosen by ``benchmarks/bench_belief.py``.
    ``forget`` is the probability, per task, that the presence of an object in a container is drawn again.
    """

    kind_sd: float = 0.5
    object_sd: float = 1.0
    forget: float = 0.02

    def __post_init__(self) -> None:
        if min(self.kind_sd, self.object_sd) < 0 or not 0 <= self.forget <= 1:
            raise ValueError(f"kind_sd >= 0, object_sd >= 0 and 0 <= forget <= 1 needed, got {self}")


@dataclass(frozen=True)
class Sighting:
    """In ``task`` (counted from 0), a container was searched and did or did not hold the object."""

    task: int
    container: int
    object: str
    present: bool


def sightings_of(home: Home, task: int, searched: Sequence[bool], objects: Sequence[str]) -> tuple[Sighting, ...]:
    """Return the sightings of a finished episode: which task objects each container that was ``searched [C]`` held."""
    return tuple(
        Sighting(task, number, name, name in container.objects)
        for number, (container, seen) in enumerate(zip(home.containers, searched, strict=True))
        if seen
        for name in objects
    )


def adapted(
    prior: Floats,
    objects: Sequence[str],
    kinds: Sequence[tuple[str, str]],
    sightings: Sequence[Sighting],
    task: int,
    options: AdaptOptions,
) -> Floats:
    """Return ``P(object in container)``, ``[C, O]``, at the beginning of a task, given the sightings of earlier tasks.

    Args:
        prior: [C, O] the probabilities of the likelihood model.
        objects: O names, which include those of all sightings.
        kinds: C kinds of containers; containers of one kind share their habits.

    Raises:
        ValueError: a sighting of an unknown object or of a later task, or sightings that contradict each other: those
            of one task, or with ``forget=0`` of any.
    """
    seen = _by_cell(sightings, objects, task, options.forget)
    if not seen:
        return clip_probs(prior)
    nodes, weights = _standard_normal()
    shift = options.kind_sd * nodes[:, None] + options.object_sd * nodes  # [V, W]
    theta = expit(_offsets(prior, shift, weights)[:, :, None, None] + shift)  # [C, O, V, W]
    evidence = np.ones((len(kinds), len(objects), *shift.shape))
    for (container, index), history in seen.items():
        evidence[container, index] = _likelihood(history, theta[container, index], options.forget)
    posterior = np.empty(prior.shape)
    for kind in dict.fromkeys(kinds):
        members = [number for number, other in enumerate(kinds) if other == kind]
        posterior[members] = _kind_posterior(theta[members], evidence[members], weights)
    for (container, index), history in seen.items():
        last_task, present = history[-1]
        stayed = (1.0 - options.forget) ** (task - last_task)
        posterior[container, index] = stayed * present + (1.0 - stayed) * posterior[container, index]
    return clip_probs(posterior)


def _kind_posterior(theta: Floats, evidence: Floats, weights: Floats) -> Floats:
    """Return the means ``[M, O]`` of ``theta [M, O, V, W]`` for a kind's M containers, given each cell's evidence."""
    log_evidence = np.log(evidence).sum(axis=0)  # [O, V, W]
    by_object = np.exp(log_evidence - log_evidence.max(axis=(1, 2), keepdims=True))
    given_habit = np.log(by_object @ weights)  # [O, V], summed over the object's own habit
    others = given_habit.sum(axis=0) - given_habit
    weight = np.exp(others - others.max(axis=1, keepdims=True))[:, :, None] * by_object * np.outer(weights, weights)
    total = weight.sum(axis=(1, 2))
    return np.asarray((theta * weight).sum(axis=(2, 3)) / total)


def _likelihood(history: Sequence[tuple[int, bool]], theta: Floats, forget: float) -> Floats:
    """Return how probable a cell's sightings (task, present) are for each ``theta``."""
    drawn = [theta if present else 1.0 - theta for _, present in history]
    result = drawn[0]
    for (earlier, later), anew in zip(pairwise(history), drawn[1:], strict=True):
        stayed = (1.0 - forget) ** (later[0] - earlier[0])
        result = result * (stayed * (earlier[1] == later[1]) + (1.0 - stayed) * anew)
    return result


def _by_cell(
    sightings: Sequence[Sighting], objects: Sequence[str], task: int, forget: float
) -> dict[Cell, list[tuple[int, bool]]]:
    """Return each cell's sightings in the order of tasks, one per task."""
    column = {name: index for index, name in enumerate(objects)}
    found: defaultdict[Cell, dict[int, bool]] = defaultdict(dict)
    for sighting in sightings:
        if sighting.object not in column or sighting.task >= task:
            raise ValueError(
                f"{sighting} is about none of the objects {', '.join(objects)}, or about no task before {task}"
            )
        history = found[sighting.container, column[sighting.object]]
        if history.setdefault(sighting.task, sighting.present) != sighting.present:
            raise ValueError(f"{sighting} contradicts another of the same task")
    if not forget:
        for (container, index), history in found.items():
            if len(set(history.values())) > 1:
                first, second = sorted(history, key=lambda task: not history[task])[:: len(history) - 1]
                raise ValueError(
                    f"container {container} held {objects[index]} in task {first} but not in task {second}: "
                    "forget must be above 0 where contents change"
                )
    return {cell: sorted(history.items()) for cell, history in found.items()}


def _offsets(prior: Floats, shift: Floats, weights: Floats) -> Floats:
    """Return ``b [C, O]`` such that the mean of ``sigmoid(b + shift)`` over all habits is the prior."""
    weight = np.outer(weights, weights).ravel()
    wanted, where = np.unique(clip_probs(prior), return_inverse=True)  # containers of one kind have the same habits

    def excess(offset: Floats, wanted: Floats) -> Floats:
        return np.asarray(expit(offset[..., None] + shift.ravel()) @ weight - wanted)

    # A mean lies between the least and the greatest of its terms; the 1 is for terms that are all equal.
    widest = np.abs(shift).max() + 1.0
    found = elementwise.find_root(excess, (logit(wanted) - widest, logit(wanted) + widest), args=(wanted,))
    return np.asarray(found.x[where].reshape(prior.shape))


def _standard_normal() -> tuple[Floats, Floats]:
    """Return the points ``[NODES]`` and weights of Gauss-Hermite quadrature for mean 0 and standard deviation 1."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    return nodes, weights / weights.sum()
