"""A team's simulated world: the truth, revealed container by container, and a clock.

`TeamState` keeps what the team knows and does, as with real robots; here the robots arrive, search and interact exactly
when expected. All events of one instant are settled before the planner is asked for a decision; interactions that end
at the same instant spell letters in the order that serves the task.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mrtask.execution.acts import ActKind
from mrtask.execution.belief import prior_belief
from mrtask.execution.motion import Position
from mrtask.execution.sensor import Sensor
from mrtask.execution.team_maps import MakeMap, in_reach, maps_for, start_cells
from mrtask.execution.team_spec import Team
from mrtask.execution.team_state import TeamState
from mrtask.execution.trace import Trace
from mrtask.execution.trials import key_seed
from mrtask.homes.home import Home
from mrtask.maps.home_map import HomeMap
from mrtask.planning.problem import SAME_INSTANT_S, Assignment, PlanningProblem
from mrtask.tasks.automaton import Automaton


class Simulation:
    """One episode's world. The loop is `problem`, then `assign`, then `advance`, until `accepted`.

    Args:
        truth: [C, O] whether the container holds the task object.
        likelihood: [C, O] the prior that planners see.
        start_cell: where robots start that have no start of their own.
        make_map: as `maps_for` takes it.
        known: whether the team knows the truth from the start, so that no container needs a search.
        known_containers: containers that need no search in any case.
        seed: decides what searches detect where they can err.
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
        make_map: MakeMap | None = None,
        known: bool = False,
        known_containers: Sequence[int] = (),
        seed: int = 0,
    ) -> None:
        self.truth, self._seed = truth, seed
        maps = self.maps = maps_for(team, home, home_map, make_map)
        self.in_reach = in_reach(team, home, maps)
        """[C] whether some robot can get to the container and use it."""
        seen = {*known_containers, *(np.flatnonzero(self.in_reach).tolist() if known else ())}
        sensor = Sensor.of(team.perception, automaton.propositions)
        known_rows = {container: truth[container] for container in sorted(seen)}
        self.team = TeamState(
            home.containers,
            maps,
            automaton,
            prior_belief(likelihood, self.in_reach, sensor, known_rows),
            specs=team.members,
            starts=[Position.at(cell) for cell in start_cells(team, maps, start_cell)],
        )
        self._decide_again = False

    @property
    def time_s(self) -> float:
        """The present instant."""
        return self.team.time_s

    @property
    def accepted(self) -> bool:
        """Whether the task is done."""
        return self.team.accepted

    @property
    def news(self) -> bool:
        """Whether anything was learned or done since the last decision."""
        return self.team.news

    @property
    def searched(self) -> NDArray[np.bool_]:
        """[C] whether the container's contents are known."""
        return self.team.belief.searched

    def problem(self) -> PlanningProblem:
        """Return what a planner may know now."""
        return self.team.problem()

    def assign(self, assignments: Mapping[int, Assignment]) -> None:
        """Give robots new assignments; robots under way take them only where the problem said so.

        Raises:
            ValueError: where `TeamState.assign` does.
        """
        self.team.assign(assignments)
        letters = len(self.team.letters)
        failed = self._settle()
        self._decide_again = failed or len(self.team.letters) > letters

    def advance(self) -> bool:
        """Let time run until the task is done or a robot is free. Return False if no robot does anything any more."""
        if self._decide_again:  # an assignment was completed on the spot
            return True
        while not self.accepted:
            until_s = min(robot.act.until_s for robot in self.team.robots)
            if until_s == float("inf"):
                return False
            self.team.time_s = until_s
            freed = self._process_instant()
            if freed:
                return True
        return True

    def trace(self) -> Trace:
        """Return the record so far. Acts under way are cut off at the present instant."""
        return self.team.trace()

    def missing(self) -> list[str]:
        """Return the task objects that advance the task now but were found in no container that can be reached."""
        return self.team.missing()

    def _process_instant(self) -> bool:
        """Settle everything that is due now, and return whether a robot is free afterwards."""
        acted = [robot for robot in self.team.robots if robot.act.until_s <= self.time_s + SAME_INSTANT_S]
        for robot in acted:
            if robot.moving:
                self.team.arrived(robot)
        for robot in acted:
            if robot.act.kind is ActKind.SEARCH and robot.act.until_s <= self.time_s + SAME_INSTANT_S:
                self.team.search_ended(robot, self.detected(robot.place))
        self._settle()
        return any(robot.free for robot in acted)

    def detected(self, container: int) -> NDArray[np.bool_]:
        """Return [O] what the next search of the container detects, whichever robot searches, and whenever."""
        belief = self.team.belief
        search = int(belief.searches[container])
        return belief.sensor.detect(self.truth[container], key_seed(self._seed, "search", container, search))

    def _settle(self) -> bool:
        """Start and complete interactions until nothing more happens at this instant, then free the other robots.

        Return whether an interaction failed because the object is not there.
        """
        failed = False
        while not self.accepted:
            due_s = self.time_s + SAME_INSTANT_S
            acting = [robot for robot in self.team.robots if robot.act.kind is ActKind.INTERACT]
            due = [robot for robot in acting if robot.act.until_s <= due_s]
            in_vain = [robot for robot in due if not self.truth[robot.place, robot.act.obj]]
            if done := [robot for robot in due if self.truth[robot.place, robot.act.obj]]:
                self.team.interactions_ended(done)
            for robot in in_vain:
                self.team.interaction_failed(robot, gone=True)
                failed = True
            if not self.team.start_interactions():
                break
        self.team.release()
        return failed
