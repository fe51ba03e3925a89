"""Measure how true beliefs are: a team's at the beginning of its tasks, and a model's likelihoods in homes.

The measures are log loss, Brier score and calibration. A planner acts on the probability that a container holds an
object of the task, given that the object is in the home, as every task's object is. For a team, this probability is
judged. The unit is one pair of container and object.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mrtask.analysis.results.statistics import Bootstrap, Estimate
from mrtask.arrays import Floats
from mrtask.execution.trace import Trace
from mrtask.homes.home import Home
from mrtask.likelihood.adapt import Sighting, sightings_of
from mrtask.likelihood.existence import given_existence
from mrtask.likelihood.metrics import evaluate, reliability
from mrtask.likelihood.table import LikelihoodTable

LOSSES = ("log_loss", "brier")
"""These losses are per pair, so that their means have intervals. The calibration error is over all pairs together."""
ALL_OBJECTS, EXISTING = "all objects", "objects in the home, given that they are there"
"""The likelihoods as predicted; and those that planners act on, of objects in the home, given that they are there."""
PROB_EDGES = (0.0, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""The bins of `reliability_in_homes`: narrow where nearly all probabilities are, and wide where few decide a search."""


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


def reliability_in_homes(homes: Sequence[Home], table: LikelihoodTable) -> pd.DataFrame:
    """Return how often pairs of container and object were true, by probability, in homes with known contents.

    The columns are ``belief`` (`ALL_OBJECTS` or `EXISTING`), ``mean_prob, frequency, low, high, pairs`` of each of the
    bins of `PROB_EDGES` that is not empty. The intervals of the frequencies resample homes.
    """
    counts = np.array([_bin_counts(home, table) for home in homes])  # [H, 2, bins, 3]
    records = []
    for belief, of_belief in zip((ALL_OBJECTS, EXISTING), np.moveaxis(counts, 1, 0), strict=True):
        for bin_ in np.moveaxis(of_belief, 1, 0):  # [H, 3]
            prob, _, pairs = bin_.sum(axis=0)
            if pairs:
                some = bin_[bin_[:, 2] > 0]
                share = Bootstrap(some[:, 1:]).estimate(lambda means: np.asarray(means[..., 0] / means[..., 1]))
                records.append((belief, prob / pairs, share.value, share.low, share.high, int(pairs)))
    return pd.DataFrame(records, columns=["belief", "mean_prob", "frequency", "low", "high", "pairs"])


def _bin_counts(home: Home, table: LikelihoodTable) -> Floats:
    """Return a home's summed probabilities, true pairs and pairs [2, bins, 3] of all objects and of existing ones."""
    probs = table.matrix(home, table.objects)
    held = np.array([[name in container.objects for name in table.objects] for container in home.containers])
    there = held.any(axis=0)
    counted = []
    for prob, true in ((probs, held), (given_existence(probs[:, there]), held[:, there])):
        which = np.clip(np.digitize(prob.ravel(), PROB_EDGES) - 1, 0, len(PROB_EDGES) - 2)
        columns = (prob.ravel(), true.ravel().astype(np.float64), np.ones(prob.size))
        counted.append([np.bincount(which, column, len(PROB_EDGES) - 1) for column in columns])
    return np.moveaxis(np.array(counted), 1, 2)
