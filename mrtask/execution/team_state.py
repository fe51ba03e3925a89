"""What a team knows, where its robots are and what they do: the one logic behind simulated and real episodes.

A `TeamState` is told what happened (arrived, searched, interacted, seen, lost, blocked) and keeps belief, automaton and
robots in step with it; between events robots are taken to do as expected, at their speed. It knows nothing of the truth
and of no clock: a simulation or a lab's robots are its world. Its semantics are those that planners assume: a robot
under way arrives, searches a container that nobody has searched, interacts if its assignment and the task allow it, and
is free.

Legend for array shapes: R robots, C containers, O task objects.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mrtask.execution.belief import Belief, Seen
from mrtask.execution.letters import serving_order
from mrtask.execution.motion import Position, plan_route
from mrtask.execution.robot import LOST, Robot
from mrtask.execution.team_spec import RobotSpec
from mrtask.execution.trace import Leg, Letter, Trace
from mrtask.homes.home import Point
from mrtask.maps.home_map import HomeMap
from mrtask.planning.problem import ANY_SAFE, WAIT, Assignment, PlanningProblem, RobotStatus, safe
from mrtask.tasks.automaton import Automaton

_KINDS = {"free": "wait", "settling": "wait", LOST: "wait"}
"""The kind of leg that a mode is, where it is not the mode itself."""
EARLY_S = 1e-6
"""Robots that arrive sooner than expected by more than this were faster than they are said to be."""


class TeamState:
    """The belief, the task's state and the robots.

    Decisions are `problem`, a planner's plan, `assign`. What happens is told by the other methods, all at ``time_s``,
    which the caller moves on. After the events of one instant come `start_interactions` and `release`.

    Args:
        containers: [C] the containers' names.
        belief: from `prior_belief`; it is changed.
    """

    def __init__(
        self,
        containers: Sequence[str],
        home_map: HomeMap,
        automaton: Automaton,
        belief: Belief,
        *,
        spec: RobotSpec,
        starts: Sequence[Position],
    ) -> None:
        self.containers, self.automaton, self.spec = tuple(containers), automaton, spec
        self.belief = belief
        self.use_map(home_map)
        self._safe = safe(automaton)
        self.time_s = 0.0
        self.state = automaton.initial
        self.robots = [Robot(start) for start in starts]
        self.start = starts[0].point(home_map)
        self.letters: list[Letter] = []
        self.news = False
        """Whether anything was learned or done since the last decision."""

    @property
    def accepted(self) -> bool:
        """Whether the task is done."""
        return bool(self.automaton.accepting[self.state])

    @property
    def active(self) -> list[int]:
        """The robots that are not lost: those of the problem, in its order."""
        return [index for index, robot in enumerate(self.robots) if robot.mode != LOST]

    def problem(self) -> PlanningProblem:
        """What a planner may know now, of the `active` robots."""
        return PlanningProblem(
            automaton=self.automaton,
            state=self.state,
            presence_prob=self.belief.presence_prob.copy(),
            searched=self.belief.searched.copy(),
            travel_s=self._travel_s,
            robots=tuple(self._status(self.robots[index]) for index in self.active),
            search_time_s=self.spec.search_time_s,
            interact_time_s=self.spec.interact_time_s,
            may_redirect=self.news,
        )

    def assign(self, assignments: Mapping[int, Assignment]) -> None:
        """Gives robots of the problem new assignments; robots under way take them only where the problem said so.

        Raises:
            ValueError: a free robot without assignment, a busy robot with one, a robot under way redirected although
                nothing was learned, or an unreachable container.
        """
        active = self.active
        for index, number in enumerate(active):
            if self.robots[number].mode == "free" and index not in assignments:
                raise ValueError(f"the planner left free robot {index} without an assignment; `WAIT` is one")
        for index, assignment in assignments.items():
            robot = self.robots[active[index]]
            if robot.mode != "free" and not (self.news and robot.mode == "move"):
                raise ValueError(f"robot {index} is busy ({robot.mode}) and cannot take {assignment}")
            if robot.mode == "move" and assignment.container == robot.assignment.container:
                robot.assignment = assignment
            else:
                self._start_action(robot, assignment)
        self.news = False

    def arrived(self, robot: Robot) -> None:
        """The robot is at its assignment's container, when it was expected there or at any other time."""
        if robot.mode == "move" and robot.route is not None:
            needed_s = robot.route.length_m / self.spec.speed_m_per_s
            if self.time_s - robot.moved_s < needed_s - EARLY_S:  # all of its way is behind it even so
                robot.moved_s = self.time_s - needed_s
        self.close_leg(robot)
        if robot.route is not None:
            robot.position, robot.route = Position.at(robot.route.cells[-1]), None
        robot.place, robot.passed = robot.assignment.container, ()
        if self.belief.searched[robot.place]:
            robot.mode, robot.until_s = "settling", self.time_s
        else:
            robot.mode, robot.until_s = "search", self.time_s + self.spec.search_time_s

    def search_ended(self, robot: Robot, seen: Seen | None, fresh: NDArray[np.bool_] | None = None) -> None:
        """The robot's search is over: what it saw, as of `Belief.learned`; None: it could not search."""
        if seen is None:
            self.failed(robot.place, -1)
        else:
            self.learned(robot.place, seen, fresh)
        self.close_leg(robot, kind="search")
        robot.mode, robot.until_s = "settling", self.time_s

    def learned(self, container: int, seen: Seen, fresh: NDArray[np.bool_] | None = None) -> bool:
        """What a search of the container showed, as of `Belief.learned`, whoever searched. True if that is news."""
        return self._noted(self.belief.learned(container, seen, fresh))

    def glimpsed(self, container: int, obj: int, seen: float) -> bool:
        """One object was seen in passing, as of `Belief.glimpsed`. True if that is news."""
        return self._noted(self.belief.glimpsed(container, obj, seen))

    def failed(self, container: int, obj: int) -> None:
        """A search (object -1) or an interaction could not be made."""
        self.belief.failed(container, obj)
        self.news = True

    def interactions_ended(self, due: Sequence[Robot]) -> None:
        """Interactions that were completed in this instant; those that advance the task are letters of its word."""
        objects = frozenset(robot.obj for robot in due)
        for obj in serving_order(self.automaton, self.state, objects):
            robot = next(robot for robot in due if robot.obj == obj)
            self.state = int(self.automaton.transitions[self.state, obj])
            self.news = True
            number = next(index for index, one in enumerate(self.robots) if one is robot)
            self.letters.append(
                Letter(self.time_s, number, self.automaton.propositions[obj], self.containers[robot.place])
            )
        for robot in due:
            self._end_interaction(robot)

    def interaction_failed(self, robot: Robot, gone: bool) -> None:
        """The robot could not interact; ``gone``: because the object is not there."""
        if gone:
            self._noted(self.belief.ruled_out(robot.place, robot.obj))
        else:
            self.failed(robot.place, robot.obj)
        self._end_interaction(robot)
        robot.mode, robot.until_s = "free", float("inf")
        robot.assignment = Assignment(WAIT, robot.assignment.interaction)

    def start_interactions(self) -> bool:
        """Lets standing robots begin what their assignments allow; True if any did."""
        if self.accepted:
            return False
        standing = [robot for robot in self.robots if robot.mode in ("free", "settling") and robot.place >= 0]
        return bool([robot for robot in standing if self._try_interaction(robot)])

    def release(self) -> None:
        """The instant is over: robots with nothing left to do are free, and what may have been missed is open again."""
        if not self.accepted:
            self.belief.look_again(self._lacking(), self.home_map.reachable)
        for robot in self.robots:
            if robot.mode == "settling":
                robot.mode, robot.until_s = "free", float("inf")
                robot.assignment = Assignment(WAIT, robot.assignment.interaction)

    def is_at(self, robot: Robot, position: Position) -> None:
        """The robot was seen at this position, on its way or anywhere else; it drives on from there."""
        if robot.mode in ("search", "interact", "settling"):
            return
        if robot.mode == "free":
            self.close_leg(robot)
            if position != robot.position:
                robot.position, robot.place = position, -1
            return
        self._pass_on(robot)
        self._drive(robot, position)

    def lose(self, robot: Robot) -> None:
        """The robot is out of the team; what it was on its way to is open again."""
        if robot.mode == "move":
            robot.position = self.position_of(robot)
        self.close_leg(robot)
        robot.mode, robot.until_s, robot.route, robot.passed = LOST, float("inf"), None, ()
        self.news = True

    def join(self, position: Position, robot: Robot | None = None) -> Robot:
        """A new robot, or a lost one, takes part from now on, free at this position."""
        if robot is None:
            robot = Robot(position, since_s=self.time_s)
            self.robots.append(robot)
        self.close_leg(robot)
        robot.mode, robot.position, robot.place, robot.obj = "free", position, -1, -1
        robot.assignment = Assignment(WAIT)
        self.news = True
        return robot

    def use_map(self, home_map: HomeMap) -> None:
        """Ways and travel times by this map; the containers are the same."""
        self.home_map = home_map
        self._travel_s = home_map.travel_m / self.spec.speed_m_per_s

    def take_other_ways(self, home_map: HomeMap, starts: Mapping[int, Position]) -> None:
        """The ways changed under the team, which goes on from ``starts`` (number -> where the robot is) by the new map.

        A robot under way that can no longer get to its container is free.
        """
        self.use_map(home_map)
        self.news = True
        for number, position in starts.items():
            robot = self.robots[number]
            if robot.mode != "move":
                if robot.mode == "free" and position != robot.position:
                    self.close_leg(robot)
                    robot.place = -1
                robot.position = position
            elif np.isfinite(position.distances_m(home_map)[robot.assignment.container]):
                self._pass_on(robot)
                self._drive(robot, position)
            else:
                self.stop(robot)
                robot.position = position

    def stop(self, robot: Robot) -> None:
        """The robot gives up its way and is free where it is."""
        position = self.position_of(robot)
        self.close_leg(robot)
        robot.position, robot.mode, robot.until_s, robot.route = position, "free", float("inf"), None
        robot.passed, robot.assignment = (), Assignment(WAIT)

    def position_of(self, robot: Robot) -> Position:
        """Where the robot is, or should be by now."""
        if robot.mode == "move" and robot.route is not None:
            return robot.route.position((self.time_s - robot.moved_s) * self.spec.speed_m_per_s)
        return robot.position

    def missing(self) -> list[str]:
        """Task objects that advance the task now but were found in no container that can be reached."""
        return [self.automaton.propositions[obj] for obj in np.flatnonzero(self._lacking())]

    def _lacking(self) -> NDArray[np.bool_]:
        """[O] the objects that `missing` names."""
        return np.asarray(self.automaton.advancing[self.state] & ~self.belief.found())

    def _noted(self, news: bool) -> bool:
        self.news |= news
        return news

    def trace(self) -> Trace:
        """The record so far; actions under way are cut off at the present instant."""
        legs = (
            (*robot.legs, *([] if robot.mode == LOST else self._leg_now(robot, _KINDS.get(robot.mode, robot.mode))))
            for robot in self.robots
        )
        return Trace(self.start, tuple(legs), tuple(self.letters))

    def close_leg(self, robot: Robot, kind: str = "") -> None:
        """Writes down what the robot did since its last leg; moves and waits only if time passed."""
        robot.legs += self._leg_now(robot, kind or _KINDS.get(robot.mode, robot.mode))
        robot.since_s = self.time_s

    def _leg_now(self, robot: Robot, kind: str) -> list[Leg]:
        """The leg from the end of the last one until now, or none."""
        if kind in ("move", "wait") and robot.since_s == self.time_s:
            return []
        path: tuple[Point, ...] = (robot.position.point(self.home_map),)
        target = robot.place
        if kind == "move" and robot.route is not None:
            driven_m = (self.time_s - robot.moved_s) * self.spec.speed_m_per_s
            path = (*robot.passed, *robot.route.points(self.home_map, driven_m))
            target = robot.assignment.container
        leg = Leg(
            kind=kind,
            t0_s=robot.since_s,
            t1_s=self.time_s,
            container=self.containers[target] if target >= 0 else None,
            object=self.automaton.propositions[robot.obj] if kind == "interact" else None,
            path=path,
        )
        return [leg]

    def _status(self, robot: Robot) -> RobotStatus:
        moving = robot.mode == "move"
        return RobotStatus(
            travel_s=self.position_of(robot).distances_m(self.home_map) / self.spec.speed_m_per_s,
            place=robot.place,
            free=robot.mode == "free",
            target=robot.assignment.container if moving else -1,
            interaction=robot.assignment.interaction,
            remaining_s=0.0 if robot.mode == "free" else max(robot.until_s - self.time_s, 0.0),
            interacting=robot.obj if robot.mode == "interact" else -1,
        )

    def _start_action(self, robot: Robot, assignment: Assignment) -> None:
        position = self.position_of(robot)
        container = assignment.container
        if container != WAIT and not np.isfinite(position.distances_m(self.home_map)[container]):
            raise ValueError(f"container {self.containers[container]} cannot be reached; assign another or WAIT")
        self.close_leg(robot)
        robot.position, robot.route, robot.passed = position, None, ()
        robot.assignment, robot.mode, robot.until_s = assignment, "free", float("inf")
        if container == WAIT:
            return
        if container == robot.place:
            self.arrived(robot)
            return
        robot.place = -1
        self._drive(robot, position)

    def _pass_on(self, robot: Robot) -> None:
        """The leg goes on with another route."""
        if robot.route is not None:
            driven_m = (self.time_s - robot.moved_s) * self.spec.speed_m_per_s
            robot.passed += robot.route.points(self.home_map, driven_m)

    def _drive(self, robot: Robot, position: Position) -> None:
        robot.position, robot.moved_s, robot.mode = position, self.time_s, "move"
        robot.route = plan_route(self.home_map, position, robot.assignment.container)
        robot.until_s = self.time_s + robot.route.length_m / self.spec.speed_m_per_s

    def _try_interaction(self, robot: Robot) -> bool:
        """Starts the interaction the robot's assignment allows at its place now, if any."""
        if not self.belief.searched[robot.place]:
            return False
        wanted = robot.assignment.interaction
        allowed = self._safe[self.state] if wanted == ANY_SAFE else self.automaton.advancing[self.state]
        choices = np.flatnonzero(allowed & (self.belief.presence_prob[robot.place] > 0))
        if wanted != ANY_SAFE:
            choices = choices[choices == wanted] if robot.mode == "settling" else choices[:0]
        if not len(choices):
            return False
        after = self.automaton.steps_to_accept[self.automaton.transitions[self.state, choices]]
        self.close_leg(robot)
        robot.obj = int(choices[int(np.argmin(after))])
        robot.mode, robot.until_s = "interact", self.time_s + self.spec.interact_time_s
        return True

    def _end_interaction(self, robot: Robot) -> None:
        self.close_leg(robot)
        robot.mode, robot.obj = "settling", -1
        if robot.assignment.interaction != ANY_SAFE:
            robot.mode, robot.until_s = "free", float("inf")
            robot.assignment = Assignment(WAIT, robot.assignment.interaction)
