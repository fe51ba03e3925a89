"""A team of real robots: events in, orders out.

`LiveTeam` is the `TeamState` of the simulated episode behind the messages of `mrtask.execution.messages`. It finds out
what an event means now, whatever order events come in: a search reported before the arrival implies it, a late or
repeated report changes nothing, what was seen is kept whoever saw it, and of two sights of one object the later counts.
Then it lets the planner decide, where a robot became free or something unexpected happened, and says what changed.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrtask.errors import InputError
from mrtask.execution import messages as m
from mrtask.execution.barriers import Barrier, barred_map
from mrtask.execution.motion import Position
from mrtask.execution.scenario import free_cell_near
from mrtask.execution.team import RobotSpec
from mrtask.execution.team_state import LOST, Robot, TeamState, known_world
from mrtask.execution.trials import key_seed
from mrtask.homes.home import Home, Point
from mrtask.maps.home_map import HomeMap
from mrtask.names import name_to_text
from mrtask.planning.planners import make_planner
from mrtask.planning.problem import WAIT, Assignment
from mrtask.tasks.automaton import build_automaton
from mrtask.tasks.words import ReadTask

POSE_REACH_M = 1.0
"""A robot may report to be this far off the free floor."""
MAX_AHEAD_S = 86_400.0
"""An event that lies further ahead of all before it has a wrong clock."""
MAX_ROBOTS = 64
MAX_BARRIERS = 100
IDS_KEPT = 100_000
_ROBOT_NAME = re.compile(r"[^\x00-\x1f\x7f]+")
_ACTIONS = {"move": "navigate", "search": "search", "interact": "interact", "free": "wait", "settling": "wait"}


@dataclass(frozen=True, eq=False)
class LiveSetup:
    """What does not change while a live team works: where, what for, by which planner."""

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


class Refused(Exception):
    """Why an event changes nothing."""


class LiveTeam:
    """See the module. `handle` is all there is to it; `mrtask.execution.live_store` saves and restores it.

    Args:
        robots: name -> where it is, in metres.

    Raises:
        InputError: a robot's place is off the free floor, or the planner needs to know the contents.
    """

    def __init__(self, setup: LiveSetup, robots: Mapping[str, Point]) -> None:
        if not robots:
            raise InputError("a live team needs at least one robot to start with")
        self.setup = setup
        self.planner = make_planner(setup.planner, dict(setup.planner_options))
        if self.planner.knows_contents:
            raise InputError(f"planner {setup.planner!r} knows all contents, which nobody does here; give another")
        automaton = build_automaton(setup.task.formula, setup.task.propositions)
        self.containers = {container.id: index for index, container in enumerate(setup.home.containers)}
        self.objects = {name_to_text(name): index for index, name in enumerate(setup.task.propositions)}
        presence_prob, searched = known_world(setup.likelihood, setup.home_map.reachable, {})
        starts = [Position.at(free_cell_near(setup.home_map, point, POSE_REACH_M)) for point in robots.values()]
        self.names = list(robots)
        self.team = TeamState(
            list(self.containers), setup.home_map, automaton, presence_prob, searched, spec=setup.spec, starts=starts
        )
        self.decisions = self.orders = self.map_version = 0
        self.barriers: dict[str, Barrier] = {}
        self.ids: dict[str, None] = {}
        self.seen_s = np.full(presence_prob.shape, -np.inf)
        """[C, O] when it was last seen whether the object is there."""
        self.heard_s = [0.0] * len(self.names)
        """[R] the time of the last pose."""
        self.told: dict[str, tuple[Any, ...]] = {}
        """Robot -> what its last order was made from."""
        self.busy: set[int] = set()
        self.ended: list[int] = []
        self.surprise = True

    @property
    def last_event(self) -> str | None:
        """The id of the last event that was taken in."""
        return next(reversed(self.ids), None)

    def begin(self) -> list[m.Outgoing]:
        """The first decision, or after a restart the next."""
        return self._go_on(decide=True)

    def handle(self, events: Sequence[Any], *, more: bool = False) -> list[m.Outgoing]:
        """Takes in events of one instant.

        Args:
            events: of the models in `mrtask.execution.messages.Event`.
            more: another batch of this instant follows, so nobody is sent anywhere yet.

        Returns:
            One `Answer` for each event, then the orders that changed, and the task's state if anything changed.
        """
        answers: list[m.Outgoing] = [self._answer(event) for event in events]
        if all(isinstance(answer, m.Answer) and answer.status != "accepted" for answer in answers) and answers:
            return answers
        return answers + self._go_on(decide=not more)

    def task_state(self) -> m.TaskState:
        """How far the task is."""
        team = self.team
        word = tuple(
            m.Letter(
                time_s=letter.t_s, robot=self.names[letter.robot], object=letter.object, container=letter.container
            )
            for letter in team.letters
        )
        status, reason = "running", ""
        if team.accepted:
            status = "done"
        elif not any(robot.mode in ("move", "search", "interact") for robot in team.robots):
            missing = team.missing()
            reachable = np.isfinite([team.position_of(robot).distances_m(team.home_map) for robot in self._present()])
            all_searched = bool(team.searched[reachable.any(axis=0)].all()) if len(reachable) else False
            status = "stuck"
            reason = "every robot waits"
            if not len(reachable):
                reason = "no robot is left; robot_joined helps"
            elif missing and all_searched:
                reason = f"found in no container that can be reached: {', '.join(missing)}"
        return m.TaskState(status=status, time_s=team.time_s, word=word, reason=reason)  # type: ignore[arg-type]

    def welcome(self) -> m.Welcome:
        """What this is about."""
        task = self.setup.task
        return m.Welcome(
            task=self.setup.text,
            formula=task.formula,
            objects=task.propositions,
            containers=tuple(self.containers),
            robots=tuple(self.names[index] for index in range(len(self.names)) if self.team.robots[index].mode != LOST),
            last_event=self.last_event,
        )

    def present_orders(self) -> list[m.Outgoing]:
        """The orders in force, as if they were given now."""
        return [self._order(index) for index, robot in enumerate(self.team.robots) if robot.mode != LOST]

    def _present(self) -> list[Robot]:
        return [robot for robot in self.team.robots if robot.mode != LOST]

    def _answer(self, event: Any) -> m.Answer:
        if event.id in self.ids:
            return m.Answer(event=event.id, status="duplicate", reason="an event of this id was taken in before")
        try:
            if event.time_s > self.team.time_s + MAX_AHEAD_S:
                raise Refused(f"its time_s is more than {MAX_AHEAD_S:g} s ahead of all before; is its clock right?")
            self.team.time_s = max(self.team.time_s, event.time_s)
            note = getattr(self, f"_on_{event.type}")(event)
        except Refused as refused:
            return m.Answer(event=event.id, status="rejected", reason=str(refused))
        self.ids[event.id] = None
        if len(self.ids) > IDS_KEPT:
            del self.ids[next(iter(self.ids))]
        return m.Answer(event=event.id, status="accepted", reason=note or "")

    def _go_on(self, *, decide: bool) -> list[m.Outgoing]:
        team = self.team
        if self.ended:
            team.interactions_ended([team.robots[index] for index in sorted(self.ended)])
            self.ended = []
        team.start_interactions()
        if decide:
            team.release()
            freed = any(team.robots[index].mode == "free" for index in self.busy)
            if (freed or self.surprise) and not team.accepted:
                self._decide()
            self.busy = {index for index, robot in enumerate(team.robots) if robot.mode not in ("free", LOST)}
            self.surprise = False
        now = {name: self._told(robot) for name, robot in zip(self.names, team.robots, strict=True)}
        changed = [index for index, name in enumerate(self.names) if now[name] != self.told.get(name)]
        orders = []
        for index in changed:
            self.orders += 1
            if team.robots[index].mode != LOST:
                orders.append(self._order(index))
        self.told = now
        return [*orders, self.task_state()]

    def _decide(self) -> None:
        team = self.team
        problem = team.problem() if team.active else None
        if problem is None or not problem.deciders("all"):
            return
        seed = key_seed(self.setup.seed, self.setup.planner, self.decisions)
        plan = self.planner.plan(problem, seed)
        self.decisions += 1
        assignments = {
            index: assignment
            if assignment.container == WAIT or np.isfinite(problem.robots[index].travel_s[assignment.container])
            else Assignment(WAIT, assignment.interaction)
            for index, assignment in plan.assignments.items()
        }
        team.assign(assignments)
        team.start_interactions()
        team.release()

    def _told(self, robot: Robot) -> tuple[Any, ...]:
        action = _ACTIONS.get(robot.mode, LOST)
        version = self.map_version if action == "navigate" else 0
        target = robot.assignment.container if action == "navigate" else robot.place if action != "wait" else -1
        return (action, target, robot.obj if action == "interact" else -1, version)

    def _order(self, index: int) -> m.Order:
        robot = self.team.robots[index]
        action, target, obj, _ = self._told(robot)
        route: tuple[Point, ...] = ()
        length_m = 0.0
        if robot.mode == "move" and robot.route is not None:
            driven_m = (self.team.time_s - robot.moved_s) * self.setup.spec.speed_m_per_s
            route = robot.route.points_after(self.team.home_map, driven_m)
            length_m = max(robot.route.length_m - driven_m, 0.0)
        return m.Order(
            order=self.orders,
            robot=self.names[index],
            action=action,
            container=self.team.containers[target] if target >= 0 else None,
            object=self.setup.task.propositions[obj] if obj >= 0 else None,
            route=route,
            length_m=length_m,
        )

    def _number(self, name: str) -> int:
        if name not in self.names:
            raise Refused(f"no robot {name!r}; there are: {', '.join(self.names)}; robot_joined adds one")
        return self.names.index(name)

    def _robot(self, name: str) -> Robot:
        robot = self.team.robots[self._number(name)]
        if robot.mode == LOST:
            raise Refused(f"robot {name!r} is lost; robot_joined brings it back")
        return robot

    def _container(self, name: str) -> int:
        if name not in self.containers:
            raise Refused(f"no container {name!r}; there are: {', '.join(self.containers)}"[:400])
        return self.containers[name]

    def _position(self, x_m: float, y_m: float) -> Position:
        try:
            return Position.at(free_cell_near(self.team.home_map, (x_m, y_m), POSE_REACH_M))
        except InputError as error:
            raise Refused(str(error)) from None

    def _doing(self, robot: Robot) -> str:
        action, target, obj, _ = self._told(robot)
        at = f" {self.team.containers[target]}" if target >= 0 else ""
        return f"its order is {action}{at}" + (f" {self.setup.task.propositions[obj]}" if obj >= 0 else "")

    def _on_pose(self, event: m.Pose) -> str | None:
        robot, number = self._robot(event.robot), self._number(event.robot)
        if event.time_s < self.heard_s[number]:
            raise Refused(f"a later pose of {event.robot} is known, of {self.heard_s[number]:g} s")
        position = self._position(event.x_m, event.y_m)
        if robot.mode == "move" and not np.isfinite(
            position.distances_m(self.team.home_map)[robot.assignment.container]
        ):
            raise Refused(f"there is no way from there to {self.team.containers[robot.assignment.container]}")
        self.heard_s[number] = event.time_s
        self.team.is_at(robot, position)
        return None

    def _on_arrived(self, event: m.Arrived) -> str | None:
        robot, container = self._robot(event.robot), self._container(event.container)
        if robot.place == container:
            return "known already"
        if robot.mode != "move" or robot.assignment.container != container:
            raise Refused(f"{event.robot} is not on its way to {event.container}: {self._doing(robot)}")
        self.team.arrived(robot)
        return None

    def _on_navigation_failed(self, event: m.NavigationFailed) -> str | None:
        robot, container = self._robot(event.robot), self._container(event.container)
        if robot.mode != "move" or robot.assignment.container != container:
            raise Refused(f"{event.robot} is not on its way to {event.container}: {self._doing(robot)}")
        self.team.stop(robot)
        self.team.failed(container, -1)
        self.surprise = True
        return None

    def _on_search_ended(self, event: m.SearchEnded) -> str | None:
        robot = self.team.robots[self._number(event.robot)]
        container = self._container(event.container)
        arriving = robot.mode == "move" and robot.assignment.container == container
        searching = arriving or (robot.mode == "search" and robot.place == container)
        if event.status == "FAILED":
            if not searching:
                raise Refused(f"{event.robot} is not searching {event.container}: {self._doing(robot)}")
            if arriving:
                self.team.arrived(robot)
            if robot.mode == "search":
                self.team.search_ended(robot, None)
            self.surprise = True
            return None
        row = np.zeros(len(self.setup.task.propositions), dtype=bool)
        for name in (*event.objects, *(place for place in self.setup.task.places if place == event.container)):
            if (obj := self.objects.get(name_to_text(name))) is not None:
                row[obj] = True
        later = self.seen_s[container] > event.time_s
        if not searching and later.all():
            raise Refused(f"{event.container} was seen later, at {self.seen_s[container].min():g} s")
        row = np.where(later, self.team.presence_prob[container] > 0, row)
        self.seen_s[container, ~later] = event.time_s
        if arriving:
            self.team.arrived(robot)
        if not self.team.searched[container] or (row != (self.team.presence_prob[container] > 0)).any():
            self.team.learned(container, row)
            self.surprise |= not searching
        if robot.mode == "search" and robot.place == container:
            self.team.search_ended(robot, row)
        return None if searching else f"kept what was seen; {event.robot} was not searching there"

    def _on_object_seen(self, event: m.ObjectSeen) -> str | None:
        container = self._container(event.container)
        obj = self.objects.get(name_to_text(event.object))
        if obj is None:
            return "no object of the task"
        if event.time_s < self.seen_s[container, obj]:
            raise Refused(f"it was seen later whether {event.object} is there, at {self.seen_s[container, obj]:g} s")
        self.seen_s[container, obj] = event.time_s
        news = self.team.news
        self.team.news = False
        self.team.noticed(container, obj, event.present)
        self.surprise |= self.team.news
        self.team.news |= news
        return None

    def _on_interaction_ended(self, event: m.InteractionEnded) -> str | None:
        number = self._number(event.robot)
        robot, container = self.team.robots[number], self._container(event.container)
        obj = self.objects.get(name_to_text(event.object))
        if number in self.ended or robot.obj != obj or robot.place != container or robot.mode not in ("interact", LOST):
            raise Refused(f"{event.robot} was not to interact with {event.object}: {self._doing(robot)}")
        if event.status == "FINISHED":
            if robot.mode == LOST:
                self.team.interactions_ended([robot])
                robot.mode = LOST
                self.surprise = True
                return "done before the robot was lost"
            self.ended.append(number)
            return None
        if robot.mode == LOST:
            raise Refused(f"robot {event.robot!r} is lost")
        if event.gone:
            self.seen_s[container, obj] = max(event.time_s, self.seen_s[container, obj])
        self.team.interaction_failed(robot, event.gone)
        self.surprise = True
        return None

    def _on_robot_lost(self, event: m.RobotLost) -> str | None:
        robot, number = self._robot(event.robot), self._number(event.robot)
        if number in self.ended:
            self.ended.remove(number)
            self.team.interactions_ended([robot])
        self.team.lose(robot)
        self.surprise = True
        return None

    def _on_robot_joined(self, event: m.RobotJoined) -> str | None:
        position = self._position(event.x_m, event.y_m)
        if event.robot in self.names:
            number = self._number(event.robot)
            if self.team.robots[number].mode != LOST:
                raise Refused(f"robot {event.robot!r} is in the team already")
            self.team.join(position, self.team.robots[number])
        else:
            if len(self.names) >= MAX_ROBOTS:
                raise Refused(f"a team has at most {MAX_ROBOTS} robots")
            if self.setup.task.places:
                raise Refused("the task delivers something, which is for one robot")
            if not _ROBOT_NAME.fullmatch(event.robot):
                raise Refused("a robot's name has no control characters")
            self.names.append(event.robot)
            self.heard_s.append(0.0)
            self.team.join(position)
            number = len(self.names) - 1
        self.heard_s[number] = event.time_s
        self.surprise = True
        return None

    def _on_route_blocked(self, event: m.RouteBlocked) -> str | None:
        key, barrier = self._barrier(event)
        if key in self.barriers:
            return "known already"
        if len(self.barriers) >= MAX_BARRIERS:
            raise Refused(f"more than {MAX_BARRIERS} places are blocked; clear some")
        self.barriers[key] = barrier
        self._use_barriers()
        return None

    def _on_route_cleared(self, event: m.RouteCleared) -> str | None:
        key, _ = self._barrier(event)
        if key not in self.barriers:
            raise Refused("nothing was blocked there")
        del self.barriers[key]
        self._use_barriers()
        return None

    def _barrier(self, event: m.RouteBlocked | m.RouteCleared) -> tuple[str, Barrier]:
        if event.door is not None:
            doors = {door.id: door for door in self.setup.home.doors}
            if event.door not in doors:
                raise Refused(f"no door {event.door!r}; there are: {', '.join(doors) or 'none'}"[:400])
            door = doors[event.door]
            return f"door {event.door}", Barrier(door.start, door.end, self.setup.home_map.resolution_m * 2)
        place = (float(event.x_m or 0.0), float(event.y_m or 0.0))
        return f"place {place[0]:g} {place[1]:g}", Barrier(place, place, event.radius_m)

    def _use_barriers(self) -> None:
        """Ways by the map without what is blocked; robots under way go on by it from where they are."""
        home_map = barred_map(self.setup.home_map, list(self.barriers.values()))
        starts = {}
        for number, robot in enumerate(self.team.robots):
            if robot.mode == LOST:
                continue
            position = self.team.position_of(robot)
            if not (home_map.free[position.back] and home_map.free[position.ahead]):
                position = Position.at(free_cell_near(home_map, position.point(home_map), np.inf))
            starts[number] = position
        self.map_version += 1
        self.team.take_other_ways(home_map, starts)
        self.surprise = True
