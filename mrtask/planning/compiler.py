"""numba's compiler, made quick for kernels of many small parts, and its cache, made safe for several processes.

All that leans on numba's insides is here; `mrtask.planning.compiled` is what kernels use.
"""

import fcntl
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from llvmlite.binding import create_pass_builder, create_pipeline_tuning_options
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompilerBase, Flags
from numba.core.compiler_machinery import PassManager
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import (
    IRLegalization,
    NativeLowering,
    NoPythonBackend,
    NopythonTypeInference,
    PreLowerStripPhis,
)
from numba.core.untyped_passes import DeadBranchPrune, FixupArgs, IRProcessing, ReconstructSSA, TranslateByteCode

_PART_PASSES = (
    TranslateByteCode,
    FixupArgs,
    IRProcessing,
    DeadBranchPrune,
    ReconstructSSA,
    NopythonTypeInference,
    PreLowerStripPhis,
    IRLegalization,
    NativeLowering,
    NoPythonBackend,
)
"""What plain loops over arrays need of numba's. Left out is what closures, generators, context managers, array
expressions and literal arguments need: parts have none."""
_OPTIMISATION = 3
"""LLVM's highest level."""


class _PartCode(JITCodeLibrary):
    """The code of a part: optimised and turned into machine code within kernels only, never by itself.

    numba would do so for each function, over again for what is inlined into it: 2/3 of all time spent on compiling.
    It would also simplify each function before the others see it, with which `pouct`'s kernel becomes twice as large,
    takes a fifth longer to compile and runs no faster.
    """

    def _optimize_functions(self, ll_module: Any) -> None:
        pass

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
    def codegen(self) -> "_PartCode":
        """What `set_env` is asked of."""
        return self

    def set_env(self, name: str, environment: object) -> None:
        """Python's environment is for functions that use Python objects."""


class _KernelCode(JITCodeLibrary):
    """The code of a kernel, optimised once and without repeating loops' bodies.

    Unrolled and vectorised it would take half as long again to compile and run no faster: the loops over robots,
    containers and objects are short.
    """

    def _optimize_final_module(self) -> None:
        options = create_pipeline_tuning_options(speed_level=_OPTIMISATION)
        options.loop_unrolling = options.loop_interleaving = options.loop_vectorization = False
        builder = create_pass_builder(self._codegen._tm, options)
        builder.getModulePassManager().run(self._final_module, builder)


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


class PartCompiler(CompilerBase):
    """What parts of kernels are compiled with: `_PART_PASSES`, for code that is a `_PartCode`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.library = _PartCode(self.state.targetctx.codegen(), "part")
        self.state.flags = _PartFlags(self.state.flags)
        self.state.flags.noalias = True  # nothing that a part is given changes through something else it is given

    def define_pipelines(self) -> list[PassManager]:
        """The only one."""
        passes = PassManager("part")
        for one in _PART_PASSES:
            passes.add_pass(one, one.__name__)
        passes.finalize()
        return [passes]


class _KernelCompiler(Compiler):
    """numba's compiler, for code that is a `_KernelCode`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.library = _KernelCode(self.state.targetctx.codegen(), "kernel")
        self.state.library.enable_object_caching()


class _SharedCache(FunctionCache):
    """numba's cache of a kernel on disk. A process that finds nothing there waits for one that compiles the kernel.

    Where the file system has no locks, each compiles for itself.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._lock: IO[str] | None = None

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The compiled kernel; None if this process is the one to compile it, until `release`."""
        found = super().load_overload(signature, context)
        if found is not None:
            return found
        with suppress(OSError):
            self._impl.locator.ensure_cache_path()
            path = Path(self.cache_path, f"{self._impl.filename_base}.lock")
            self._lock = path.open("w")
            fcntl.flock(self._lock, fcntl.LOCK_EX)
        return super().load_overload(signature, context)

    def release(self) -> None:
        """Lets others look."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None


class Kernel(CPUDispatcher):
    """A compiled function that Python calls, kept in a `_SharedCache`."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions={"nopython": True, **options}, pipeline_class=_KernelCompiler)
        self._cache: _SharedCache = _SharedCache(function)

    def compile(self, signature: Any) -> Any:
        """Its entry point for types of arguments: known, loaded or compiled."""
        try:
            return super().compile(signature)
        finally:
            self._cache.release()
