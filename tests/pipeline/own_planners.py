"""Planners of a user's own, as tests give them by import path: slow, faulty, hanging."""

import os
import signal
import time
from pathlib import Path

from mrtask.planning.myopic import nonlearned_myopic
from mrtask.planning.problem import Assignment, Plan, PlanningProblem


class Slow:
    """The non-learned baseline with a pause before each plan."""

    def __init__(self, pause_s: float = 0.0) -> None:
        self._pause_s = pause_s
        self._rule = nonlearned_myopic()

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """The baseline's plan, later."""
        time.sleep(self._pause_s)
        return self._rule.plan(problem, seed)


class Faulty(Slow):
    """Raises in every episode with two robots."""

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """The baseline's plan, for one robot."""
        if len(problem.robots) == 2:
            raise RuntimeError("this planner has a bug")
        return super().plan(problem, seed)


class Hanging(Slow):
    """Never answers a team of two."""

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """The baseline's plan, for one robot."""
        if len(problem.robots) == 2:
            time.sleep(600)
        return super().plan(problem, seed)


class Deadly(Slow):
    """Kills its worker the first time that it plans at all; ``marker`` remembers."""

    def __init__(self, marker: str) -> None:
        super().__init__()
        self._marker = Path(marker)

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """The baseline's plan, by a worker that was not killed."""
        if not self._marker.exists():
            self._marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().plan(problem, seed)


class Pacing:
    """Sends every robot to and fro between the first two containers."""

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """The other one of the two."""
        free = [index for index, robot in enumerate(problem.robots) if robot.free]
        return Plan({index: Assignment(1 if problem.robots[index].place == 0 else 0) for index in free})
