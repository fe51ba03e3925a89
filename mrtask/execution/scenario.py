"""One trial that a person describes: a home, a task in words, a team and where it starts.

The other trials are drawn (`mrtask.execution.trials`); this one is given. Every planner runs on it.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrtask.errors import InputError
from mrtask.execution.team_spec import Team
from mrtask.execution.trials import Trial, key_seed
from mrtask.homes.home import Home, Point
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.table import build_table
from mrtask.maps.home_map import HomeMap
from mrtask.tasks.words import ReadTask, read_task

UNKNOWN_PROB = 0.1
"""The likelihood of every object in every container where no model is asked."""
START_REACH_M = 0.5
"""A start off the free floor is moved at most this far."""
OWN_TASK = "formula"
"""What a trial's ``template`` says of a task that is none of the paper's."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """What `mrtask.execution.episode.run_episode` needs beside the planner."""

    home: Home
    home_map: HomeMap
    trial: Trial
    likelihood: NDArray[np.float64]
    """[C, O]"""


def task_in(home: Home, text: str, objects: Collection[str] | None = (), *, robots: int) -> ReadTask:
    """A task from a formula or from words about this home.

    Args:
        objects: names beside those that the home's containers list; None: any name will do.

    Raises:
        InputError: it is none, has more than one meaning, or delivers something with more than one robot.
    """
    listed = {name for container in home.containers for name in container.objects}
    places = [container.id for container in home.containers if container.id.isidentifier()]
    task = read_task(text, None if objects is None else {*listed, *objects}, places)
    if task.places and robots > 1:
        raise InputError(
            f"task {text!r}: deliveries (to {', '.join(task.places)}) are for one robot, since a formula cannot say "
            f"that the robot that has an object is the one that brings it; give one robot instead of {robots}"
        )
    return task


def with_places(home: Home, places: Collection[str]) -> Home:
    """The home in which each of these containers holds itself, so that a task can ask to interact with it."""
    containers = tuple(
        replace(one, objects=tuple(sorted({*one.objects, one.id}))) if one.id in places else one
        for one in home.containers
    )
    return replace(home, containers=containers)


def prior(home: Home, task: ReadTask, model: LikelihoodModel | None) -> NDArray[np.float64]:
    """[C, O] the model's likelihoods of the task's objects, all equal without one; places are where they are."""
    names = [name for name in task.propositions if name not in task.places]
    likelihood = np.zeros((len(home.containers), len(task.propositions)))
    scored = UNKNOWN_PROB if model is None else build_table(model, [home], names).matrix(home, names)
    likelihood[:, [task.propositions.index(name) for name in names]] = scored
    for place in task.places:
        likelihood[:, task.propositions.index(place)] = [container.id == place for container in home.containers]
    return likelihood


def drawn_worlds(scenario: Scenario, count: int, seed: int) -> list[Home]:
    """The home with the task's objects where its likelihoods put them, every object somewhere a robot can get to.

    What a planner saves on average over such worlds is its own doing; what it saves in one world is luck as well.

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


def free_cell_near(home_map: HomeMap, point: Point, reach_m: float = START_REACH_M) -> tuple[int, int]:
    """The free cell nearest to a place in metres.

    Raises:
        InputError: there is none within ``reach_m``.
    """
    cells = np.argwhere(home_map.free)
    row, col = ((point[axis] - home_map.origin_m[axis]) / home_map.resolution_m - 0.5 for axis in (1, 0))
    away = np.hypot(cells[:, 0] - row, cells[:, 1] - col)
    nearest = int(np.argmin(away))
    if away[nearest] * home_map.resolution_m > reach_m:
        x, y = home_map.cell_center((int(cells[nearest, 0]), int(cells[nearest, 1])))
        raise InputError(
            f"({point[0]:g}, {point[1]:g}) is more than {reach_m} m from where a robot fits; the nearest such place is "
            f"({x:.2f}, {y:.2f}), in the map's metres"
        )
    return (int(cells[nearest, 0]), int(cells[nearest, 1]))


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
    """A trial with this task; the whole team starts at ``start_m``, by default in the middle of the free floor.

    Raises:
        InputError: the task or the start cannot be used here.
    """
    task = task_in(home, text, objects, robots=team.robots)
    home = with_places(home, task.places)
    middle = np.argwhere(home_map.free).mean(axis=0)
    place = home_map.cell_center((middle[0], middle[1])) if start_m is None else start_m
    trial = Trial(
        trial_id=name,
        home_id=home.id,
        size_class=home.size_class,
        team=team,
        template=OWN_TASK,
        formula=task.formula,
        objects=task.propositions,
        start_cell=free_cell_near(home_map, place, np.inf if start_m is None else START_REACH_M),
        seed=key_seed(seed, "planner", name),
    )
    return Scenario(home, home_map, trial, prior(home, task, model))
