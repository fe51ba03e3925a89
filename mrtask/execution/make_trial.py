"""Make a trial of a task that you choose, in one home."""

import numpy as np

from mrtask.errors import InputError
from mrtask.execution.team_spec import RobotSpec, Team
from mrtask.execution.trials import Trial, key_seed
from mrtask.homes.home import Home, Point
from mrtask.maps.home_map import HomeMap
from mrtask.tasks.words import ReadTask, read_task

START_REACH_M = 0.5
"""A start that is not on the free floor moves by at most this distance."""
OWN_TASK = "formula"
"""The ``template`` of a trial whose task does not come from a template."""


def make_trial(
    home: Home,
    home_map: HomeMap,
    task: str,
    robots: int = 1,
    *,
    start_m: Point | None = None,
    robot: RobotSpec | None = None,
    seed: int = 0,
    name: str = "mine",
) -> Trial:
    """Return a trial of this task in this home.

    Args:
        task: a formula over objects in the home's containers (``F Mug & F Book``), or words (``mug, then book``).
        robots: the size of the team.
        start_m: where the whole team starts, in the map's metres; by default in the middle of the free floor.
        robot: the robots' speed, times and perception.
        seed: the planners' random numbers depend on it, and on the name.

    Raises:
        InputError: a task that cannot be read or names an object that the home does not have, or a start that is more
            than `START_REACH_M` from where a robot fits.
        ValueError: a team without robots.
    """
    objects = {held for container in home.containers for held in container.objects}
    team = Team.alike(robots, robot)
    return trial_of(name, home, home_map, read_task(task, objects, ()), team, start_m=start_m, seed=seed)


def trial_of(
    name: str, home: Home, home_map: HomeMap, task: ReadTask, team: Team, *, start_m: Point | None, seed: int
) -> Trial:
    """Return the trial of a task that was read. Takes and raises what `make_trial` does."""
    middle = np.argwhere(home_map.free).mean(axis=0)
    place = home_map.cell_center((middle[0], middle[1])) if start_m is None else start_m
    return Trial(
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


def free_cell_near(home_map: HomeMap, point: Point, reach_m: float = START_REACH_M) -> tuple[int, int]:
    """Return the free cell nearest to a place in metres.

    Raises:
        InputError: no free cell is within ``reach_m``.
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
