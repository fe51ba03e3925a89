"""How search kernels are compiled, and the random numbers they draw.

numba's cache does not notice an edited function in another file: after an edit here, clear it.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba.extending import register_jitable

from mrtask.arrays import UInt64s
from mrtask.planning.compiler import Kernel, PartCompiler

F = TypeVar("F", bound=Callable[..., Any])
Records = Any
"""A ``np.recarray`` of a kernel's records, whose fields mypy does not know. What kernels are given in one array lies
closer together, and costs less to compile, than an array for each field."""

KERNEL: dict[str, Any] = {"_nrt": False, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Kernels pass tuples of two dozen arrays to small functions. With numba's reference counts (``_nrt``), which only
functions that allocate need, each such call touches every array's counter: measured, searches run 30 to 100 times
slower. A kernel must therefore allocate nothing. Nor does it divide by zero, so that it need not look for it."""


def compiled(function: F) -> F:
    """A kernel that Python calls: compiled with numba, with all that is inlined into it, and cached on disk.

    It hands its named tuples on to its parts `mrtask.planning.reference.by_reference`.
    """
    return cast(F, Kernel(function, KERNEL))


def inlined(function: F) -> F:
    """A part of kernels, compiled only within them. Python, if it calls the function, runs it as it stands.

    On its own it would be compiled three times, once more for each of the ways in which numba lets others call it.
    """
    return register_jitable(pipeline_class=PartCompiler, forceinline=True, **KERNEL)(function)


def called(function: F) -> F:
    """As `inlined`, but called within the kernel: for what is long and seldom needed."""
    return register_jitable(pipeline_class=PartCompiler, forceinline=False, **KERNEL)(function)


@inlined
def random_unit(rng: UInt64s) -> float:
    """splitmix64 (Steele et al. 2014): uniform in [0, 1); the state ``rng`` [1] is advanced in place."""
    rng[0] += np.uint64(0x9E3779B97F4A7C15)
    z = rng[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)
