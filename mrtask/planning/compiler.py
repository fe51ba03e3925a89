"""Compile the parts of kernels with numba, only within the kernels that use them.

This module holds all code that depends on numba's internals. Kernels use `mrtask.planning.compiled`.
"""

from typing import Any

from llvmlite.binding import create_pass_builder, create_pipeline_tuning_options
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class _PartCode(JITCodeLibrary):
    """The code of a part, which is optimised and turned into machine code only within kernels, never by itself.

    By default, numba optimises and translates each function alone, and again wherever it is inlined. That takes more
    than half of a kernel's compile time.
    """

    def _optimize_functions(self, ll_module: Any) -> None:
        pass

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: a part's functions cannot be called from outside."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> "_PartCode":
        """Return the object on which numba calls `set_env`."""
        return self

    def set_env(self, name: str, environment: object) -> None:
        """Ignore Python's environment, which only functions that use Python objects need."""


class PartCompiler(Compiler):
    """A numba compiler whose code is a `_PartCode`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.library = _PartCode(self.state.targetctx.codegen(), "part")
        self.state.flags = self.state.flags.copy()
        self.state.flags.noalias = True  # no two arguments of a part share memory that changes


class _KernelCode(JITCodeLibrary):
    """The code of a kernel, optimised without unrolling or vectorising its loops.

    The loops over robots, containers and objects are short. Unrolled, `pouct_paper` draws a tenth fewer samples.
    """

    def _optimize_final_module(self) -> None:
        options = create_pipeline_tuning_options(speed_level=3)
        options.loop_unrolling = options.loop_interleaving = options.loop_vectorization = False
        builder = create_pass_builder(self._codegen._tm, options)
        builder.getModulePassManager().run(self._final_module, builder)


class KernelCompiler(Compiler):
    """numba's compiler, for code that is a `_KernelCode`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.library = _KernelCode(self.state.targetctx.codegen(), "kernel")
        self.state.library.enable_object_caching()
