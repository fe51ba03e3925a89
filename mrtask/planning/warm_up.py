"""Compiles planners' kernels before they are needed: each set of kernels in a process of its own, several at once.

The processes leave them in numba's cache on disk, where every other process finds them. numba itself compiles one
function at a time.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType

import numpy as np

from mrtask.planning.planners import make_planner
from mrtask.planning.problem import PlanningProblem, RobotStatus
from mrtask.tasks.automaton import build_automaton

Planners = Mapping[str, tuple[str, Mapping[str, object]]]
"""The name and the options of planners, under what they are called here."""


def kernels_missing() -> bool:
    """Whether numba's cache folder has no planner's kernel yet: a new machine, or other code."""
    folder = os.environ.get("NUMBA_CACHE_DIR")
    return folder is not None and not any(Path(folder).glob("planning_*/*.nbi"))


class Compilation:
    """Kernels that are being compiled; those still under way when the context is left are given up."""

    def __init__(self, planners: Planners) -> None:
        sharing: dict[str, dict[str, tuple[str, Mapping[str, object]]]] = {}
        for label, planner in planners.items():
            # Who shares the warming up shares the kernels, and one process takes both.
            sharing.setdefault(type(make_planner(*planner)).warm_up.__module__, {})[label] = planner
        self._running = {tuple(group): _start(group) for group in sharing.values()}

    def __enter__(self) -> "Compilation":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._running.values():
            process.kill()
            process.communicate()

    def finished(self) -> Iterator[tuple[str, str]]:
        """Waits, and yields each planner as its kernels are there, with what went wrong or an empty text."""
        for names in list(self._running):
            _, said = self._running[names].communicate()
            failed = self._running.pop(names).returncode != 0
            for name in names:
                yield name, said.strip().rpartition("\n")[2] if failed else ""


def compile_kernels(planners: Planners) -> None:
    """Compiles in this process what the planners need."""
    for planner in planners.values():
        make_planner(*planner).warm_up(_problem())


def _start(planners: Planners) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", __name__, json.dumps(planners)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def _problem() -> PlanningProblem:
    """A small problem: kernels are the same for all."""
    automaton = build_automaton("F a & F b", ["a", "b"])
    travel_s = np.array([[0.0, 1.0], [1.0, 0.0]])
    team = (RobotStatus(np.ones(2)), RobotStatus(np.ones(2)))
    return PlanningProblem(automaton, automaton.initial, np.full((2, 2), 0.5), np.zeros(2, dtype=bool), travel_s, team)


if __name__ == "__main__":
    compile_kernels(json.loads(sys.argv[1]))
