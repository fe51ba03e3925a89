"""The paper's two myopic baselines (section V), which search the nearest or the likeliest containers first.

Both first send robots to containers known to hold an object that advances the task now, the nearest robot first. They
divide the other robots over unsearched containers with the least summed travel. The paper's team replans, so after the
team has learned something, robots under way are assigned again from where they are, by the same rule (``reassign``).

The rule for returning to a known container is ours. The authors' code returns only when everything found would complete
the task (``return_to_known``), which makes weaker baselines.
"""

from abc import ABC, abstractmethod

import numpy as np
from scipy.optimize import linear_sum_assignment

from mrtask.arrays import Bools, Floats
from mrtask.planning.problem import (
    ANY_SAFE,
    REASSIGN,
    WAIT,
    Assignment,
    Plan,
    PlanningProblem,
    check_choice,
    needed,
    safe,
)
from mrtask.tasks.automaton import NEVER_ACCEPTS

RETURN_TO_KNOWN = ("at_once", "when_complete")


class MyopicPlanner(ABC):
    """The part that both baselines share; a subclass chooses the unsearched containers that the robots divide.

    Args:
        reassign: one of `REASSIGN`.
        return_to_known: one of `RETURN_TO_KNOWN`. With ``when_complete``, robots return to searched containers only if
            all objects found so far would complete the task, and then no robot searches. With ``at_once``, they return
            at any time.

    Raises:
        ValueError: an option has a value that is not allowed.
    """

    knows_contents = False

    def __init__(self, reassign: str = "all", return_to_known: str = "at_once") -> None:
        check_choice("reassign", reassign, REASSIGN)
        check_choice("return_to_known", return_to_known, RETURN_TO_KNOWN)
        self._reassign, self._when_complete = reassign, return_to_known == "when_complete"

    def warm_up(self, problem: PlanningProblem) -> None:  # noqa: B027  (no subclass has anything to do here)
        """Do nothing: these planners compile no kernels."""

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """Plan as the module says. The rule draws no random numbers, so ``seed`` has no effect."""
        deciding = problem.deciders(self._reassign)
        if problem.automaton.accepting[problem.state]:
            return Plan({robot: Assignment(WAIT) for robot in deciding})
        complete = problem.automaton.steps_with(problem.found())[problem.state] < NEVER_ACCEPTS
        stay, finish = self._when_complete and not complete, self._when_complete and bool(complete)
        taken = _taken(problem, deciding)
        assignments: dict[int, Assignment] = {}
        for robot, assignment in _interactions(problem, deciding, only_here=stay, only_found=finish):
            if assignment.container not in taken:
                assignments[robot] = assignment
                taken.add(assignment.container)
        team = [robot for robot in deciding if robot not in assignments]
        if team and not finish:
            assignments |= self._searches(problem, team, taken)
        return Plan({robot: assignments.get(robot, Assignment(WAIT)) for robot in deciding})

    @abstractmethod
    def _shortlist(self, problem: PlanningProblem, open_to_search: Bools, robots: int) -> Bools:
        """Return the containers [C] that ``robots`` robots divide, out of those ``open_to_search`` [C]."""

    def _searches(self, problem: PlanningProblem, team: list[int], taken: set[int]) -> dict[int, Assignment]:
        """Divide the shortlist among the robots. Robots beyond its length get nothing.

        Robots that can get to different containers have a shortlist each, those with least choice first.
        """
        groups: dict[bytes, list[int]] = {}
        for index in team:
            groups.setdefault(np.isfinite(problem.robots[index].travel_s).tobytes(), []).append(index)
        chosen: dict[int, Assignment] = {}
        for within_reach in sorted(groups, key=lambda reach: reach.count(1)):
            group = groups[within_reach]
            travel_s = np.array([problem.robots[index].travel_s for index in group])
            open_to_search = ~problem.searched & np.isfinite(travel_s[0])
            open_to_search[[*taken, *(assignment.container for assignment in chosen.values())]] = False
            columns = np.flatnonzero(self._shortlist(problem, open_to_search, len(group)))
            pairs = zip(*linear_sum_assignment(travel_s[:, columns]), strict=True)
            chosen |= {group[row]: Assignment(int(columns[column])) for row, column in pairs}
        return chosen


class NonlearnedMyopic(MyopicPlanner):
    """Search the nearest containers first, whatever they may hold."""

    def _shortlist(self, problem: PlanningProblem, open_to_search: Bools, robots: int) -> Bools:
        return open_to_search


class LearnedMyopic(MyopicPlanner):
    """Search the containers with the highest summed likelihood of objects that are still needed and not yet found."""

    def _shortlist(self, problem: PlanningProblem, open_to_search: Bools, robots: int) -> Bools:
        wanted = needed(problem.automaton)[problem.state] & ~problem.found()
        score: Floats = np.where(open_to_search, problem.presence_prob @ wanted.astype(float), -np.inf)
        chosen = np.zeros_like(open_to_search)
        chosen[np.argsort(-score, kind="stable")[:robots]] = True
        return chosen & open_to_search


def _taken(problem: PlanningProblem, deciding: list[int]) -> set[int]:
    """Return the containers that robots which keep their action are under way to or searching."""
    kept = [robot for index, robot in enumerate(problem.robots) if index not in deciding]
    return {robot.target if robot.target >= 0 else robot.place for robot in kept if robot.interacting < 0}


def _interactions(
    problem: PlanningProblem, deciding: list[int], *, only_here: bool, only_found: bool
) -> list[tuple[int, Assignment]]:
    """Pair robots with containers known to hold an object that advances the task now: nearest first, each robot once.

    An interaction that can hurt is requested only if it brings acceptance nearer, counted in interactions with objects
    that are found or may still be found, and only while no other one is under way: of two, each could undo the other.

    Args:
        only_here: match a robot only with the container where it stands.
        only_found: count only the objects found, because no more containers will be searched.
    """
    automaton, state = problem.automaton, problem.state
    travel_s = np.array([robot.travel_s for robot in problem.robots])
    more_to_find = not only_found and (~problem.searched & np.isfinite(travel_s).any(axis=0)).any()
    steps = automaton.steps_with(problem.found() | more_to_find)
    nearer = steps[automaton.transitions[state]] < steps[state]
    can_hurt = automaton.advancing[state] & ~safe(automaton)[state]
    useful = automaton.advancing[state] & (~can_hurt | nearer)
    kept = [robot for index, robot in enumerate(problem.robots) if index not in deciding]
    fetched = {robot.interacting for robot in kept} | {robot.interaction for robot in kept if robot.target >= 0}
    fetched.discard(ANY_SAFE)
    pairs = sorted(
        (float(travel_s[robot, container]), robot, int(container), int(obj))
        for obj in np.flatnonzero(useful)
        for container in np.flatnonzero(problem.searched & (problem.presence_prob[:, obj] > 0))
        for robot in deciding
        if np.isfinite(travel_s[robot, container]) and (not only_here or problem.robots[robot].place == container)
    )
    chosen: dict[int, Assignment] = {}
    for _, robot, container, obj in pairs:
        alone = not fetched or not can_hurt[[obj, *fetched]].any()
        if robot not in chosen and obj not in fetched and alone:
            fetched.add(obj)
            chosen[robot] = Assignment(container, obj)
    return list(chosen.items())
