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
from mrtask.execution.motion import Position
from mrtask.execution.robot import Robot
from mrtask.execution.setbacks import NAVIGATE
from mrtask.live import messages as m
from mrtask.live.barriers import Barrier
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
    live.heard_s[number] = event.time_s
    moving, reach = robot.moving, np.isfinite(robot.travel_s(live.team.time_s))
    robot.home_map = live.map_at(position)
    robot.see_at(position, live.team.time_s)
    live.surprise |= bool((np.isfinite(robot.travel_s(live.team.time_s)) != reach).any())
    if moving and not robot.moving:
        live.order_ended(event.robot)
        return "from there no way leads to where its order was"
    return None


def _arrived(live: LiveState, event: m.Arrived) -> str | None:
    robot, container = live.robot(event.robot), live.container(event.container)
    if robot.place == container:
        return KNOWN_ALREADY
    if _is_under_way(robot, container):
        live.team.arrived(robot)
        return None
    if not _stands_there(live, event, robot, container):
        raise Refused(f"{event.robot} is not on its way to {event.container}: {doing(live, robot)}")
    live.team.can_be_done(container, NAVIGATE)
    return f"it is there, though {doing(live, robot)}"


def _stands_there(live: LiveState, event: m.Arrived | m.SearchEnded, robot: Robot, container: int) -> bool:
    """Take in that a robot is at a container to which it was not sent, unless it has done something else since."""
    number = live.number(event.robot)
    if not (robot.free or robot.moving) or event.time_s < max(live.heard_s[number], robot.since_s):
        return False
    if not live.setup.home_map.reachable[container]:
        return False
    live.heard_s[number] = event.time_s
    row, col = live.setup.home_map.access[container]
    position = Position.at((int(row), int(col)))
    robot.home_map = live.map_at(position)
    robot.see_at(position, live.team.time_s)
    if robot.free:
        robot.place = container
    live.surprise = True
    return True


def _navigation_failed(live: LiveState, event: m.NavigationFailed) -> str | None:
    robot, container = live.robot(event.robot), live.container(event.container)
    if not _is_under_way(robot, container):
        raise Refused(f"{event.robot} is not on its way to {event.container}: {doing(live, robot)}")
    robot.stop(live.team.time_s)
    live.team.failed(robot, container, NAVIGATE)
    live.order_ended(event.robot)
    live.surprise = True
    return None


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
        _stands_there(live, event, robot, container)
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
    number = live.number(event.robot)
    if number in live.silent:
        live.silent.discard(number)
        return "it had said nothing for too long, and counted as lost already"
    robot = live.robot(event.robot)
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
        live.spoke_s.append(live.team.time_s)
        live.team.join(position)
        number = len(live.names) - 1
    live.heard_s[number], live.spoke_s[number] = event.time_s, live.team.time_s
    live.silent.discard(number)
    live.beating.discard(number)
    live.team.robots[number].home_map = live.map_at(position)
    live.surprise = True
    return None


def _heartbeat(live: LiveState, event: m.Heartbeat) -> str | None:
    live.robot(event.robot)
    live.beating.add(live.number(event.robot))
    return None


def _clock(live: LiveState, event: m.Clock) -> str | None:
    return None


def _try_again(live: LiveState, event: m.TryAgain) -> str | None:
    robots = live.team.robots if event.robot is None else [live.robot(event.robot)]
    container = None if event.container is None else live.container(event.container)
    for robot in robots:
        robot.setbacks.forgive(container)
    live.surprise = True
    return None


def _route_blocked(live: LiveState, event: m.RouteBlocked) -> str | None:
    key, barrier = _barrier(live, event)
    if key in live.barriers and live.barriers[key].radius_m >= barrier.radius_m:
        return KNOWN_ALREADY
    if key not in live.barriers and len(live.barriers) >= MAX_BARRIERS:
        raise Refused(f"more than {MAX_BARRIERS} places are blocked; clear some")
    live.barriers[key] = barrier
    live.use_barriers()
    return None


def _route_cleared(live: LiveState, event: m.RouteCleared) -> str | None:
    key, _ = _barrier(live, event)
    if key not in live.barriers:
        raise Refused("nothing was blocked there")
    del live.barriers[key]
    live.team.can_be_done(what=NAVIGATE)
    live.use_barriers()
    return None


def _barrier(live: LiveState, event: m.RouteBlocked | m.RouteCleared) -> tuple[str, Barrier]:
    if event.door is not None:
        name, barrier = live.door(event.door)
        return f"door {name}", barrier
    place = (float(event.x_m or 0.0), float(event.y_m or 0.0))
    return f"place {place[0]:g} {place[1]:g}", Barrier(place, place, event.radius_m)


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
    "heartbeat": _heartbeat,
    "clock": _clock,
    "try_again": _try_again,
}
"""The function that handles an event, by its ``type``."""
