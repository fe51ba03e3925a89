"""What a live team says: its orders, the task's progress, and the setup."""

from math import atan2, dist
from typing import Any

import numpy as np
from shapely import Polygon

from mrtask.execution.acts import ActKind
from mrtask.execution.robot import Robot
from mrtask.homes.home import Point
from mrtask.live import messages as m
from mrtask.live.state import LiveState

_NAVIGATE, _SEARCH, _INTERACT, _WAIT = "navigate", "search", "interact", "wait"
MIN_FACING_M = 0.01
_ACTIONS = {
    ActKind.MOVE: _NAVIGATE,
    ActKind.SEARCH: _SEARCH,
    ActKind.INTERACT: _INTERACT,
    ActKind.FREE: _WAIT,
    ActKind.SETTLING: _WAIT,
    ActKind.LOST: "lost",
}
"""The action of the order for each kind of act; a lost robot gets no order."""


def order_key(live: LiveState, robot: Robot) -> tuple[Any, ...]:
    """Return what a robot's order is made from (action, container, object, map); a new key makes a new order."""
    action = _ACTIONS[robot.act.kind]
    version = live.map_version if robot.moving else 0
    target = robot.assignment.container if robot.moving else robot.place if action != _WAIT else -1
    return (action, target, robot.act.obj if action == _INTERACT else -1, version)


def order_of(live: LiveState, number: int) -> m.Order:
    """Return a robot's present order, with the route from where the robot should be by now."""
    team, robot = live.team, live.team.robots[number]
    action, target, obj, _ = order_key(live, robot)
    route, length_m = robot.way_left(team.time_s)
    return m.Order(
        order=live.orders,
        robot=live.names[number],
        action=action,
        container=team.containers[target] if target >= 0 else None,
        object=live.setup.task.propositions[obj] if obj >= 0 else None,
        route=route,
        length_m=length_m,
        heading_rad=_heading_rad(live, target, route[-1]) if route else None,
    )


def _heading_rad(live: LiveState, container: int, point: Point) -> float | None:
    """Return the direction from a place to the middle of a container; None in the middle itself."""
    middle = Polygon(live.setup.home.containers[container].footprint).centroid
    if dist(point, (middle.x, middle.y)) < MIN_FACING_M:
        return None
    return atan2(middle.y - point[1], middle.x - point[0])


def doing(live: LiveState, robot: Robot) -> str:
    """Return a robot's present order in words."""
    action, target, obj, _ = order_key(live, robot)
    at = f" {live.team.containers[target]}" if target >= 0 else ""
    return f"its order is {action}{at}" + (f" {live.setup.task.propositions[obj]}" if obj >= 0 else "")


def task_state(live: LiveState) -> m.TaskState:
    """Return the task's progress."""
    team = live.team
    word = tuple(
        m.Letter(
            time_s=live.stamp_s(letter.t_s),
            robot=live.names[letter.robot],
            object=letter.object,
            container=letter.container,
        )
        for letter in team.letters
    )
    time_s = live.stamp_s(team.time_s)
    if team.accepted:
        return m.TaskState(status="done", time_s=time_s, word=word)
    if any(_ACTIONS[robot.act.kind] in (_NAVIGATE, _SEARCH, _INTERACT) for robot in team.robots):
        return m.TaskState(status="running", time_s=time_s, word=word)
    return m.TaskState(status="stuck", time_s=time_s, word=word, reason=_why_stuck(live))


def welcome(live: LiveState) -> m.Welcome:
    """Return the greeting: task, containers and robots."""
    task = live.setup.task
    return m.Welcome(
        task=live.setup.text,
        formula=task.formula,
        objects=task.propositions,
        containers=tuple(live.containers),
        robots=tuple(live.names[number] for number in live.present),
        last_event=live.last_event,
    )


def _why_stuck(live: LiveState) -> str:
    team = live.team
    if not live.present:
        return "no robot is left; robot_joined helps"
    ways_s = [team.robots[number].travel_s(team.time_s) for number in live.present]
    reachable = np.isfinite(ways_s).any(axis=0)
    missing = team.missing()
    if missing and team.belief.searched[reachable].all():
        return f"found in no container that can be reached: {', '.join(missing)}"
    return "every robot waits"
