"""Kernels compiled in one process are there for all others."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mrtask.planning.problem import Plan
from mrtask.planning.warm_up import Compilation

ROOT = Path(__file__).resolve().parents[2]
WITHOUT_COMPILING = """
from mrtask.planning import greedy
from mrtask.planning import warm_up
warm_up.compile_kernels({"greedy": ("greedy", {})})
assert greedy._assign.stats.cache_hits and not greedy._assign.stats.cache_misses, greedy._assign.stats
"""


class Faulty:
    """A planner that cannot be warmed up."""

    knows_contents = False

    def warm_up(self, problem):
        raise RuntimeError("no compiler here")

    def plan(self, problem, seed):
        return Plan({})


MISSING = "from mrtask.planning.warm_up import kernels_missing; print(kernels_missing())"


def missing():
    """`kernels_missing` of a new process."""
    return (
        subprocess.run([sys.executable, "-c", MISSING], check=True, capture_output=True, text=True).stdout == "True\n"
    )


def test_kernels_are_left_for_other_processes(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    assert missing()
    planners = {
        "greedy": ("greedy", {}),
        "mine": (f"{__name__}.Faulty", {}),
        "again": ("greedy", {"later_weight": 0.5}),
    }
    with Compilation(planners) as compilation:
        finished = dict(compilation.finished())
    assert finished == {"greedy": "", "again": "", "mine": "RuntimeError: no compiler here"}
    assert not missing()
    done = subprocess.run([sys.executable, "-c", WITHOUT_COMPILING], env=os.environ, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_leaving_early_stops_the_processes(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    with pytest.raises(KeyboardInterrupt), Compilation({"pouct": ("pouct", {})}) as compilation:
        raise KeyboardInterrupt
    assert [process.returncode for process in compilation._running.values()] == [-9]
