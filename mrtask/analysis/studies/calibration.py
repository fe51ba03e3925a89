"""Measure how true a team's beliefs were at the beginning of its tasks: log loss, Brier score and calibration.

A planner acts on the probability that a container holds an object of the task, given that the object is in the home, as
every task's object is. This probability is judged. The unit is one pair of container and object.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mrtask.analysis.results.statistics import Bootstrap, Estimate
from mrtask.execution.trace import Trace
from mrtask.homes.home import Home
from mrtask.likelihood.adapt import Sighting, sightings_of
from mrtask.likelihood.existence import given_existence
from mrtask.likelihood.metrics import evaluate, reliability

LOSSES = ("log_loss", "brier")
"""These losses are per pair, so that their means have intervals. The calibration error is over all pairs together."""


@dataclass(frozen=True)
class Task:
    """A task that a team did: its objects, and the ids of the containers that were searched."""

    trial_id: str
    objects: tuple[str, ...]
    searched: frozenset[str]
    seed: int = 0
    """The seed of the trial."""


Believe = Callable[[Task, int, Sequence[Sighting]], NDArray[np.float64]]
"""Returns a team's belief about a task's objects, ``[C, O]``, from the task, its number and what earlier tasks
showed."""


def beliefs_of(home: Home, tasks: Sequence[Task], believe: Believe) -> pd.DataFrame:
    """Return ``trial_id, task, pair, prob, held, seen`` of each pair of container and object.

    The beliefs are those at the beginning of each task. ``seen`` says whether an earlier task showed if the container
    holds the object, so that the team need only remember.
    """
    seen: list[Sighting] = []
    parts = []
    for number, task in enumerate(tasks):
        belief = given_existence(believe(task, number, seen))
        held = [[name in container.objects for name in task.objects] for container in home.containers]
        known = {(sighting.container, sighting.object) for sighting in seen}
        before = [[(index, name) in known for name in task.objects] for index in range(len(home.containers))]
        pairs = pd.DataFrame({"prob": belief.ravel(), "held": np.ravel(held), "seen": np.ravel(before)})
        parts.append(pairs.assign(trial_id=task.trial_id, task=number, pair=range(len(pairs))))
        searched = [container.id in task.searched for container in home.containers]
        seen += sightings_of(home, number, searched, task.objects)
    return pd.concat(parts, ignore_index=True)


def searched_in(trace: Trace) -> frozenset[str]:
    """Return the ids of the containers that some robot searched."""
    return frozenset(leg.container for legs in trace.robots for leg in legs if leg.kind == "search" and leg.container)


@dataclass(frozen=True)
class Calibration:
    """The mean losses with intervals over homes, the expected calibration error, and the reliability curve."""

    losses: Mapping[str, Estimate]
    ece: float
    curve: pd.DataFrame


def calibration(beliefs: pd.DataFrame, home_of: Mapping[str, str]) -> Calibration:
    """Return the calibration of `beliefs_of`'s beliefs.

    ``home_of`` maps each trial to its home; homes are resampled as a whole.
    """
    counts = pd.DataFrame({"positives": beliefs["held"].astype(float), "count": 1.0})
    probs = beliefs["prob"].to_numpy()
    losses = {name: mean_loss(beliefs, name, home_of) for name in LOSSES}
    return Calibration(losses, evaluate(probs, counts)["ece"], reliability(probs, counts))


def mean_loss(beliefs: pd.DataFrame, name: str, home_of: Mapping[str, str]) -> Estimate:
    """Return the mean of one of `LOSSES` over all pairs."""
    return _mean(_with_losses(beliefs), name, home_of)


def change(after: pd.DataFrame, before: pd.DataFrame, name: str, home_of: Mapping[str, str]) -> Estimate:
    """Return by how much the mean loss ``name`` differs between two beliefs about the same pairs; less is better."""
    difference = _with_losses(after)[name].to_numpy() - _with_losses(before)[name].to_numpy()
    return _mean(before.assign(**{name: difference}), name, home_of)


def _with_losses(beliefs: pd.DataFrame) -> pd.DataFrame:
    prob, held = beliefs["prob"].to_numpy(), beliefs["held"].to_numpy()
    return beliefs.assign(log_loss=-np.log(np.where(held, prob, 1.0 - prob)), brier=(held - prob) ** 2)


def _mean(pairs: pd.DataFrame, name: str, home_of: Mapping[str, str]) -> Estimate:
    sums = pairs.groupby(pairs["trial_id"].map(home_of))[name].agg(["sum", "count"]).to_numpy(dtype=np.float64)
    return Bootstrap(sums).estimate(lambda means: np.asarray(means[..., 0] / means[..., 1]))
