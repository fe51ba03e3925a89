"""Compile planners' kernels before they are needed, each set of kernels in its own process, several at once.

The processes leave the kernels in numba's cache on disk, where every other process finds them. By itself, numba
compiles one function at a time.
"""

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from types import TracebackType

import numpy as np

from mrtask.planning.planners import make_planner
from mrtask.planning.problem import PlanningProblem, RobotKind, RobotStatus
from mrtask.sources import use_kernel_cache
from mrtask.tasks.automaton import build_automaton

Planners = Mapping[str, tuple[str, Mapping[str, object]]]
"""The name and the options of each planner, by its label."""
MARK = "compiled"
"""The file in the kernels' cache folder which says that planners were compiled there."""


def kernels_missing() -> bool:
    """Return whether no planner has been compiled with this code yet, for example on a new machine or after an edit."""
    return not (use_kernel_cache() / MARK).exists()


def mark_compiled() -> None:
    """Note, for `kernels_missing`, that a planner has been compiled with this code."""
    with suppress(OSError):  # numba cannot keep kernels there either
        (use_kernel_cache() / MARK).touch()


class Compilation:
    """Kernels that are being compiled. Leaving the context stops all unfinished compilations."""

    def __init__(self, planners: Planners) -> None:
        sharing: dict[str, dict[str, tuple[str, Mapping[str, object]]]] = {}
        for label, planner in planners.items():
            # Planners with the same `warm_up` share their kernels, so one process compiles them.
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
        """Yield each planner once its kernels are compiled, with the error message or an empty text."""
        for names in list(self._running):
            _, said = self._running[names].communicate()
            failed = self._running.pop(names).returncode != 0
            for name in names:
                yield name, said.strip().rpartition("\n")[2] if failed else ""


def compile_kernels(planners: Planners) -> None:
    """Compile in this process the kernels that the planners need."""
    for planner in planners.values():
        make_planner(*planner).warm_up(_problem())
    mark_compiled()


def _start(planners: Planners) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", __name__, json.dumps(planners)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def _problem() -> PlanningProblem:
    """Return a small problem. Kernels are the same for all problems."""
    automaton = build_automaton("F a & F b", ["a", "b"])
    kind = RobotKind(np.array([[0.0, 1.0], [1.0, 0.0]]))
    team = (RobotStatus(np.ones(2)), RobotStatus(np.ones(2)))
    return PlanningProblem(automaton, automaton.initial, np.full((2, 2), 0.5), np.zeros(2, dtype=bool), (kind,), team)


if __name__ == "__main__":
    compile_kernels(json.loads(sys.argv[1]))
