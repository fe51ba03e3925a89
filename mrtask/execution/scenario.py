"""One trial that a person describes: a home, a task in words or as a formula, a team and where it starts.

Other trials are drawn (`mrtask.execution.trials`). Every planner runs on this one.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrtask.errors import InputError
from mrtask.execution.make_trial import trial_of
from mrtask.execution.team_spec import Team
from mrtask.execution.trials import Trial, key_seed
from mrtask.homes.home import Home, Point
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.table import build_table
from mrtask.maps.home_map import HomeMap
from mrtask.tasks.words import ReadTask, read_task

UNKNOWN_PROB = 0.1
"""The likelihood of every object in every container without a model."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """Everything that `mrtask.execution.episode.run_episode` needs except the planner."""

    home: Home
    home_map: HomeMap
    trial: Trial
    likelihood: NDArray[np.float64]
    """[C, O]"""


def task_in(home: Home, text: str, objects: Collection[str] | None = (), *, robots: int) -> ReadTask:
    """Return the task of a formula, or of words about this home.

    Args:
        objects: names allowed in addition to those in the home's containers; None allows any name.

    Raises:
        InputError: the text is not a task, has more than one meaning, or has a delivery for more than one robot.
    """
    listed = {name for container in home.containers for name in container.objects}
    places = [container.id for container in home.containers]
    task = read_task(text, None if objects is None else {*listed, *objects}, places)
    if task.places and robots > 1:
        raise InputError(
            f"task {text!r}: deliveries (to {', '.join(task.places)}) are for one robot, since a formula cannot say "
            f"that the robot that has an object is the one that brings it; give one robot instead of {robots}"
        )
    return task


def with_places(home: Home, places: Collection[str]) -> Home:
    """Return the home with each of these containers inside itself, so that a task can ask to interact with it."""
    containers = tuple(
        replace(one, objects=tuple(sorted({*one.objects, one.id}))) if one.id in places else one
        for one in home.containers
    )
    return replace(home, containers=containers)


def prior(home: Home, task: ReadTask, model: LikelihoodModel | None) -> NDArray[np.float64]:
    """Return [C, O] the model's likelihoods of the task's objects, all equal without a model; places are known."""
    names = [name for name in task.propositions if name not in task.places]
    likelihood = np.zeros((len(home.containers), len(task.propositions)))
    scored = UNKNOWN_PROB if model is None else build_table(model, [home], names).matrix(home, names)
    likelihood[:, [task.propositions.index(name) for name in names]] = scored
    for place in task.places:
        likelihood[:, task.propositions.index(place)] = [container.id == place for container in home.containers]
    return likelihood


def drawn_worlds(scenario: Scenario, count: int, seed: int) -> list[Home]:
    """Draw worlds: the home with the task's objects placed by the likelihoods, each where robots can reach it.

    A planner's mean saving over such worlds is its merit; its saving in one world is partly luck.

    Raises:
        InputError: an object has likelihood 0 everywhere.
    """
    objects, home = scenario.trial.objects, scenario.home
    probs = np.where(scenario.home_map.reachable[:, None], scenario.likelihood, 0.0)
    nowhere = [name for name, column in zip(objects, probs.T, strict=True) if not column.any()]
    if nowhere:
        raise InputError(f"no worlds can be drawn: {', '.join(nowhere)} can be nowhere by these likelihoods")
    rng = np.random.default_rng(key_seed(seed, "worlds", scenario.trial.trial_id))
    worlds = []
    for _ in range(count):
        there = np.zeros(probs.shape, dtype=bool)
        while (missing := ~there.any(axis=0)).any():
            there[:, missing] = rng.random((len(probs), int(missing.sum()))) < probs[:, missing]
        held = [tuple(sorted(name for name, here in zip(objects, row, strict=True) if here)) for row in there]
        containers = tuple(replace(one, objects=names) for one, names in zip(home.containers, held, strict=True))
        worlds.append(replace(home, containers=containers))
    return worlds


def make_scenario(
    name: str,
    home: Home,
    home_map: HomeMap,
    model: LikelihoodModel | None,
    text: str,
    team: Team,
    *,
    start_m: Point | None = None,
    objects: Collection[str] = (),
    seed: int = 0,
) -> Scenario:
    """Return the scenario of this task; the whole team starts at ``start_m``, by default in the middle of the floor.

    Raises:
        InputError: the task or the start cannot be used here.
    """
    task = task_in(home, text, objects, robots=team.robots)
    home = with_places(home, task.places)
    trial = trial_of(name, home, home_map, task, team, start_m=start_m, seed=seed)
    return Scenario(home, home_map, trial, prior(home, task, model))
