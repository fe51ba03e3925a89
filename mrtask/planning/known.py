"""The planner `known`, which knows where everything is: the reference that shows what uncertainty costs.

Where that is small and `mrtask.planning.clairvoyant` is exact, it follows a fastest run. Elsewhere it searches like
`pouct`, and is then no bound.
"""

from time import perf_counter

import numpy as np

from mrtask.planning.clairvoyant import Letter, Run, TooManyStatesError, fastest_run
from mrtask.planning.pouct import Pouct
from mrtask.planning.problem import WAIT, Assignment, Plan, PlanInfo, PlanningProblem
from mrtask.planning.solver_belief import belief_of

MAX_STATES = 20_000
"""A problem with more states on the way to its optimum is not small."""


class Known(Pouct):
    """Follow a fastest run, or search where there is no exact one. See the module."""

    knows_contents = True

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """Plan as the module says. A plan that needed no search has no samples."""
        began_s = perf_counter()
        deciding = problem.deciders(self.reassign)
        run = _exact_run(problem, deciding)
        if run is None:
            return super().plan(problem, seed)
        assignments = _first_assignments(problem, deciding, run)
        return Plan(assignments, PlanInfo(planning_s=perf_counter() - began_s, value_s=run.makespan_s))


def _exact_run(problem: PlanningProblem, deciding: list[int]) -> Run | None:
    """Return a fastest run of the team, or None if it cannot be computed exactly."""
    timeless = problem.search_time_s == problem.interact_time_s == 0
    busy = any(not robot.free and robot.target < 0 for robot in problem.robots)
    contents = problem.presence_prob
    if not (timeless or len(problem.robots) == 1) or busy or not np.isin(contents, (0.0, 1.0)).all():
        return None
    if problem.automaton.accepting[problem.state]:
        return None
    belief = belief_of(problem)
    for index in set(range(len(problem.robots))) - set(deciding):
        robot = problem.robots[index]
        belief.start_s[index] = robot.remaining_s + belief.travel_s[robot.target]
    try:
        run = fastest_run(belief, contents > 0, max_states=MAX_STATES)
    except TooManyStatesError:
        return None
    return run if np.isfinite(run.makespan_s) else None


def _word(last: Letter | None) -> list[Letter]:
    """Return the letters of a run in their order."""
    word: list[Letter] = []
    while last is not None:
        word.append(last)
        last = last.before
    return word[::-1]


def _first_assignments(problem: PlanningProblem, deciding: list[int], run: Run) -> dict[int, Assignment]:
    """Send each robot to its first letter.

    Only the first letter of the word may be made at once, whatever it changes. A robot that stands at its letter's
    place before its turn waits there.
    """
    assignments: dict[int, Assignment] = {}
    word = _word(run.last)
    for letter in word:
        starting = (robot for robot in deciding if robot not in assignments and run.rows[robot] == letter.row)
        robot = next(starting, None)
        if robot is None:
            continue
        stands_there = problem.robots[robot].place == letter.container and problem.searched[letter.container]
        if letter is word[0]:
            assignments[robot] = Assignment(letter.container, letter.obj)
        else:
            assignments[robot] = Assignment(WAIT if stands_there else letter.container)
    return {robot: assignments.get(robot, Assignment(WAIT)) for robot in deciding}
