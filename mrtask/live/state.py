"""What a live team knows: a `TeamState` as in simulated episodes, and what its robots reported."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
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
from mrtask.execution.team_maps import MakeMap, Maps, in_reach, maps_for
from mrtask.execution.team_spec import RobotSpec, Team
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
    """The robots that ``specs`` does not name."""
    planner: str = "pouct"
    planner_options: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    lost_after_s: float | None = None
    """A robot counts as lost when it has said nothing for so long after its order should have ended, or, if it sends
    heartbeats, after its last word. None: it never does."""
    specs: Mapping[str, RobotSpec] = field(default_factory=dict)
    """Name -> the robot that differs. All see as well as ``spec``."""
    make_map: MakeMap | None = None
    """As `maps_for` takes it."""

    def spec_of(self, name: str) -> RobotSpec:
        """Return what a robot of this name is like."""
        return self.specs.get(name, self.spec)

    @property
    def _everybody(self) -> Team:
        return Team((self.spec, *self.specs.values()))

    @cached_property
    def maps(self) -> Maps:
        """The home's map, and those for robots of another width."""
        return maps_for(self._everybody, self.home, self.home_map, self.make_map)

    @cached_property
    def reachable(self) -> NDArray[np.bool_]:
        """[C] whether some robot can get to the container and use it."""
        return in_reach(self._everybody, self.home, self.maps)


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
        specs = [setup.spec_of(name) for name in self.names]
        self.team = TeamState(
            setup.home.containers,
            setup.maps,
            build_automaton(setup.task.formula, setup.task.propositions),
            prior_belief(setup.likelihood, setup.reachable, sensor),
            specs=specs,
            starts=[
                Position.at(free_cell_near(setup.maps[spec.radius_m], point, POSE_REACH_M))
                for spec, point in zip(specs, robots.values(), strict=True)
            ],
            one_per_letter=True,
        )
        self.doors = doorways(setup.home)
        self._maps: dict[tuple[float | None, tuple[Barrier, ...]], HomeMap] = {}
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

    def position(self, name: str, x_m: float, y_m: float) -> Position:
        """Return the position on its map of a robot that reports this place."""
        own_map = self.setup.maps[self.setup.spec_of(name).radius_m]
        try:
            return Position.at(free_cell_near(own_map, (x_m, y_m), POSE_REACH_M))
        except InputError as error:
            raise Refused(str(error)) from None

    def door(self, name: str) -> tuple[str, Barrier]:
        """Return a doorway's name and the barrier that shuts it; its stretches' ids name it too."""
        for known, stretches in self.doors.items():
            if name == known or name in {door.id for door in stretches}:
                first, *others = ((door.start, door.end) for door in stretches)
                return known, Barrier(*first, self.setup.home_map.resolution_m * 2, tuple(others))
        raise Refused(f"no door {name!r}; there are: {_listed(self.doors) or 'none'}")

    def _barred(self, radius_m: float | None, barriers: tuple[Barrier, ...]) -> HomeMap:
        """Return the map of robots of this width with these barriers."""
        if not barriers:
            return self.setup.maps[radius_m]
        if (radius_m, barriers) not in self._maps:
            self._maps[radius_m, barriers] = barred_map(self.setup.maps[radius_m], barriers)
        return self._maps[radius_m, barriers]

    def barred_maps(self) -> Maps:
        """Return the maps with all barriers, for robots of each width."""
        return {radius_m: self._barred(radius_m, tuple(self.barriers.values())) for radius_m in self.setup.maps}

    def map_at(self, position: Position, spec: RobotSpec) -> HomeMap:
        """Return the map of a robot at this position: the barriers in which it stands do not hold it."""
        barriers = tuple(self.barriers.values())
        whole = self._barred(spec.radius_m, barriers)
        ends = (position.back, position.ahead)
        if any(whole.free[end] for end in ends):
            return whole
        points = shapely.points([whole.cell_center(end) for end in ends])
        return self._barred(spec.radius_m, tuple(barrier for barrier in barriers if not barrier.holds(points).any()))

    def use_barriers(self) -> None:
        """Drop what is blocked from the map; robots go on from where they are."""
        self._maps.clear()
        robots = {number: self.team.robots[number] for number in self.present}
        self.map_version += 1
        now_s = self.team.time_s
        self.team.take_other_ways(
            self.barred_maps(),
            {number: self.map_at(robot.position_at(now_s), robot.spec) for number, robot in robots.items()},
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
