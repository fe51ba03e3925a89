"""Planners of a user's own, as tests give them by import path: stopped in the middle, faulty, hanging."""

import os
import signal
import time
from pathlib import Path

from mrtask.planning.myopic import NonlearnedMyopic
from mrtask.planning.problem import Assignment, Plan, PlanningProblem

PACE_S = 0.3
"""Of episodes at a shut gate: in long batches, finished ones would wait for those that are shut out."""


class Baseline:
    """The non-learned baseline under another name."""

    def __init__(self) -> None:
        self._rule = NonlearnedMyopic()

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """The baseline's plan."""
        return self._rule.plan(problem, seed)


class Gate:
    """What episodes of `Gated` wait at, so that a test finds a run in the middle however fast the machine is."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(exist_ok=True)

    def shut_after(self, episodes: int) -> None:
        """Let this many more pass from now on."""
        (self.folder / "come").write_bytes(b"")
        (self.folder / "passing").write_text(str(episodes))

    def open(self) -> None:
        """All may pass."""
        (self.folder / "passing").unlink(missing_ok=True)


class Gated(Baseline):
    """Waits at a `Gate` before the first plan of each episode."""

    def __init__(self, gate: str) -> None:
        super().__init__()
        self._gate = Path(gate)
        self._passed = False

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """The baseline's plan, when the gate lets it pass."""
        if not self._passed:
            self._passed = True
            if (self._gate / "passing").exists():
                time.sleep(PACE_S)
            with (self._gate / "come").open("a") as file:
                file.write("x")
                number = file.tell()
            while (passing := self._passing()) is not None and number > passing:
                time.sleep(0.02)
        return super().plan(problem, seed)

    def _passing(self) -> int | None:
        try:
            return int((self._gate / "passing").read_text() or 0)
        except FileNotFoundError:
            return None


class Faulty(Baseline):
    """Raises in every episode with two robots."""

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """The baseline's plan, for one robot."""
        if len(problem.robots) == 2:
            raise RuntimeError("this planner has a bug")
        return super().plan(problem, seed)


class Hanging(Baseline):
    """Never answers a team of two."""

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        """The baseline's plan, for one robot."""
        if len(problem.robots) == 2:
            time.sleep(600)
        return super().plan(problem, seed)


class Deadly(Baseline):
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
