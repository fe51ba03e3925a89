"""What a live team says: its orders, how far the task is, and what it is about."""

from typing import Any

import numpy as np

from mrtask.execution.robot import LOST, Robot
from mrtask.homes.home import Point
from mrtask.live import messages as m
from mrtask.live.state import LiveState

_ACTIONS = {"move": "navigate", "search": "search", "interact": "interact", "free": "wait", "settling": "wait"}


def order_key(live: LiveState, robot: Robot) -> tuple[Any, ...]:
    """What a robot's order is made from (action, container, object, map); another key makes another order."""
    action = _ACTIONS.get(robot.mode, LOST)
    version = live.map_version if action == "navigate" else 0
    target = robot.assignment.container if action == "navigate" else robot.place if action != "wait" else -1
    return (action, target, robot.obj if action == "interact" else -1, version)


def order_of(live: LiveState, number: int) -> m.Order:
    """A robot's present order, with its way from where it is taken to be."""
    team, robot = live.team, live.team.robots[number]
    action, target, obj, _ = order_key(live, robot)
    route: tuple[Point, ...] = ()
    length_m = 0.0
    if robot.mode == "move" and robot.route is not None:
        driven_m = (team.time_s - robot.moved_s) * live.setup.spec.speed_m_per_s
        route = robot.route.points_after(team.home_map, driven_m)
        length_m = max(robot.route.length_m - driven_m, 0.0)
    return m.Order(
        order=live.orders,
        robot=live.names[number],
        action=action,
        container=team.containers[target] if target >= 0 else None,
        object=live.setup.task.propositions[obj] if obj >= 0 else None,
        route=route,
        length_m=length_m,
    )


def doing(live: LiveState, robot: Robot) -> str:
    """A robot's present order in words."""
    action, target, obj, _ = order_key(live, robot)
    at = f" {live.team.containers[target]}" if target >= 0 else ""
    return f"its order is {action}{at}" + (f" {live.setup.task.propositions[obj]}" if obj >= 0 else "")


def task_state(live: LiveState) -> m.TaskState:
    """How far the task is."""
    team = live.team
    word = tuple(
        m.Letter(time_s=letter.t_s, robot=live.names[letter.robot], object=letter.object, container=letter.container)
        for letter in team.letters
    )
    if team.accepted:
        return m.TaskState(status="done", time_s=team.time_s, word=word)
    if any(robot.mode in ("move", "search", "interact") for robot in team.robots):
        return m.TaskState(status="running", time_s=team.time_s, word=word)
    return m.TaskState(status="stuck", time_s=team.time_s, word=word, reason=_why_stuck(live))


def welcome(live: LiveState) -> m.Welcome:
    """What the live team is about."""
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
    ways_m = [team.position_of(team.robots[number]).distances_m(team.home_map) for number in live.present]
    reachable = np.isfinite(ways_m).any(axis=0)
    missing = team.missing()
    if missing and team.belief.searched[reachable].all():
        return f"found in no container that can be reached: {', '.join(missing)}"
    return "every robot waits"
