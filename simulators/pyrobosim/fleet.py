"""Drive the robots of a pyrobosim world in stepped time, and decide which goes first where they meet.

pyrobosim's path executor runs in threads on the wall's clock and lets robots drive through each other. So the robots
are driven by velocity commands in a loop of our own, the other way that its manual describes ("Robot Dynamics"), one
step of ``STEP_S`` after another: its `RobotDynamics2D.step` limits speed and acceleration, its `Robot.is_in_collision`
refuses a step into walls, furniture or another robot. It has no rules for robots that meet. Ours:

1. A robot stops before its way comes within ``KEEP_OFF_M`` of another one, or of where one that goes first and moves
   will be within ``CROSSING_S``.
2. The robot that was named earlier in the team goes first. One that waits for orders, or has given way, goes last; one
   that searches or interacts is waited for.
3. A robot that holds up one that goes before it drives to the nearest place off that one's way, and goes on when it
   has passed, by the shortest way from where it then is. Meanwhile it has the other's rank towards everybody else.
4. If there is no such place, it goes first itself, and the other one gives way.
5. A robot that has not moved for ``STUCK_S`` goes first from then on; after ``GIVE_UP_S`` it reports that it cannot get
   there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import hypot, inf

import numpy as np
from numpy.typing import NDArray
from pyrobosim.core import Robot
from pyrobosim.core import World as Simulated
from pyrobosim.utils.pose import Pose
from scipy import ndimage
from skimage.graph import MCP_Geometric

from mrtask.execution.make_trial import free_cell_near
from mrtask.execution.motion import Position, plan_route
from mrtask.homes.home import Point
from mrtask.maps.home_map import HomeMap
from simulators.pyrobosim.robot import Body
from simulators.pyrobosim.ways import Way, speed_to_stop_in, steer, turn_rate, wrapped

STEP_S = 0.1
KEEP_OFF_M = 0.06
"""The gap between the edges of two robots below which a robot does not drive up to another."""
REFUGE_M = 0.12
"""Between the edges of a robot that gives way and of one that passes."""
HORIZON_M, CROSSING_S = 1.2, 1.0
"""How far ahead a robot looks for others, and for how long a robot that goes first and moves is expected to move on."""
PASSED_M = 3.0
"""A robot has passed when this much of its way ahead is clear of the other's next metre."""
NEXT_M = 1.0
STANDING_M_PER_S = 0.05
PATIENCE_S, ASK_AGAIN_S, PARKED_S = 0.5, 2.0, 20.0
STUCK_S, GIVE_UP_S = 15.0, 90.0
ARRIVED_M, ASIDE_M, FACING_RAD = 0.03, 0.05, 0.03
CAREFUL_S = 1.0
JOIN_M = 0.05
"""A robot further than this from the beginning of its route drives there first."""
LEAST = 1e-9
"""A command of exactly zero stops a pyrobosim robot at once, whatever its acceleration; this one brakes."""


@dataclass(eq=False)
class Member:
    """One robot of the fleet."""

    robot: Robot
    rank: float
    target: str | None = None
    """The container it was ordered to."""
    way: Way | None = None
    docking: bool = False
    """It is where its way ends and turns to face the container."""
    busy: bool = False
    """It searches or interacts."""
    aside: bool = False
    """It gives way: ``way`` leads aside and, when that is driven, ``own_way`` to its target."""
    aside_for: "Member | None" = None
    aside_rank: float = inf
    own_way: Way | None = None
    holder: "Member | None" = None
    held_s: float = 0.0
    still_s: float = 0.0
    parked_s: float = 0.0
    asked_s: float = -inf
    careful_s: float = -inf

    @property
    def name(self) -> str:
        """The robot's name."""
        return str(self.robot.name)

    @property
    def place(self) -> Point:
        """Its position in metres."""
        pose = self.robot.get_pose()
        return (float(pose.x), float(pose.y))

    @property
    def order(self) -> float:
        """The robot with the lower rank goes first."""
        if self.way is None:
            return inf
        return self.aside_rank if self.aside else self.rank


@dataclass
class Tally:
    """What happened where robots met."""

    contacts: int = 0
    """Steps that pyrobosim refused because of another robot, and steps after which two robots overlapped."""
    brushes: int = 0
    """Steps that pyrobosim refused because of a wall or furniture."""
    least_gap_m: float = inf
    """Between the edges of any two robots at any time."""
    held_s: float = 0.0
    """The total time that robots stood because of others."""
    gave_way: int = 0
    gave_up: int = 0


@dataclass
class Moved:
    """What a step led to: robots that arrived, and robots that will not get to their target."""

    arrived: list[str] = field(default_factory=list)
    gave_up: list[str] = field(default_factory=list)


class Fleet:
    """The robots; `step` is the only thing that moves them.

    Args:
        home_map: by which robots give way and go on; the live team's.
        nav_poses: container -> where a robot stands to search it.
        robots: in the order in which they go first.
    """

    def __init__(
        self,
        simulated: Simulated,
        home_map: HomeMap,
        containers: Sequence[str],
        nav_poses: Mapping[str, Pose],
        robots: Sequence[Robot],
        body: Body,
    ) -> None:
        self.simulated, self.home_map, self.body = simulated, home_map, body
        self.containers, self.nav_poses = list(containers), nav_poses
        self.members = {robot.name: Member(robot, float(rank)) for rank, robot in enumerate(robots)}
        self.time_s = 0.0
        self.tally = Tally()

    def drive(self, name: str, container: str, route: Sequence[Point]) -> None:
        """Send the robot to the container, by this route; without one, by the shortest way."""
        member = self.members[name]
        member.target, member.still_s = container, 0.0
        member.own_way = self._joined(member, route) if route else self._way_to(member, container)
        if not member.aside:
            self._set_way(member, member.own_way)

    def halt(self, name: str) -> None:
        """Take the robot's target away; if it is giving way, it goes on doing so."""
        member = self.members[name]
        member.target = member.own_way = None
        if not member.aside:
            self._set_way(member, None)

    def stands_at(self, name: str, container: str) -> bool:
        """Return whether the robot stands where the container is searched."""
        member = self.members[name]
        return member.way is None and bool(member.robot.get_pose().is_approx(self.nav_poses[container]))

    def step(self) -> Moved:
        """Let `STEP_S` pass."""
        self.time_s += STEP_S
        moved = Moved()
        for member in self.members.values():
            if member.way is not None:
                member.way.advance(member.place)
            self._go_on_if_passed(member)
        limits = {name: self._look_ahead(member) for name, member in self.members.items()}
        for member in sorted(self.members.values(), key=lambda one: one.order):
            self._ask_to_give_way(member)
        for member in sorted(self.members.values(), key=lambda one: one.order):
            self._move(member, limits[member.name])
            self._arrive(member, moved)
            self._wait_not_for_ever(member, moved)
        self._measure_gaps()
        return moved

    def _joined(self, member: Member, route: Sequence[Point]) -> Way:
        place = member.place
        first = route[0]
        apart_m = hypot(first[0] - place[0], first[1] - place[1])
        return Way([place, *route] if apart_m > JOIN_M or len(route) < 2 else route)

    def _set_way(self, member: Member, way: Way | None) -> None:
        member.way, member.docking = way, False
        member.holder, member.held_s = None, 0.0

    def _way_to(self, member: Member, container: str) -> Way:
        """Return the shortest way from where the robot is, as the live team would plan it."""
        start = Position.at(free_cell_near(self.home_map, member.place, inf))
        route = plan_route(self.home_map, start, self.containers.index(container))
        return self._joined(member, route.points_after(self.home_map, 0.0))

    def _look_ahead(self, member: Member) -> float:
        """Return the speed that others allow, and note which robot is in the way."""
        holder, gap_m = None, inf
        if member.way is not None and not member.docking:
            ahead = member.way.ahead(HORIZON_M)
            step_m = min(member.way.length_m - member.way.progress_m, HORIZON_M) / (len(ahead) - 1)
            for other in self.members.values():
                if other is member:
                    continue
                theirs = np.array([other.place])
                if other.way is not None and other.order < member.order:
                    soon_m = max(float(other.robot.dynamics.velocity[0]), 0.0) * CROSSING_S
                    theirs = np.vstack([theirs, other.way.ahead(soon_m)])
                now_m = float(np.hypot(*(theirs - member.place).T).min())
                apart_m = np.hypot(*(ahead[:, None] - theirs[None]).transpose(2, 0, 1)).min(axis=1)
                too_near = np.flatnonzero((apart_m < 2 * self.body.radius_m + KEEP_OFF_M) & (apart_m < now_m - LEAST))
                if len(too_near) and (found_m := max(int(too_near[0]) - 1, 0) * step_m) < gap_m:
                    holder, gap_m = other, found_m
        # Half of the gap: the other one may be coming.
        limit = speed_to_stop_in(gap_m / 2, self.body, STEP_S) if holder is not None else self.body.speed_m_per_s
        held = holder is not None and limit < STANDING_M_PER_S
        member.holder = holder if held else None
        member.held_s = member.held_s + STEP_S if held else 0.0
        self.tally.held_s += STEP_S * held
        return limit

    def _ask_to_give_way(self, member: Member) -> None:
        other = member.holder
        if other is None or other.busy or other.docking or member.held_s < PATIENCE_S:
            return
        if other.order < member.order or self.time_s - other.asked_s < ASK_AGAIN_S:
            return
        other.asked_s = self.time_s
        for ignored, rank in ((None, member.order), (member, member.order - 0.5)):
            path = self._refuge(other, member, ignored)
            if path is not None:
                other.aside, other.aside_for, other.aside_rank = True, member, rank
                self._set_way(other, Way([other.place, *path]))
                self.tally.gave_way += 1
                return
        self._put_first(other)

    def _put_first(self, member: Member) -> None:
        member.rank = min(one.rank for one in self.members.values()) - 1.0

    def _refuge(self, member: Member, passing: Member, ignored: Member | None) -> list[Point] | None:
        """Return the way to the nearest place off the other robot's way, or None."""
        home_map, radius_m = self.home_map, self.body.radius_m
        others = [one for one in self.members.values() if one is not member]
        ways = [one.way.ahead() for one in others if one.way is not None and one.order <= passing.order]
        standing = np.array([one.place for one in others])
        in_the_way = self._within(np.concatenate([*ways, standing]), 2 * radius_m + REFUGE_M)
        occupied = np.array([one.place for one in others if one is not ignored]).reshape(-1, 2)
        closed = ~home_map.free | self._within(occupied, 2 * radius_m + KEEP_OFF_M / 2)
        start = free_cell_near(home_map, member.place, inf)
        costs = np.where(closed, -1.0, 1.0)
        costs[start] = 1.0
        search = MCP_Geometric(costs)
        away, _ = search.find_costs([start])
        away = np.where(in_the_way | closed, inf, away)
        nearest = np.unravel_index(int(np.argmin(away)), away.shape)
        if not np.isfinite(away[nearest]):
            return None
        return [home_map.cell_center((int(row), int(col))) for row, col in search.traceback(nearest)]

    def _within(self, points: NDArray[np.float64], metres: float) -> NDArray[np.bool_]:
        """Return [H, W] the cells that are near any of the points."""
        marked: NDArray[np.bool_] = np.ones(self.home_map.free.shape, dtype=bool)
        for x, y in points:
            row, col = self.home_map.cell_of((x, y))
            if 0 <= row < marked.shape[0] and 0 <= col < marked.shape[1]:
                marked[row, col] = False
        if marked.all():
            return ~marked
        away: NDArray[np.float64] = ndimage.distance_transform_edt(marked)
        return away * self.home_map.resolution_m < metres

    def _go_on_if_passed(self, member: Member) -> None:
        """Let a robot that gave way and has reached its refuge go on once the other one has passed."""
        if not member.aside or member.way is not None:
            return
        member.parked_s += STEP_S
        if member.own_way is None or member.target is None:
            member.aside, member.aside_for = False, None
            return
        passing = member.aside_for
        if passing is not None and passing.way is not None and member.parked_s < PARKED_S:
            theirs = np.vstack([passing.way.ahead(PASSED_M), passing.place])
            mine = member.own_way.ahead(NEXT_M)
            apart_m = np.hypot(*(theirs[:, None] - mine[None]).transpose(2, 0, 1))
            if apart_m.min() < 2 * self.body.radius_m + REFUGE_M:
                return
        member.aside, member.aside_for = False, None
        self._set_way(member, member.own_way)

    def _move(self, member: Member, limit_m_per_s: float) -> None:
        robot, pose = member.robot, member.robot.get_pose()
        speed = turn = 0.0
        if member.docking and member.target is not None:
            turn = turn_rate(wrapped(self.nav_poses[member.target].get_yaw() - pose.get_yaw()), self.body, STEP_S)
        elif member.way is not None:
            careful = self.time_s - member.careful_s < CAREFUL_S
            speed, turn = steer(
                member.place, pose.get_yaw(), member.way, limit_m_per_s, self.body, STEP_S, careful=careful
            )
        if not speed and not turn and not np.abs(robot.dynamics.velocity).max() > LEAST:
            return
        target = robot.dynamics.step([speed or LEAST, 0.0, turn or LEAST], STEP_S)
        if not robot.is_in_collision(target):
            robot.set_pose(target)
            return
        robot.dynamics.reset(velocity=np.zeros(3))
        if self.simulated.collides_with_robots(target, robot):
            self.tally.contacts += 1
        else:
            self.tally.brushes += 1
            member.careful_s = self.time_s

    def _arrive(self, member: Member, moved: Moved) -> None:
        if member.way is None:
            return
        pose = member.robot.get_pose()
        left_m = hypot(member.way.end[0] - pose.x, member.way.end[1] - pose.y)
        if member.aside:
            if left_m < ASIDE_M:
                self._set_way(member, None)
                member.parked_s = 0.0
                member.own_way = self._way_to(member, member.target) if member.target is not None else None
            return
        if member.target is None:
            return
        nav_pose = self.nav_poses[member.target]
        member.docking |= left_m < ARRIVED_M
        turned = abs(wrapped(nav_pose.get_yaw() - pose.get_yaw())) < FACING_RAD
        if member.docking and turned:
            # pyrobosim knows a robot to be at a location only in exactly the location's navigation pose.
            member.robot.dynamics.reset(velocity=np.zeros(3))
            member.robot.set_pose(nav_pose)
            self._set_way(member, None)
            member.target = member.own_way = None
            moved.arrived.append(member.name)

    def _wait_not_for_ever(self, member: Member, moved: Moved) -> None:
        if member.target is None:
            return
        standing = abs(float(member.robot.dynamics.velocity[0])) < STANDING_M_PER_S and not member.docking
        member.still_s = member.still_s + STEP_S if standing else 0.0
        if member.still_s > GIVE_UP_S:
            moved.gave_up.append(member.name)
            self.tally.gave_up += 1
            self.halt(member.name)
        elif member.still_s and member.still_s % STUCK_S < STEP_S:
            self._put_first(member)

    def _measure_gaps(self) -> None:
        places = np.array([member.place for member in self.members.values()])
        for index, place in enumerate(places[1:], 1):
            gap_m = float(np.hypot(*(places[:index] - place).T).min()) - 2 * self.body.radius_m
            self.tally.least_gap_m = min(self.tally.least_gap_m, gap_m)
            self.tally.contacts += gap_m < -LEAST
