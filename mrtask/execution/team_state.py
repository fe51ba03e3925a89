"""What a team knows, where its robots are and what they do: the same logic for simulated and real episodes.

A `TeamState` learns what happened (arrived, searched, interacted, seen, lost, blocked) and keeps belief, automaton and
robots in step with it. Between events it assumes that robots do as expected, at their speed. It knows neither the truth
nor a clock: a simulation or a lab's robots are its world. It works as planners assume: a robot under way arrives,
searches a container that no robot has searched, interacts if its assignment and the task allow it, and is free. `Robot`
knows how a robot moves.

Legend for array shapes: R robots, C containers, O task objects.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mrtask.execution.acts import ActKind
from mrtask.execution.belief import Belief, Seen
from mrtask.execution.letters import serving_order
from mrtask.execution.motion import Position
from mrtask.execution.robot import Labels, Robot
from mrtask.execution.setbacks import NAVIGATE, SEARCH
from mrtask.execution.team_maps import Maps
from mrtask.execution.team_spec import RobotSpec
from mrtask.execution.trace import Letter, Trace
from mrtask.homes.home import Container
from mrtask.maps.home_map import HomeMap
from mrtask.planning.problem import ANY_SAFE, WAIT, Assignment, PlanningProblem, RobotKind, safe
from mrtask.tasks.automaton import Automaton


class TeamState:
    """The belief, the task's state and the robots.

    Decisions are `problem`, a planner's plan, and `assign`. The other methods say what happened, all at ``time_s``,
    which the caller advances. `start_interactions` and `release` follow the events of one instant.

    Args:
        maps: the home's map, and those for robots of another width.
        belief: from `prior_belief`; it is changed.
        specs: [R] the robots, at ``starts`` [R].
        one_per_letter: whether a robot interacts only where that still advances the task after what others are doing.
            Simulated robots do not know that, so two may interact where one letter is wanted.
    """

    def __init__(
        self,
        containers: Sequence[Container],
        maps: Maps,
        automaton: Automaton,
        belief: Belief,
        *,
        specs: Sequence[RobotSpec],
        starts: Sequence[Position],
        one_per_letter: bool = False,
    ) -> None:
        self.automaton, self.belief = automaton, belief
        self.furniture = tuple(containers)
        self.labels = Labels(tuple(container.id for container in containers), automaton.propositions)
        self.time_s = 0.0
        self.robots: list[Robot] = []
        self.use_maps(maps)
        self.robots += [self.new_robot(start, spec) for start, spec in zip(starts, specs, strict=True)]
        self._safe, self.one_per_letter = safe(automaton), one_per_letter
        self.state = automaton.initial
        self.start = starts[0].point(self.home_map)
        self.letters: list[Letter] = []
        self.news = False
        """Whether anything was learned or done since the last decision."""

    @property
    def containers(self) -> tuple[str, ...]:
        """[C] the containers' names."""
        return self.labels.containers

    @property
    def accepted(self) -> bool:
        """Whether the task is done."""
        return bool(self.automaton.accepting[self.state])

    @property
    def active(self) -> list[int]:
        """The robots that are not lost, in the problem's order."""
        return [index for index, robot in enumerate(self.robots) if not robot.lost]

    def problem(self) -> PlanningProblem:
        """Return what a planner may know now, of the `active` robots. What none of them can get to holds nothing."""
        active = [self.robots[index] for index in self.active]
        kinds = list(dict.fromkeys(robot.spec.kind for robot in active))
        robots = tuple(replace(robot.status(self.time_s), kind=kinds.index(robot.spec.kind)) for robot in active)
        reach = _finite([robot.travel_s for robot in robots], len(self.containers))
        return PlanningProblem(
            automaton=self.automaton,
            state=self.state,
            presence_prob=np.where(reach[:, None], self.belief.presence_prob, 0.0),
            searched=self.belief.searched.copy(),
            kinds=tuple(self._kind(kind) for kind in kinds),
            robots=robots,
            may_redirect=self.news,
        )

    def assign(self, assignments: Mapping[int, Assignment]) -> None:
        """Give robots of the problem new assignments; robots under way take them only where the problem said so.

        Raises:
            ValueError: a free robot without assignment, a busy robot with one, a robot under way redirected although
                nothing was learned, or an unreachable container.
        """
        active = self.active
        for index, number in enumerate(active):
            if self.robots[number].free and index not in assignments:
                raise ValueError(f"the planner left free robot {index} without an assignment; `WAIT` is one")
        for index, assignment in assignments.items():
            robot = self.robots[active[index]]
            if not robot.free and not (self.news and robot.moving):
                raise ValueError(f"robot {index} is busy ({robot.act.kind}) and cannot take {assignment}")
            if robot.moving and assignment.container == robot.assignment.container:
                robot.assignment = assignment
                continue
            robot.set_out(assignment, self.time_s)
            if robot.place == assignment.container != WAIT:
                self.arrived(robot)
        self.news = False

    def arrived(self, robot: Robot) -> None:
        """Take in that the robot is at its assignment's container, whether expected there now or not."""
        self.can_be_done(robot.assignment.container, NAVIGATE)
        robot.arrive(self.time_s, search=not self.belief.searched[robot.assignment.container])

    def search_ended(self, robot: Robot, seen: Seen | None, fresh: NDArray[np.bool_] | None = None) -> None:
        """Take in that the robot's search is over.

        ``seen`` and ``fresh`` are as in `Belief.learned`; None means that it could not search.
        """
        if seen is None:
            self.failed(robot, robot.place, SEARCH)
        else:
            self.learned(robot.place, seen, fresh)
        robot.end_search(self.time_s)

    def learned(self, container: int, seen: Seen, fresh: NDArray[np.bool_] | None = None) -> bool:
        """Take in that a search of the container ended, whichever robot searched. Return whether that is news.

        See `Belief.learned`.
        """
        self.can_be_done(container, NAVIGATE)
        self.can_be_done(container, SEARCH)
        return self._noted(self.belief.learned(container, seen, fresh))

    def glimpsed(self, container: int, obj: int, seen: float) -> bool:
        """Take in that one object was seen in passing; see `Belief.glimpsed`. Return whether that is news."""
        return self._noted(self.belief.glimpsed(container, obj, seen))

    def failed(self, robot: Robot, container: int, what: int) -> None:
        """Take in that the robot could not get to the container, search it or interact there; see `Setbacks`."""
        robot.setbacks.add(container, what, self.time_s)
        self.news = True

    def can_be_done(self, container: int | None = None, what: int | None = None) -> None:
        """Take in that what robots may have failed at is possible; see `Setbacks.forgive`."""
        for robot in self.robots:
            robot.setbacks.forgive(container, what)

    def interactions_ended(self, due: Sequence[Robot]) -> None:
        """Take in the interactions that were completed in this instant.

        Those that advance the task are letters of its word.
        """
        objects = frozenset(robot.act.obj for robot in due)
        for obj in serving_order(self.automaton, self.state, objects):
            robot = next(robot for robot in due if robot.act.obj == obj)
            self.state = int(self.automaton.transitions[self.state, obj])
            self.news = True
            self.can_be_done(robot.place, obj)
            number = next(index for index, one in enumerate(self.robots) if one is robot)
            self.letters.append(
                Letter(self.time_s, number, self.labels.objects[obj], self.labels.containers[robot.place])
            )
        for robot in due:
            robot.end_interaction(self.time_s)

    def interaction_failed(self, robot: Robot, gone: bool) -> None:
        """Take in that the robot could not interact; ``gone`` says that the object is not there."""
        if gone:
            self._noted(self.belief.ruled_out(robot.place, robot.act.obj))
        else:
            self.failed(robot, robot.place, robot.act.obj)
        robot.end_interaction(self.time_s)
        robot.release()

    def start_interactions(self) -> bool:
        """Let standing robots begin what their assignments allow. Return whether any did."""
        if self.accepted:
            return False
        kinds = (ActKind.FREE, ActKind.SETTLING)
        standing = [robot for robot in self.robots if robot.act.kind in kinds and robot.place >= 0]
        return bool([robot for robot in standing if self._try_interaction(robot)])

    def withdraw_interactions(self) -> list[Robot]:
        """Free the robots whose interactions would not advance the task any more, and return them.

        This happens only with ``one_per_letter``.
        """
        if not self.one_per_letter:
            return []
        acting = [robot for robot in self.robots if robot.act.kind is ActKind.INTERACT]
        order = serving_order(self.automaton, self.state, frozenset(robot.act.obj for robot in acting))
        first = [next(robot for robot in acting if robot.act.obj == obj) for obj in order]
        after = int(self.automaton.run((self.labels.objects[obj] for obj in order), self.state))
        withdrawn = [
            robot
            for robot in acting
            if not any(robot is one for one in first) and not self.automaton.advancing[after, robot.act.obj]
        ]
        for robot in withdrawn:
            robot.give_up(self.time_s)
        return withdrawn

    def release(self) -> None:
        """End the instant.

        Robots with nothing left to do are free, and what may have been missed is open again.
        """
        if not self.accepted:
            self.belief.look_again(self._lacking(), self._within_reach())
        for robot in self.robots:
            if robot.act.kind is ActKind.SETTLING:
                robot.release()

    def lose(self, robot: Robot) -> None:
        """Take the robot out of the team; others may take over its assignment."""
        robot.lose(self.time_s)
        self.news = True

    def join(self, position: Position, robot: Robot) -> Robot:
        """Let a `new_robot`, or a lost one, take part from now on, free at this position."""
        if not any(robot is one for one in self.robots):
            self.robots.append(robot)
        robot.join(position, self.time_s)
        self.news = True
        return robot

    def new_robot(self, position: Position, spec: RobotSpec) -> Robot:
        """Return a robot at this position, which is not in the team yet."""
        usable, touches = spec.can_use(self.furniture), spec.can_touch(self.labels.objects)
        return Robot(position, spec, usable, touches, self.maps[spec.radius_m], self.labels, since_s=self.time_s)

    @property
    def home_map(self) -> HomeMap:
        """The home's own map."""
        return self.maps[None]

    def use_maps(self, maps: Maps) -> None:
        """Use the ways and travel times of these maps, which have the same containers."""
        self.maps = maps
        self._kinds: dict[RobotSpec, RobotKind] = {}
        for robot in self.robots:
            robot.home_map = maps[robot.spec.radius_m]

    def take_other_ways(self, maps: Maps, own: Mapping[int, HomeMap]) -> None:
        """Take in that the ways changed under the team.

        The robots in ``own`` (number -> the map for where the robot is) continue from where they are. A robot under way
        that can no longer get to its container is free.
        """
        self.use_maps(maps)
        self.news = True
        for number, own_map in own.items():
            self.take_own_map(self.robots[number], own_map)

    def take_own_map(self, robot: Robot, home_map: HomeMap) -> None:
        """Let a robot continue from where it is by this map."""
        robot.home_map = home_map
        robot.go_on(robot.position_at(self.time_s), self.time_s)

    def missing(self) -> list[str]:
        """Return the objects that advance the task now and were found nowhere a robot can get to and touch them."""
        return [self.labels.objects[obj] for obj in np.flatnonzero(self._lacking())]

    def useful(self) -> NDArray[np.bool_]:
        """Return the containers [C] at which robots that can get there could do something, failed there or not."""
        robots = [self.robots[index] for index in self.active]
        ways_s = [robot.travel_s(self.time_s) for robot in robots]
        touchable = self._touchable(robots, ways_s)
        advancing = self.automaton.advancing[self.state]
        wanted = ((self.belief.presence_prob > 0) & touchable)[:, advancing].any(axis=1)
        missing = bool((advancing & ~self.belief.found(touchable)).any())
        reach = _finite(ways_s, len(self.containers))
        return np.asarray(reach & np.where(self.belief.searched, wanted, missing))

    def trace(self) -> Trace:
        """Return the record so far. Acts under way are cut off at the present instant."""
        return Trace(self.start, tuple(robot.legs_until(self.time_s) for robot in self.robots), tuple(self.letters))

    def _lacking(self) -> NDArray[np.bool_]:
        """Return the objects [O] that `missing` names."""
        robots = [self.robots[index] for index in self.active]
        touchable = self._touchable(robots, [robot.options_s(self.time_s) for robot in robots])
        return np.asarray(self.automaton.advancing[self.state] & ~self.belief.found(touchable))

    def _kind(self, kind: RobotSpec) -> RobotKind:
        """Return the ways, times and abilities of a kind of robots."""
        if kind not in self._kinds:
            usable = kind.can_use(self.furniture)
            travel_s = self.maps[kind.radius_m].travel_m / kind.speed_m_per_s
            self._kinds[kind] = RobotKind(
                travel_s=np.where(usable & usable[:, None], travel_s, np.inf),
                search_time_s=kind.search_time_s,
                interact_time_s=kind.interact_time_s,
                handles=None if kind.handles is None else kind.can_touch(self.labels.objects),
            )
        return self._kinds[kind]

    def _touchable(self, robots: Sequence[Robot], ways_s: Sequence[NDArray[np.float64]]) -> NDArray[np.bool_]:
        """Return [C, O] whether a robot can get to the container and touch the object; ways_s [R, C] are its ways."""
        touchable = np.zeros(self.belief.presence_prob.shape, dtype=bool)
        for robot, way_s in zip(robots, ways_s, strict=True):
            touchable |= np.isfinite(way_s)[:, None] & robot.touches
        return touchable

    def _within_reach(self) -> NDArray[np.bool_]:
        """Return the containers [C] to which some robot can be sent now."""
        ways_s = [self.robots[index].options_s(self.time_s) for index in self.active]
        return _finite(ways_s, len(self.containers))

    def _noted(self, news: bool) -> bool:
        self.news |= news
        return news

    def _try_interaction(self, robot: Robot) -> bool:
        """Start the interaction that the robot's assignment allows at its place now, if any."""
        choices = np.flatnonzero(self._allowed(robot))
        if not len(choices):
            return False
        after = self.automaton.steps_to_accept[self.automaton.transitions[self.state, choices]]
        robot.begin(ActKind.INTERACT, self.time_s, int(choices[int(np.argmin(after))]))
        return True

    def _allowed(self, robot: Robot) -> NDArray[np.bool_]:
        """Return the objects [O] with which the robot may interact here now: the one it was sent for, or safe ones."""
        wanted, here = robot.assignment.interaction, self.belief.presence_prob[robot.place] > 0
        here &= robot.touches
        here[robot.setbacks.objects_left_alone(robot.place, self.time_s)] = False
        if self.one_per_letter:
            doing = frozenset(one.act.obj for one in self.robots if one.act.kind is ActKind.INTERACT)
            order = serving_order(self.automaton, self.state, doing)
            here &= self.automaton.advancing[self.automaton.run((self.labels.objects[o] for o in order), self.state)]
        if not self.belief.searched[robot.place]:
            return np.zeros_like(here)
        if wanted == ANY_SAFE:
            return np.asarray(self._safe[self.state] & here)
        named = np.arange(len(here)) == wanted
        sent = robot.act.kind is ActKind.SETTLING
        return np.asarray(self.automaton.advancing[self.state] & here & named & sent)


def _finite(ways_s: Sequence[NDArray[np.float64]], containers: int) -> NDArray[np.bool_]:
    """Return the containers [C] to which some of the robots' ways [C] are finite."""
    return np.asarray(np.isfinite(np.reshape(ways_s, (-1, containers))).any(axis=0))
