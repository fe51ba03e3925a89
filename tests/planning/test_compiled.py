"""Kernels: named tuples by reference, and a cache that notices every edit."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from mrtask.planning.compiled import compiled, inlined
from mrtask.planning.reference import by_reference

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = """
import numpy as np
from mrtask.planning.greedy import Greedy
from mrtask.planning.problem import PlanningProblem, RobotKind, RobotStatus
from mrtask.tasks.automaton import build_automaton

automaton = build_automaton("F a", ["a"])
far_and_near = np.array([9.0, 1.0])
problem = PlanningProblem(
    automaton,
    automaton.initial,
    np.full((2, 1), 0.5),
    np.zeros(2, dtype=bool),
    (RobotKind(np.zeros((2, 2))),),
    (RobotStatus(far_and_near),),
)
print(Greedy().plan(problem, 0).assignments[0].container)
"""


class Inner(NamedTuple):
    values: NDArray[np.float64]
    scale: float


class Outer(NamedTuple):
    inner: Inner
    counts: NDArray[np.int64]
    flag: bool


@inlined
def _raise(outer, other):
    for i in range(outer.inner.values.size):
        outer.inner.values[i] *= outer.inner.scale if outer.flag else 1.0
        outer.counts[i] += 1
    return -1 if other is None else other.counts[0]


@compiled
def _twice(outer, other):
    outer, other = by_reference(outer), by_reference(other)
    return _raise(outer, other) + _raise(outer, other)


@pytest.mark.parametrize("flag", [True, False])
def test_parts_read_and_write_what_they_are_given_by_reference(flag):
    outer = Outer(Inner(np.array([1.0, 2.0]), 3.0), np.array([5, 7]), flag)
    other = Outer(Inner(np.zeros(1), 0.0), np.array([40]), False)
    assert _twice(outer, None) == -2
    assert _twice(outer, other) == 80
    assert outer.inner.values.tolist() == ([81.0, 162.0] if flag else [1.0, 2.0])
    assert outer.counts.tolist() == [9, 11]


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "MRTASK_CACHE_DIR"])
def test_an_edited_kernel_takes_effect_with_the_same_cache(tmp_path, variable):
    shutil.copytree(ROOT / "mrtask", tmp_path / "mrtask", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "example.py").write_text(EXAMPLE)
    inherited = {name: value for name, value in os.environ.items() if not name.endswith("_CACHE_DIR")}
    environment = inherited | {"PYTHONPATH": str(tmp_path), variable: str(tmp_path / "cache")}

    def chosen():
        command = [sys.executable, str(tmp_path / "example.py")]
        return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout

    assert chosen() == chosen() == "1\n"
    kernel = tmp_path / "mrtask" / "planning" / "team_kernel.py"
    code = kernel.read_text()
    before, after = (
        "    if robot.mode != MOVING:\n        return start\n",
        "    if robot.mode != MOVING:\n        return 1.0\n",
    )
    assert code.count(before) == 1
    kernel.write_text(code.replace(before, after))
    assert chosen() == "0\n"
    assert len(list((tmp_path / "cache").rglob("*_assign-*.nbi"))) == 2
