"""How search kernels are compiled, and the random numbers they draw.

numba's cache does not notice an edited function in another file: after an edit here, clear it.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.extending import register_jitable
from numpy.typing import NDArray

F = TypeVar("F", bound=Callable[..., Any])
Records = Any
"""A ``np.recarray`` of a kernel's records, whose fields mypy does not know. What kernels are given in one array lies
closer together, and costs less to compile, than an array for each field."""

KERNEL: dict[str, Any] = {"_nrt": False, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Kernels pass tuples of two dozen arrays to small functions. With numba's reference counts (``_nrt``), which only
functions that allocate need, each such call touches every array's counter: measured, searches run 30 to 100 times
slower. A kernel must therefore allocate nothing. Nor does it divide by zero, so that it need not look for it."""


class _Part(JITCodeLibrary):
    """The code of a part: optimised and turned into machine code within kernels only, never by itself.

    numba would do so for each function, over again for what is inlined into it: 2/3 of all time spent on compiling.
    """

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """None of its functions can be called from outside."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> "_Part":
        """What `set_env` is asked of."""
        return self

    def set_env(self, name: str, environment: object) -> None:
        """Python's environment is for functions that use Python objects."""


class _KnownFlags(Flags):
    """Flags that no longer change. numba looks up what it knows of a function by them, for each operator in it."""

    def __init__(self, flags: Flags) -> None:
        super().__init__(flags)
        self._hash: int = super().__hash__()

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return self is other or bool(super().__eq__(other))

    def copy(self) -> Flags:
        """One that may change."""
        return Flags(self)


class _PartFlags(Flags):
    """The flags that a part is compiled with."""

    def copy(self) -> _KnownFlags:
        """What numba works with: the same object for all parts compiled alike."""
        return _known_flags.setdefault(Flags(self), _KnownFlags(self))


_known_flags: dict[Flags, _KnownFlags] = {}


class _PartCompiler(Compiler):
    """numba's compiler with a `_Part` for the code."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.library = _Part(self.state.targetctx.codegen(), "part")
        self.state.flags = _PartFlags(self.state.flags)


def compiled(function: F) -> F:
    """A kernel that Python calls: compiled with numba, with all that is inlined into it, and cached on disk."""
    return cast(F, numba.njit(cache=True, **KERNEL)(function))


def inlined(function: F) -> F:
    """A part of kernels, compiled only within them. Python, if it calls the function, runs it as it stands.

    On its own it would be compiled three times, once more for each of the ways in which numba lets others call it.
    """
    return register_jitable(pipeline_class=_PartCompiler, forceinline=True, **KERNEL)(function)


def called(function: F) -> F:
    """As `inlined`, but called within the kernel: for what is long and seldom needed."""
    return register_jitable(pipeline_class=_PartCompiler, forceinline=False, **KERNEL)(function)


@inlined
def random_unit(rng: NDArray[np.uint64]) -> float:
    """splitmix64 (Steele et al. 2014): uniform in [0, 1); the state ``rng`` [1] is advanced in place."""
    rng[0] += np.uint64(0x9E3779B97F4A7C15)
    z = rng[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)
