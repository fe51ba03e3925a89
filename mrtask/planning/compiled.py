"""Compile search kernels, and draw the random numbers that they need."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numba.extending import register_jitable

from mrtask.arrays import UInt64s
from mrtask.planning.compiler import KernelCompiler, PartCompiler
from mrtask.sources import use_kernel_cache

use_kernel_cache()

F = TypeVar("F", bound=Callable[..., Any])
Records = Any
"""A ``np.recarray`` of a kernel's records; mypy does not know its fields. Compared with one array per field, records in
one array lie closer together in memory and compile faster."""

KERNEL: dict[str, Any] = {"_nrt": False, "error_model": "numpy"}
"""Kernels pass tuples of two dozen arrays to small functions. With numba's reference counts (``_nrt``), which only
functions that allocate need, each such call touches the counter of every array: in our measurements, searches ran 30 to
100 times slower. A kernel must therefore allocate nothing. It never divides by zero either, so it does not have to
check for that."""


def compiled(function: F) -> F:
    """Compile a kernel that Python calls, together with all its parts, and cache it on disk.

    A kernel passes its named tuples to its parts `mrtask.planning.reference.by_reference`.
    """
    return cast(F, njit(cache=True, pipeline_class=KernelCompiler, **KERNEL)(function))


def inlined(function: F) -> F:
    """Make a function a part of kernels. It is compiled only within them; Python runs it uncompiled."""
    return register_jitable(pipeline_class=PartCompiler, forceinline=True, **KERNEL)(function)


def called(function: F) -> F:
    """Make a part like `inlined` does, but call it instead of inlining it.

    Use this for long code that is rarely needed.
    """
    return register_jitable(pipeline_class=PartCompiler, forceinline=False, **KERNEL)(function)


@inlined
def random_unit(rng: UInt64s) -> float:
    """Return a uniform random number in [0, 1) by splitmix64 (Steele et al. 2014), and advance ``rng`` [1] in place."""
    rng[0] += np.uint64(0x9E3779B97F4A7C15)
    z = rng[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)
