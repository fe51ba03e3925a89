"""One robot of a team: where it is, what it is doing, how it drives, and what it has done.

A robot knows its speed, its durations and its map, but neither the task nor the belief: `TeamState` tells it what to
do. It has no clock either: every method receives the present instant, ``now_s``.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mrtask.execution.acts import WAIT_LEG, Act, ActKind
from mrtask.execution.motion import Position, Route, plan_route
from mrtask.execution.setbacks import Setbacks
from mrtask.execution.team_spec import RobotSpec
from mrtask.execution.trace import Leg
from mrtask.homes.home import Point
from mrtask.maps.home_map import HomeMap
from mrtask.planning.problem import ANY_SAFE, WAIT, Assignment, RobotStatus

EARLY_S = 1e-6
"""A robot that arrives earlier than expected by more than this was faster than its speed says."""
FREE = Act(ActKind.FREE)


@dataclass(frozen=True)
class Labels:
    """The names that appear in legs: [C] of the containers and [O] of the task's objects."""

    containers: tuple[str, ...]
    objects: tuple[str, ...]


@dataclass
class Robot:
    """One robot. It has a ``route`` exactly while it moves."""

    position: Position
    """Where the robot stands, or where it set out on its route."""
    spec: RobotSpec
    usable: NDArray[np.bool_]
    """[C] the containers whose types it opens."""
    touches: NDArray[np.bool_]
    """[O] the task objects that it handles."""
    home_map: HomeMap
    """Its ways. They are the team's, unless it stands where the team's map has no floor."""
    labels: Labels
    place: int = -1
    """The container at which it stands, or -1 anywhere else."""
    act: Act = field(default=FREE)
    assignment: Assignment = field(default=Assignment(WAIT))
    since_s: float = 0.0
    """The time at which the present leg began."""
    route: Route | None = None
    moved_s: float = 0.0
    """The time at which it set out on its route."""
    passed: tuple[Point, ...] = ()
    """The way driven in this leg before the present route."""
    legs: list[Leg] = field(default_factory=list)
    setbacks: Setbacks = field(default_factory=Setbacks)

    @property
    def free(self) -> bool:
        """Whether it waits for a decision."""
        return self.act.kind is ActKind.FREE

    @property
    def moving(self) -> bool:
        """Whether it is under way to its assignment's container."""
        return self.act.kind is ActKind.MOVE

    @property
    def lost(self) -> bool:
        """Whether it takes no part."""
        return self.act.kind is ActKind.LOST

    def position_at(self, now_s: float) -> Position:
        """Return where the robot is, or should be by now."""
        return self.position if self.route is None else self.route.position(self._driven_m(now_s))

    def can_reach(self, container: int, position: Position) -> bool:
        """Return whether a way leads from its position to the container."""
        return bool(self.usable[container] and np.isfinite(position.distances_m(self.home_map)[container]))

    def travel_s(self, now_s: float) -> NDArray[np.float64]:
        """Return the times [C] from the robot's position to each container; inf if unreachable."""
        distances_m = self.position_at(now_s).distances_m(self.home_map)
        return np.where(self.usable, distances_m / self.spec.speed_m_per_s, np.inf)

    def options_s(self, now_s: float) -> NDArray[np.float64]:
        """Return `travel_s` with inf also for the containers [C] that it leaves alone after a failure."""
        travel_s = self.travel_s(now_s)
        travel_s[list(self.setbacks.left_alone(now_s))] = np.inf
        return travel_s

    def way_left(self, now_s: float) -> tuple[tuple[Point, ...], float]:
        """Return the turning points and the metres of its route that lie ahead."""
        if self.route is None:
            return (), 0.0
        driven_m = self._driven_m(now_s)
        return self.route.points_after(self.home_map, driven_m), max(self.route.length_m - driven_m, 0.0)

    def status(self, now_s: float) -> RobotStatus:
        """Return what a planner may know of the robot."""
        return RobotStatus(
            travel_s=self.options_s(now_s),
            place=self.place,
            free=self.free,
            target=self.assignment.container if self.moving else -1,
            interaction=self.assignment.interaction,
            remaining_s=0.0 if self.free else max(self.act.until_s - now_s, 0.0),
            interacting=self.act.obj if self.act.kind is ActKind.INTERACT else -1,
        )

    def set_out(self, assignment: Assignment, now_s: float) -> None:
        """Begin the way to the assignment's container, if the robot is not there already.

        Raises:
            ValueError: no way leads to the container.
        """
        position, container = self.position_at(now_s), assignment.container
        if container != WAIT and not self.can_reach(container, position):
            raise ValueError(f"container {self.labels.containers[container]} cannot be reached; assign another or WAIT")
        self._halt(position, now_s)
        self.assignment = assignment
        if container not in (WAIT, self.place):
            self.place = -1
            self._drive(position, now_s)

    def see_at(self, position: Position, now_s: float) -> None:
        """Correct the robot's position, on its way or standing. It drives on from there, if there is a way."""
        if self.moving:
            self.go_on(position, now_s)
        elif self.free:
            self._close_leg(now_s)
            if position != self.position:
                self.position, self.place = position, -1

    def go_on(self, position: Position, now_s: float) -> None:
        """Continue from a position. A robot under way that cannot get to its container from there is free."""
        if self.moving and self.can_reach(self.assignment.container, position):
            self._go_on_from(position, now_s)
            return
        if self.moving:
            self.stop(now_s)
            self.position = position

    def stop(self, now_s: float) -> None:
        """Give up the way. The robot is free where it is."""
        self._halt(self.position_at(now_s), now_s)
        self.assignment = Assignment(WAIT)

    def arrive(self, now_s: float, *, search: bool) -> None:
        """Stand at the assignment's container, expected there now or not, and ``search`` it or settle."""
        if self.route is not None:
            needed_s = self.route.length_m / self.spec.speed_m_per_s
            if now_s - self.moved_s < needed_s - EARLY_S:  # even so, it has driven all of its way
                self.moved_s = now_s - needed_s
        self._close_leg(now_s)
        if self.route is not None:
            self.position, self.route = Position.at(self.route.cells[-1]), None
        self.place, self.passed = self.assignment.container, ()
        self.act = Act(ActKind.SETTLING, now_s)
        if search:
            self.begin(ActKind.SEARCH, now_s)

    def end_search(self, now_s: float) -> None:
        """End the search. What the robot does next is decided within the instant."""
        self._close_leg(now_s)
        self.act = Act(ActKind.SETTLING, now_s)

    def begin(self, kind: ActKind, now_s: float, obj: int = -1) -> None:
        """Begin an act at the place where the robot stands, perhaps with a task object."""
        self._close_leg(now_s)
        self.act = Act(kind, now_s + self.spec.duration_s(kind), obj)

    def end_interaction(self, now_s: float) -> None:
        """End the interaction. A robot that was sent for it becomes free; others may begin another."""
        self._close_leg(now_s)
        self.act = replace(self.act, kind=ActKind.SETTLING, obj=-1)
        if self.assignment.interaction != ANY_SAFE:
            self.release()

    def give_up(self, now_s: float) -> None:
        """Leave off an interaction. The robot is free where it stands."""
        self._close_leg(now_s)
        self.release()

    def release(self) -> None:
        """Become free at the place where the robot stands."""
        self.act = FREE
        self.assignment = Assignment(WAIT, self.assignment.interaction)

    def lose(self, now_s: float) -> None:
        """Leave the team."""
        self._halt(self.position_at(now_s), now_s, Act(ActKind.LOST, obj=self.act.obj))

    def join(self, position: Position, now_s: float) -> None:
        """Take part from now on, free at this position."""
        self._halt(position, now_s)
        self.place, self.assignment = -1, Assignment(WAIT)

    def legs_until(self, now_s: float) -> tuple[Leg, ...]:
        """Return all legs; that of an act under way is cut off at the present instant."""
        return (*self.legs, *([] if self.lost else self._leg_now(now_s)))

    def _driven_m(self, now_s: float) -> float:
        return (now_s - self.moved_s) * self.spec.speed_m_per_s

    def _halt(self, position: Position, now_s: float, act: Act = FREE) -> None:
        self._close_leg(now_s)
        self.position, self.act, self.route, self.passed = position, act, None, ()

    def _drive(self, position: Position, now_s: float) -> None:
        self.position, self.moved_s = position, now_s
        self.route = plan_route(self.home_map, position, self.assignment.container)
        self.act = Act(ActKind.MOVE, now_s + self.route.length_m / self.spec.speed_m_per_s)

    def _go_on_from(self, position: Position, now_s: float) -> None:
        """Continue the leg with another route."""
        if self.route is not None:
            self.passed += self.route.points(self.home_map, self._driven_m(now_s))
        self._drive(position, now_s)

    def _close_leg(self, now_s: float) -> None:
        """Record what the robot did since its last leg; record moves and waits only if time passed."""
        self.legs += self._leg_now(now_s)
        self.since_s = now_s

    def _leg_now(self, now_s: float) -> list[Leg]:
        """Return the leg from the end of the last one until now; a move or a wait only if time passed."""
        kind = self.act.kind.leg
        if kind in (ActKind.MOVE, WAIT_LEG) and self.since_s == now_s:
            return []
        path: tuple[Point, ...] = (self.position.point(self.home_map),)
        target = self.place
        if self.route is not None:
            path = (*self.passed, *self.route.points(self.home_map, self._driven_m(now_s)))
            target = self.assignment.container
        leg = Leg(
            kind=kind,
            t0_s=self.since_s,
            t1_s=now_s,
            container=self.labels.containers[target] if target >= 0 else None,
            object=self.labels.objects[self.act.obj] if self.act.kind is ActKind.INTERACT else None,
            path=path,
        )
        return [leg]
