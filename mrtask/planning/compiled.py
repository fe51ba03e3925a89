"""How search kernels are compiled, and the random numbers they draw.

numba's cache does not notice an edited function in another file: after an edit here, clear it.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compiles a kernel with numba, cached on disk, without numba's reference counting (``_nrt``).

    Kernels pass tuples of two dozen arrays to small functions. With reference counts, which only functions that
    allocate need, each such call touches every array's counter: measured, searches run 30 to 100 times slower.
    A kernel must therefore allocate nothing.
    """
    options: dict[str, Any] = {"cache": True, "_nrt": False, "forceinline": True}
    return cast(F, numba.njit(**options)(function))


def compiled_apart(function: F) -> F:
    """As `compiled`, but called rather than inlined: for what is long and seldom needed."""
    options: dict[str, Any] = {"cache": True, "_nrt": False}
    return cast(F, numba.njit(**options)(function))


@compiled
def random_unit(rng: NDArray[np.uint64]) -> float:
    """splitmix64 (Steele et al. 2014): uniform in [0, 1); the state ``rng`` [1] is advanced in place."""
    rng[0] += np.uint64(0x9E3779B97F4A7C15)
    z = rng[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)
