"""How search kernels are compiled."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compiles a kernel with numba, cached on disk, without numba's reference counting (``_nrt``).

    Kernels pass tuples of two dozen arrays to small functions. With reference counts, which only functions that
    allocate need, each such call touches every array's counter: measured, searches run 30 to 100 times slower.
    A kernel must therefore allocate nothing.
    """
    options: dict[str, Any] = {"cache": True, "_nrt": False, "forceinline": True}
    return cast(F, numba.njit(**options)(function))
