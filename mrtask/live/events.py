"""Handle events, in whatever order they come.

A search reported before the arrival implies the arrival, a late or repeated report changes nothing, what was seen is
kept whoever saw it, and of two sightings of one object the later counts. Each function handles one kind of event: it
raises `Refused` with the reason, or returns a note to the sender, or None.
"""

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrtask.execution.acts import ActKind
from mrtask.execution.make_trial import free_cell_near
from mrtask.execution.motion import Position
from mrtask.execution.robot import Robot
from mrtask.live import messages as m
from mrtask.live.barriers import Barrier, barred_map
from mrtask.live.orders import doing
from mrtask.live.state import LiveState, Refused

MAX_ROBOTS = 64
MAX_BARRIERS = 100
_ROBOT_NAME = re.compile(r"[^\x00-\x1f\x7f]+")
KNOWN_ALREADY = "known already"


def _pose(live: LiveState, event: m.Pose) -> str | None:
    robot, number = live.robot(event.robot), live.number(event.robot)
    if event.time_s < live.heard_s[number]:
        raise Refused(f"a later pose of {event.robot} is known, of {live.stamp_s(live.heard_s[number]):.10g} s")
    position = live.position(event.x_m, event.y_m)
    if robot.moving and not robot.can_reach(robot.assignment.container, position):
        raise Refused(f"there is no way from there to {live.team.containers[robot.assignment.container]}")
    live.heard_s[number] = event.time_s
    robot.see_at(position, live.team.time_s)
    return None


def _arrived(live: LiveState, event: m.Arrived) -> str | None:
    robot, container = live.robot(event.robot), live.container(event.container)
    if robot.place == container:
        return KNOWN_ALREADY
    _check_under_way(live, event, robot, container)
    live.team.arrived(robot)
    return None


def _navigation_failed(live: LiveState, event: m.NavigationFailed) -> str | None:
    robot, container = live.robot(event.robot), live.container(event.container)
    _check_under_way(live, event, robot, container)
    robot.stop(live.team.time_s)
    live.team.failed(container, -1)
    live.order_ended(event.robot)
    live.surprise = True
    return None


def _check_under_way(live: LiveState, event: m.Arrived | m.NavigationFailed, robot: Robot, container: int) -> None:
    if not _is_under_way(robot, container):
        raise Refused(f"{event.robot} is not on its way to {event.container}: {doing(live, robot)}")


def _is_under_way(robot: Robot, container: int) -> bool:
    return robot.moving and robot.assignment.container == container


def _searches(robot: Robot, container: int) -> bool:
    return robot.act.kind is ActKind.SEARCH and robot.place == container


def _search_ended(live: LiveState, event: m.SearchEnded) -> str | None:
    robot, container = live.team.robots[live.number(event.robot)], live.container(event.container)
    arriving = _is_under_way(robot, container)
    searching = arriving or _searches(robot, container)
    if event.status == "FAILED":
        if not searching:
            raise Refused(f"{event.robot} is not searching {event.container}: {doing(live, robot)}")
        if arriving:
            live.team.arrived(robot)
        if robot.act.kind is ActKind.SEARCH:
            live.team.search_ended(robot, None)
        live.order_ended(event.robot)
        live.surprise = True
        return None
    fresh = live.seen_s[container] <= event.time_s
    if not searching and not fresh.any():
        raise Refused(f"{event.container} was seen later, at {live.stamp_s(live.seen_s[container].min()):.10g} s")
    live.seen_s[container, fresh] = event.time_s
    if arriving:
        live.team.arrived(robot)
    seen = _detections(live, event)
    if _searches(robot, container):
        live.team.search_ended(robot, seen, fresh)
    else:
        live.surprise |= live.team.learned(container, seen, fresh) and not searching
    if not searching:
        return f"kept what was seen; {event.robot} was not searching there"
    live.order_ended(event.robot)
    return None


def _detections(live: LiveState, event: m.SearchEnded) -> NDArray[np.float64]:
    """Return [O] the confidence in each detected task object; a place of delivery counts as detected."""
    seen = np.zeros(len(live.setup.task.propositions))
    for one in event.objects:
        name, confidence = (one, 1.0) if isinstance(one, str) else (one.object, one.confidence)
        if (obj := live.object(name)) is not None:
            seen[obj] = max(seen[obj], confidence)
    if event.container in live.setup.task.places:
        seen[live.setup.task.propositions.index(event.container)] = 1.0
    return seen


def _object_seen(live: LiveState, event: m.ObjectSeen) -> str | None:
    container, obj = live.container(event.container), live.object(event.object)
    if obj is None:
        return "no object of the task"
    if event.time_s < live.seen_s[container, obj]:
        raise Refused(
            f"it was seen later whether {event.object} is there, at {live.stamp_s(live.seen_s[container, obj]):.10g} s"
        )
    live.seen_s[container, obj] = event.time_s
    seen = event.confidence if event.present else 1.0 - event.confidence
    live.surprise |= live.team.glimpsed(container, obj, seen)
    return None


def _interaction_ended(live: LiveState, event: m.InteractionEnded) -> str | None:
    number, container, obj = live.number(event.robot), live.container(event.container), live.object(event.object)
    team, robot = live.team, live.team.robots[number]
    acted = robot.act.obj == obj and robot.place == container and (robot.lost or robot.act.kind is ActKind.INTERACT)
    if number in live.ended or not acted:
        raise Refused(f"{event.robot} was not to interact with {event.object}: {doing(live, robot)}")
    if event.status == "FINISHED":
        if robot.lost:
            team.interactions_ended([robot])
            robot.lose(team.time_s)
            live.surprise = True
            return "done before the robot was lost"
        live.ended.append(number)
        live.order_ended(event.robot)
        return None
    if robot.lost:
        raise Refused(f"robot {event.robot!r} is lost")
    if event.gone:
        live.seen_s[container, obj] = max(event.time_s, live.seen_s[container, obj])
    team.interaction_failed(robot, event.gone)
    live.order_ended(event.robot)
    live.surprise = True
    return None


def _robot_lost(live: LiveState, event: m.RobotLost) -> str | None:
    robot, number = live.robot(event.robot), live.number(event.robot)
    if number in live.ended:
        live.ended.remove(number)
        live.team.interactions_ended([robot])
    live.team.lose(robot)
    live.surprise = True
    return None


def _robot_joined(live: LiveState, event: m.RobotJoined) -> str | None:
    position = live.position(event.x_m, event.y_m)
    if event.robot in live.names:
        number = live.number(event.robot)
        if not live.team.robots[number].lost:
            raise Refused(f"robot {event.robot!r} is in the team already")
        live.team.join(position, live.team.robots[number])
    else:
        if len(live.names) >= MAX_ROBOTS:
            raise Refused(f"a team has at most {MAX_ROBOTS} robots")
        if live.setup.task.places:
            raise Refused("the task delivers something, which is for one robot")
        if not _ROBOT_NAME.fullmatch(event.robot):
            raise Refused("a robot's name has no control characters")
        live.names.append(event.robot)
        live.heard_s.append(0.0)
        live.team.join(position)
        number = len(live.names) - 1
    live.heard_s[number] = event.time_s
    live.surprise = True
    return None


def _route_blocked(live: LiveState, event: m.RouteBlocked) -> str | None:
    key, barrier = _barrier(live, event)
    if key in live.barriers:
        return KNOWN_ALREADY
    if len(live.barriers) >= MAX_BARRIERS:
        raise Refused(f"more than {MAX_BARRIERS} places are blocked; clear some")
    live.barriers[key] = barrier
    _use_barriers(live)
    return None


def _route_cleared(live: LiveState, event: m.RouteCleared) -> str | None:
    key, _ = _barrier(live, event)
    if key not in live.barriers:
        raise Refused("nothing was blocked there")
    del live.barriers[key]
    _use_barriers(live)
    return None


def _barrier(live: LiveState, event: m.RouteBlocked | m.RouteCleared) -> tuple[str, Barrier]:
    if event.door is not None:
        return f"door {event.door}", Barrier(*live.door(event.door), live.setup.home_map.resolution_m * 2)
    place = (float(event.x_m or 0.0), float(event.y_m or 0.0))
    return f"place {place[0]:g} {place[1]:g}", Barrier(place, place, event.radius_m)


def _use_barriers(live: LiveState) -> None:
    """Drop what is blocked from the map; robots under way go on from where they are."""
    home_map = barred_map(live.setup.home_map, list(live.barriers.values()))
    starts = {}
    for number in live.present:
        position = live.team.robots[number].position_at(live.team.time_s)
        if not (home_map.free[position.back] and home_map.free[position.ahead]):
            position = Position.at(free_cell_near(home_map, position.point(home_map), np.inf))
        starts[number] = position
    live.map_version += 1
    live.team.take_other_ways(home_map, starts)
    live.surprise = True


HANDLERS: Mapping[str, Callable[[LiveState, Any], str | None]] = {
    "pose": _pose,
    "arrived": _arrived,
    "navigation_failed": _navigation_failed,
    "search_ended": _search_ended,
    "object_seen": _object_seen,
    "interaction_ended": _interaction_ended,
    "robot_lost": _robot_lost,
    "robot_joined": _robot_joined,
    "route_blocked": _route_blocked,
    "route_cleared": _route_cleared,
}
"""The function that handles an event, by its ``type``."""
