"""The two myopic baselines of the paper (section V): nearest, or likeliest, containers first.

Both first send robots to containers known to hold an object that advances the task now, the nearest robot first, and
split the others over unsearched containers with the least summed travel.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import linear_sum_assignment

from mrtask.planning.problem import (
    WAIT,
    Assignment,
    BoolArray,
    FloatArray,
    Plan,
    PlanningProblem,
    needed,
    safe,
)

Shortlist = Callable[[PlanningProblem, BoolArray, int], BoolArray]
"""From a problem, the [C] containers open to search and the number of free robots: the [C] containers to divide."""


class MyopicPlanner:
    """A rule of the paper: ``shortlist`` says which unsearched containers the free robots divide among them."""

    knows_contents = False

    def __init__(self, shortlist: Shortlist) -> None:
        self._shortlist = shortlist

    def warm_up(self, problem: PlanningProblem) -> None:
        """Nothing is compiled."""

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """See the module; the rule draws nothing, so ``seed`` does not matter."""
        assignments: dict[int, Assignment] = {}
        free = {index for index, robot in enumerate(problem.robots) if robot.free}
        if problem.automaton.accepting[problem.state]:
            return Plan({robot: Assignment(WAIT) for robot in sorted(free)})
        targeted = {robot.target for robot in problem.robots if robot.target >= 0}
        for robot, assignment in _interactions(problem, free):
            if assignment.container not in targeted:
                assignments[robot] = assignment
                targeted.add(assignment.container)
                free.discard(robot)
        unsearched = ~problem.searched
        unsearched[list(targeted)] = False
        team = sorted(free)
        if team:
            travel_s = np.array([problem.robots[index].travel_s for index in team])
            unsearched &= np.isfinite(travel_s).all(axis=0)
            columns = np.flatnonzero(self._shortlist(problem, unsearched, len(team)))
            for row, column in zip(*linear_sum_assignment(travel_s[:, columns]), strict=True):
                assignments[team[row]] = Assignment(int(columns[column]))
        for robot in free - assignments.keys():
            assignments[robot] = Assignment(WAIT)
        return Plan(assignments)


def nonlearned_myopic() -> MyopicPlanner:
    """The nearest unsearched containers, whatever they may hold."""
    return MyopicPlanner(lambda problem, unsearched, robots: unsearched)


def learned_myopic() -> MyopicPlanner:
    """The unsearched containers with the highest summed likelihood of the objects still needed and not yet found."""
    return MyopicPlanner(_likeliest)


def _likeliest(problem: PlanningProblem, unsearched: BoolArray, robots: int) -> BoolArray:
    wanted = needed(problem.automaton)[problem.state] & ~problem.found()
    score: FloatArray = np.where(unsearched, problem.presence_prob @ wanted.astype(float), -np.inf)
    chosen = np.zeros_like(unsearched)
    chosen[np.argsort(-score, kind="stable")[:robots]] = True
    return chosen & unsearched


def _interactions(problem: PlanningProblem, free: set[int]) -> list[tuple[int, Assignment]]:
    """Free robots with a container known to hold an object that advances the task now, nearest first; all pairs.

    An interaction that can hurt is asked for by name, and only where it brings acceptance nearer.
    """
    automaton, state = problem.automaton, problem.state
    after = automaton.steps_to_accept[automaton.transitions[state]]
    harmless = safe(automaton)[state]
    useful = automaton.advancing[state] & (harmless | (after < automaton.steps_to_accept[state]))
    pairs: list[tuple[float, int, int, int]] = []
    for obj in np.flatnonzero(useful):
        if any(robot.interacting == obj for robot in problem.robots):
            continue
        for container in np.flatnonzero(problem.searched & (problem.presence_prob[:, obj] > 0)):
            pairs += [(float(problem.robots[r].travel_s[container]), r, int(container), int(obj)) for r in sorted(free)]
    taken: set[int] = set()
    objects = {robot.interaction for robot in problem.robots if robot.target >= 0}
    chosen: list[tuple[int, Assignment]] = []
    for travel_s, index, place, wanted in sorted(pairs):
        if index not in taken and wanted not in objects and np.isfinite(travel_s):
            taken.add(index)
            objects.add(wanted)
            chosen.append((index, Assignment(place, wanted)))
    return chosen
