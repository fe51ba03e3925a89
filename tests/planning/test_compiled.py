"""Kernels: named tuples by reference, and one compilation for several processes."""

import os
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
KERNEL = """
from mrtask.planning.compiled import compiled, inlined

@inlined
def part(values, k):
    total = 0.0
    for i in range(values.size):
        if i % k:
            total += values[i] ** k
    return total

@compiled
def kernel(values):
    return part(values, 2) + part(values, 3)
"""
TOGETHER = """
import sys
import numpy as np
import kernel_module as module
print("ready", flush=True)
sys.stdin.readline()
assert module.kernel(np.arange(5.0)) == module.part(np.arange(5.0), 2) + module.part(np.arange(5.0), 3)
print(sum(module.kernel.stats.cache_misses.values()), flush=True)
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


def test_processes_that_start_together_compile_a_kernel_once(tmp_path):
    (tmp_path / "kernel_module.py").write_text(KERNEL)
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)]),
    }
    command = [sys.executable, "-c", TOGETHER]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": environment}
    processes = [subprocess.Popen(command, **pipes) for _ in range(3)]
    for process in processes:
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        process.stdin.write("go\n")
        process.stdin.flush()
    assert sorted(process.communicate()[0] for process in processes) == ["0\n", "0\n", "1\n"]


def test_a_kernel_that_cannot_be_compiled_does_not_keep_others_waiting():
    @compiled
    def faulty(value):
        return value.nothing

    with pytest.raises(Exception, match="nothing"):
        faulty(1.0)
    with pytest.raises(Exception, match="nothing"):
        faulty(1)
