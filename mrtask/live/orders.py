"""What a live team says: its orders, the task's progress, and the setup."""

from collections.abc import Sequence
from math import atan2, dist
from typing import Any

import numpy as np
from shapely import Polygon

from mrtask.execution.acts import ActKind
from mrtask.execution.robot import Robot
from mrtask.execution.setbacks import OFTEN, Setback
from mrtask.homes.home import Point
from mrtask.live import messages as m
from mrtask.live.barriers import Barrier
from mrtask.live.state import LiveState

REASONS_SHOWN = 5
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
    acting = any(_ACTIONS[robot.act.kind] in (_NAVIGATE, _SEARCH, _INTERACT) for robot in team.robots)
    waiting = [] if acting or live.more else live.left_alone()
    stuck = not acting and not live.more and all(setback.count >= OFTEN for *_, setback in waiting)
    return m.TaskState(
        status="stuck" if stuck else "running",
        time_s=time_s,
        word=word,
        reason="; ".join([*([_why_stuck(live)] if stuck and not waiting else []), *_awaited(live, waiting)]),
        silent=tuple(live.names[number] for number in sorted(live.silent)),
        wake_s=live.stamp_s(live.wake_s) if np.isfinite(live.wake_s) else None,
    )


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
        doors=tuple(live.doors),
        blocked=tuple(map(_blocked, live.barriers, live.barriers.values())),
    )


def _blocked(key: str, barrier: Barrier) -> m.Blocked:
    kind, _, name = key.partition(" ")
    if kind == "door":
        return m.Blocked(door=name, radius_m=barrier.radius_m)
    return m.Blocked(x_m=barrier.start[0], y_m=barrier.start[1], radius_m=barrier.radius_m)


def _awaited(live: LiveState, waiting: Sequence[tuple[float, int, int, Setback]]) -> list[str]:
    """Return, in words, what robots failed at and when they try it again."""
    return [
        f"{live.names[number]} failed {setback.count} x at {live.team.containers[container]} and tries again from "
        f"{live.stamp_s(until_s):.10g} s on (route_cleared and try_again make it sooner)"
        for until_s, number, container, setback in waiting[:REASONS_SHOWN]
    ]


def _why_stuck(live: LiveState) -> str:
    team = live.team
    if not live.present:
        silent = ", ".join(live.names[number] for number in sorted(live.silent))
        return f"no robot is left; {f'a word from {silent} helps' if silent else 'robot_joined helps'}"
    ways_s = [team.robots[number].travel_s(team.time_s) for number in live.present]
    reachable = np.asarray(np.isfinite(ways_s).any(axis=0))
    missing = team.missing()
    if missing and team.belief.searched[reachable].all():
        beyond = [name for name, there in zip(live.containers, reachable, strict=True) if not there]
        shut = f"; no way leads to {', '.join(beyond[:REASONS_SHOWN])}" if beyond else ""
        return f"found in no container that can be reached: {', '.join(missing)}{shut}"
    return "every robot waits"
