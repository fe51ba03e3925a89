"""What a live team knows: a `TeamState` as in simulated episodes, and what its robots reported."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mrtask.errors import InputError
from mrtask.execution.belief import prior_belief
from mrtask.execution.make_trial import free_cell_near
from mrtask.execution.motion import Position
from mrtask.execution.robot import Robot
from mrtask.execution.sensor import Sensor
from mrtask.execution.setbacks import Setback
from mrtask.execution.team_spec import RobotSpec
from mrtask.execution.team_state import TeamState
from mrtask.homes.home import Home, Point
from mrtask.live.barriers import Barrier, barred_map, doorways
from mrtask.live.clock import TeamClock
from mrtask.maps.home_map import HomeMap
from mrtask.names import name_to_text
from mrtask.tasks.automaton import build_automaton
from mrtask.tasks.words import ReadTask

POSE_REACH_M = 1.0
"""A robot may report a place this far off the free floor."""
NAMES_SHOWN = 20
IDS_KEPT = 100_000
EventKey = tuple[str, str]
"""Whose event it is, and its id: the client's name, or, of a client without one, a digest of the event."""


class Refused(Exception):
    """Why an event changes nothing."""


@dataclass(frozen=True, eq=False)
class LiveSetup:
    """What does not change while a live team works: home, task, likelihoods and planner."""

    home: Home
    home_map: HomeMap
    text: str
    """The task as it was given."""
    task: ReadTask
    likelihood: NDArray[np.float64]
    """[C, O]"""
    spec: RobotSpec = field(default_factory=RobotSpec)
    planner: str = "pouct"
    planner_options: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    lost_after_s: float | None = None
    """A robot counts as lost when it has said nothing for so long after its order should have ended, or, if it sends
    heartbeats, after its last word. None: it never does."""


class LiveState:
    """Everything that a live team keeps; `mrtask.live.store` saves and restores it.

    Args:
        robots: name -> where it is, in metres.

    Raises:
        InputError: no robots, or a robot off the free floor.
    """

    def __init__(self, setup: LiveSetup, robots: Mapping[str, Point]) -> None:
        if not robots:
            raise InputError("a live team needs at least one robot to start with")
        self.setup = setup
        self.containers = {container.id: index for index, container in enumerate(setup.home.containers)}
        self.objects = {name_to_text(name): index for index, name in enumerate(setup.task.propositions)}
        sensor = Sensor.of(setup.spec.perception, setup.task.propositions)
        self.names = list(robots)
        self.team = TeamState(
            list(self.containers),
            setup.home_map,
            build_automaton(setup.task.formula, setup.task.propositions),
            prior_belief(setup.likelihood, setup.home_map.reachable, sensor),
            spec=setup.spec,
            starts=[Position.at(free_cell_near(setup.home_map, point, POSE_REACH_M)) for point in robots.values()],
            one_per_letter=True,
        )
        self.doors = doorways(setup.home)
        self._maps: dict[tuple[Barrier, ...], HomeMap] = {}
        self.decisions = self.orders = self.map_version = 0
        self.barriers: dict[str, Barrier] = {}
        self.clock = TeamClock()
        self.ids: dict[EventKey, None] = {}
        """The keys of the latest accepted events, the last one at the end."""
        self.taken = 0
        """How many events were accepted since the start of this process."""
        self.seen_s = np.full(setup.likelihood.shape, -np.inf)
        """[C, O] when the team last saw whether the object is there."""
        self.heard_s = [0.0] * len(self.names)
        """[R] the time of the last pose."""
        self.spoke_s = [0.0] * len(self.names)
        """[R] when the team last heard of each."""
        self.beating: set[int] = set()
        """The robots that send heartbeats."""
        self.silent: set[int] = set()
        """The robots that are lost because they said nothing for too long."""
        self.told: dict[str, tuple[Any, ...]] = {}
        """Robot -> the key of its last order."""
        self.busy: set[int] = set()
        """The robots that were not free after the last decision."""
        self.ended: list[int] = []
        """The robots whose interactions ended at this instant."""
        self.surprise = True
        """Whether something unexpected calls for a decision although no robot became free."""
        self.decided_s = 0.0
        """The time of the last decision."""
        self.more = False
        """Whether more events of this instant are to come."""

    @property
    def last_event(self) -> str | None:
        """The id of the last accepted event."""
        return next((event for _, event in reversed(self.ids)), None)

    def ids_since(self, taken: int) -> list[EventKey]:
        """Return the keys of the events that were accepted after so many."""
        return list(islice(reversed(self.ids), self.taken - taken))[::-1]

    def ids_until(self, taken: int) -> list[EventKey]:
        """Return the keys of all events but those that were accepted after so many."""
        return list(islice(self.ids, len(self.ids) - (self.taken - taken)))

    def take_in(self, key: EventKey) -> None:
        """Note that an event was accepted."""
        self.ids[key] = None
        self.taken += 1
        if len(self.ids) > IDS_KEPT:
            del self.ids[next(iter(self.ids))]

    def stamp_s(self, time_s: float) -> float:
        """Return a time of the team on the clock that its robots' stamps count on."""
        return time_s + self.clock.zero_s

    @property
    def present(self) -> list[int]:
        """The robots that are not lost."""
        return self.team.active

    def number(self, name: str) -> int:
        """Return a robot's number; like the lookups below, raise `Refused` for an unknown name."""
        if name not in self.names:
            raise Refused(f"no robot {name!r}; there are: {_listed(self.names)}; robot_joined adds one")
        return self.names.index(name)

    def robot(self, name: str) -> Robot:
        """Return a robot that is not lost."""
        robot = self.team.robots[self.number(name)]
        if robot.lost:
            raise Refused(f"robot {name!r} is lost; robot_joined brings it back")
        return robot

    def container(self, name: str) -> int:
        """Return a container's index."""
        if name not in self.containers:
            raise Refused(f"no container {name!r}; there are: {_listed(self.containers)}")
        return self.containers[name]

    def order_ended(self, robot: str) -> None:
        """Note that the robot has ended its order: the same again is a new order."""
        self.told.pop(robot, None)

    def object(self, name: str) -> int | None:
        """Return a task object's index, None for any other object."""
        return self.objects.get(name_to_text(name))

    def position(self, x_m: float, y_m: float) -> Position:
        """Return the position on the map of a robot that reports this place."""
        try:
            return Position.at(free_cell_near(self.setup.home_map, (x_m, y_m), POSE_REACH_M))
        except InputError as error:
            raise Refused(str(error)) from None

    def door(self, name: str) -> tuple[str, Barrier]:
        """Return a doorway's name and the barrier that shuts it; its stretches' ids name it too."""
        for known, stretches in self.doors.items():
            if name == known or name in {door.id for door in stretches}:
                first, *others = ((door.start, door.end) for door in stretches)
                return known, Barrier(*first, self.setup.home_map.resolution_m * 2, tuple(others))
        raise Refused(f"no door {name!r}; there are: {_listed(self.doors) or 'none'}")

    def barred(self, barriers: tuple[Barrier, ...]) -> HomeMap:
        """Return the map with these barriers."""
        if not barriers:
            return self.setup.home_map
        if barriers not in self._maps:
            self._maps[barriers] = barred_map(self.setup.home_map, barriers)
        return self._maps[barriers]

    def map_at(self, position: Position) -> HomeMap:
        """Return the map of a robot at this position: the barriers in which it stands do not hold it."""
        barriers = tuple(self.barriers.values())
        whole = self.barred(barriers)
        ends = (position.back, position.ahead)
        if any(whole.free[end] for end in ends):
            return whole
        points = shapely.points([whole.cell_center(end) for end in ends])
        return self.barred(tuple(barrier for barrier in barriers if not barrier.holds(points).any()))

    def use_barriers(self) -> None:
        """Drop what is blocked from the map; robots go on from where they are."""
        self._maps.clear()
        whole = self.barred(tuple(self.barriers.values()))
        robots = {number: self.team.robots[number] for number in self.present}
        self.map_version += 1
        self.team.take_other_ways(
            whole, {number: self.map_at(robot.position_at(self.team.time_s)) for number, robot in robots.items()}
        )
        self.surprise = True

    def overdue_s(self, number: int) -> float:
        """Return the time at which a robot that says nothing more counts as lost."""
        robot = self.team.robots[number]
        if self.setup.lost_after_s is None or robot.lost:
            return np.inf
        expected_s = self.spoke_s[number] if number in self.beating else robot.act.until_s
        return max(self.spoke_s[number], expected_s) + self.setup.lost_after_s

    def left_alone(self) -> list[tuple[float, int, int, Setback]]:
        """Return what robots without work wait to try again: (time, robot, container, setback), the first one first."""
        now_s, useful = self.team.time_s, self.team.useful()
        idle = [number for number in self.present if self.team.robots[number].free]
        return sorted(
            (setback.until_s, number, container, setback)
            for number in idle
            for container, setback in self.team.robots[number].setbacks.left_alone(now_s).items()
            if useful[container] and np.isfinite(self.team.robots[number].travel_s(now_s)[container])
        )

    @property
    def wake_s(self) -> float:
        """The time at which something is to be decided although nobody says anything; inf if there is none."""
        if self.team.accepted:
            return np.inf
        overdue_s = [self.overdue_s(number) for number in self.present]
        return min([*overdue_s, *(until_s for until_s, *_ in self.left_alone())], default=np.inf)


def _listed(names: Mapping[str, Any] | list[str]) -> str:
    shown = list(names)[:NAMES_SHOWN]
    more = f", ... ({len(names)} in all)" if len(names) > NAMES_SHOWN else ""
    return ", ".join(name[:40] for name in shown) + more
