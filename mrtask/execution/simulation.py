"""The team in the home: concurrent robots, events in time order, the truth revealed container by container.

The semantics are those that planners assume: a robot under way arrives, searches a container that nobody has searched,
interacts if its assignment and the task allow it, and is free. All events of one instant are settled before anybody
is asked for a decision; interactions that end at the same instant spell letters in the order that serves the task.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mrtask.execution.motion import Position, Route, plan_route
from mrtask.execution.team import Team
from mrtask.execution.trace import Leg, Letter, Trace
from mrtask.homes.home import Home
from mrtask.maps.home_map import HomeMap
from mrtask.planning.problem import ANY_SAFE, WAIT, Assignment, PlanningProblem, RobotStatus, safe
from mrtask.tasks.automaton import Automaton

SAME_INSTANT_S = 1e-9


@dataclass
class _Robot:
    position: Position
    place: int = -1
    """The container the robot stands at."""
    mode: str = "free"
    """``free``, ``move``, ``search``, ``interact`` or, between arrival and the end of the instant, ``settling``."""
    assignment: Assignment = field(default=Assignment(WAIT))
    since_s: float = 0.0
    until_s: float = float("inf")
    route: Route | None = None
    obj: int = -1
    legs: list[Leg] = field(default_factory=list)


class Simulation:
    """One episode's world. The planner's loop is `problem`, then `assign`, then `advance`, until `accepted`.

    Args:
        truth: [C, O] which container holds which task object.
        likelihood: [C, O] the prior that planners see.
        known: the team knows the truth from the start, and no container needs a search.
        known_containers: these need no search even so.
    """

    def __init__(
        self,
        home: Home,
        home_map: HomeMap,
        automaton: Automaton,
        likelihood: NDArray[np.float64],
        truth: NDArray[np.bool_],
        *,
        team: Team,
        start_cell: tuple[int, int],
        known: bool = False,
        known_containers: Sequence[int] = (),
    ) -> None:
        self.home, self.home_map, self.automaton, self.truth = home, home_map, automaton, truth
        self.spec = team.spec
        self._safe = safe(automaton)
        self.time_s = 0.0
        self.state = automaton.initial
        self.searched = home_map.reachable.copy() if known else np.zeros(len(home.containers), dtype=bool)
        self.searched[list(known_containers)] = True
        self.presence_prob = np.where(self.searched[:, None], truth.astype(float), likelihood)
        self.presence_prob[~home_map.reachable] = 0.0
        self._travel_s = home_map.travel_m / team.spec.speed_m_per_s
        self._start = Position.at(start_cell)
        self._robots = [_Robot(self._start) for _ in range(team.robots)]
        self._letters: list[Letter] = []
        self._decide_again = False
        self.news = False
        """Whether anything was learned or done since the last decision."""

    @property
    def accepted(self) -> bool:
        """Whether the task is done."""
        return bool(self.automaton.accepting[self.state])

    def problem(self) -> PlanningProblem:
        """What a planner may know now."""
        return PlanningProblem(
            automaton=self.automaton,
            state=self.state,
            presence_prob=self.presence_prob.copy(),
            searched=self.searched.copy(),
            travel_s=self._travel_s,
            robots=tuple(self._status(robot) for robot in self._robots),
            search_time_s=self.spec.search_time_s,
            interact_time_s=self.spec.interact_time_s,
            may_redirect=self.news,
        )

    def assign(self, assignments: Mapping[int, Assignment]) -> None:
        """Gives robots new assignments; robots under way take them only where the problem said so.

        Raises:
            ValueError: a free robot without assignment, a busy robot with one, a robot under way redirected although
                nothing was learned, or an unreachable container.
        """
        for index, robot in enumerate(self._robots):
            if robot.mode == "free" and index not in assignments:
                raise ValueError(f"the planner left free robot {index} without an assignment; `WAIT` is one")
        for index, assignment in assignments.items():
            robot = self._robots[index]
            if robot.mode != "free" and not (self.news and robot.mode == "move"):
                raise ValueError(f"robot {index} is busy ({robot.mode}) and cannot take {assignment}")
            if robot.mode == "move" and assignment.container == robot.assignment.container:
                robot.assignment = assignment
            else:
                self._start_action(robot, assignment)
        letters = len(self._letters)
        self.news = False
        self._settle()
        self._decide_again = len(self._letters) > letters

    def advance(self) -> bool:
        """Lets time run until the task is done or a robot is free; False if nobody does anything any more."""
        if self._decide_again:  # an assignment was completed on the spot
            return True
        while not self.accepted:
            until_s = min(robot.until_s for robot in self._robots)
            if until_s == float("inf"):
                return False
            self.time_s = until_s
            freed = self._process_instant()
            if freed:
                return True
        return True

    def trace(self) -> Trace:
        """The record so far; actions under way are cut off at the present instant."""
        for robot in self._robots:
            self._close_leg(robot)
        return Trace(
            self._start.point(self.home_map), tuple(tuple(robot.legs) for robot in self._robots), tuple(self._letters)
        )

    def missing(self) -> list[str]:
        """Task objects that advance the task now but were found in no reachable container."""
        found = (self.truth & self.searched[:, None]).any(axis=0)
        lacking = np.flatnonzero(self.automaton.advancing[self.state] & ~found)
        return [self.automaton.propositions[obj] for obj in lacking]

    def _status(self, robot: _Robot) -> RobotStatus:
        moving = robot.mode == "move"
        return RobotStatus(
            travel_s=self._position(robot).distances_m(self.home_map) / self.spec.speed_m_per_s,
            place=robot.place,
            free=robot.mode == "free",
            target=robot.assignment.container if moving else -1,
            interaction=robot.assignment.interaction,
            remaining_s=0.0 if robot.mode == "free" else robot.until_s - self.time_s,
            interacting=robot.obj if robot.mode == "interact" else -1,
        )

    def _position(self, robot: _Robot) -> Position:
        if robot.mode == "move" and robot.route is not None:
            return robot.route.position((self.time_s - robot.since_s) * self.spec.speed_m_per_s)
        return robot.position

    def _start_action(self, robot: _Robot, assignment: Assignment) -> None:
        robot.position = self._position(robot)
        container = assignment.container
        if container != WAIT and not self.home_map.reachable[container]:
            raise ValueError(
                f"container {self.home.containers[container].id} cannot be reached; assign another or WAIT"
            )
        self._close_leg(robot)
        robot.assignment, robot.route, robot.mode, robot.until_s = assignment, None, "free", float("inf")
        if container == WAIT:
            return
        if container == robot.place:
            self._arrive(robot)
            return
        robot.place = -1
        robot.route = plan_route(self.home_map, robot.position, container)
        robot.mode, robot.until_s = "move", self.time_s + robot.route.length_m / self.spec.speed_m_per_s

    def _arrive(self, robot: _Robot) -> None:
        self._close_leg(robot)
        if robot.route is not None:
            robot.position, robot.route = Position.at(robot.route.cells[-1]), None
        robot.place = robot.assignment.container
        if self.searched[robot.place]:
            robot.mode, robot.until_s = "settling", self.time_s
        else:
            robot.mode, robot.until_s = "search", self.time_s + self.spec.search_time_s

    def _process_instant(self) -> bool:
        """Settles everything that is due now; True if that leaves a robot with a new freedom to decide."""
        acted = [robot for robot in self._robots if robot.until_s <= self.time_s + SAME_INSTANT_S]
        for robot in acted:
            if robot.mode == "move":
                self._arrive(robot)
        for robot in acted:
            if robot.mode == "search" and robot.until_s <= self.time_s + SAME_INSTANT_S:
                self._reveal(robot)
        self._settle()
        return any(robot.mode == "free" for robot in acted)

    def _reveal(self, robot: _Robot) -> None:
        if not self.searched[robot.place]:
            self.searched[robot.place] = True
            self.news = True
            self.presence_prob[robot.place] = self.truth[robot.place]
        self._close_leg(robot, kind="search")
        robot.mode, robot.until_s = "settling", self.time_s

    def _settle(self) -> None:
        """Starts and completes interactions until nothing more happens at this instant; the rest are free."""
        while not self.accepted:
            self._complete_interactions()
            standing = [robot for robot in self._robots if robot.mode in ("free", "settling") and robot.place >= 0]
            started = [robot for robot in standing if self._try_interaction(robot)]
            if not started:
                break
        for robot in self._robots:
            if robot.mode == "settling":
                robot.mode, robot.until_s = "free", float("inf")
                robot.assignment = Assignment(WAIT, robot.assignment.interaction)

    def _try_interaction(self, robot: _Robot) -> bool:
        """Starts the interaction the robot's assignment allows at its place now, if any."""
        if not self.searched[robot.place]:
            return False
        wanted = robot.assignment.interaction
        allowed = self._safe[self.state] if wanted == ANY_SAFE else self.automaton.advancing[self.state]
        choices = np.flatnonzero(allowed & self.truth[robot.place])
        if wanted != ANY_SAFE:
            choices = choices[choices == wanted] if robot.mode == "settling" else choices[:0]
        if not len(choices):
            return False
        after = self.automaton.steps_to_accept[self.automaton.transitions[self.state, choices]]
        self._close_leg(robot)
        robot.obj = int(choices[int(np.argmin(after))])
        robot.mode, robot.until_s = "interact", self.time_s + self.spec.interact_time_s
        return True

    def _complete_interactions(self) -> None:
        due = [r for r in self._robots if r.mode == "interact" and r.until_s <= self.time_s + SAME_INSTANT_S]
        if not due:
            return
        objects = frozenset(robot.obj for robot in due)
        for obj in serving_order(self.automaton, self.state, objects):
            robot = next(robot for robot in due if robot.obj == obj)
            place = self.home.containers[robot.place].id
            self.state = int(self.automaton.transitions[self.state, obj])
            self.news = True
            self._letters.append(
                Letter(self.time_s, self._robots.index(robot), self.automaton.propositions[obj], place)
            )
        for robot in due:
            self._close_leg(robot)
            robot.mode, robot.obj = "settling", -1
            if robot.assignment.interaction != ANY_SAFE:
                robot.mode, robot.until_s = "free", float("inf")
                robot.assignment = Assignment(WAIT, robot.assignment.interaction)

    def _close_leg(self, robot: _Robot, kind: str = "") -> None:
        """Writes down what the robot did since its last leg; moves and waits only if time passed."""
        kind = kind or {"free": "wait", "settling": "wait"}.get(robot.mode, robot.mode)
        t0_s, robot.since_s = robot.since_s, self.time_s
        if kind in ("move", "wait") and t0_s == self.time_s:
            return
        path: tuple[tuple[float, float], ...] = (robot.position.point(self.home_map),)
        target = robot.place
        if kind == "move" and robot.route is not None:
            path = robot.route.points(self.home_map, (self.time_s - t0_s) * self.spec.speed_m_per_s)
            target = robot.assignment.container
        robot.legs.append(
            Leg(
                kind=kind,
                t0_s=t0_s,
                t1_s=self.time_s,
                container=self.home.containers[target].id if target >= 0 else None,
                object=self.automaton.propositions[robot.obj] if kind == "interact" else None,
                path=path,
            )
        )


def serving_order(automaton: Automaton, state: int, objects: frozenset[int]) -> list[int]:
    """The order of one instant's interactions: all that advance the task are made, so that it ends nearest to done.

    Only an interaction that does not advance the task when its turn comes is dropped. Of orders that end equally near,
    the one that drops fewest; then the lower object index first.
    """

    @cache
    def best(state: int, rest: frozenset[int]) -> tuple[int, tuple[int, ...]]:
        orders = []
        for obj in sorted(rest):
            if automaton.advancing[state, obj]:
                steps, order = best(int(automaton.transitions[state, obj]), rest - {obj})
                orders.append((steps, (obj, *order)))
        idle = (int(automaton.steps_to_accept[state]), ())
        return min(orders, key=lambda option: (option[0], -len(option[1])), default=idle)

    return list(best(state, objects)[1])
