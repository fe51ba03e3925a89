"""numba's compiler for the parts of kernels, which are compiled only within the kernels that use them.

All that leans on numba's insides is here; `mrtask.planning.compiled` is what kernels use.
"""

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler


class _PartCode(JITCodeLibrary):
    """The code of a part: optimised and turned into machine code only within kernels, never by itself.

    numba would optimise and translate each function alone, and again wherever it is inlined: more than half of the time
    that a kernel takes to compile.
    """

    def _optimize_functions(self, ll_module: Any) -> None:
        pass

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: no function of a part can be called from outside."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> "_PartCode":
        """The object on which numba calls `set_env`."""
        return self

    def set_env(self, name: str, environment: object) -> None:
        """Ignore Python's environment, which is for functions that use Python objects."""


class PartCompiler(Compiler):
    """numba's compiler, for code that is a `_PartCode`."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.library = _PartCode(self.state.targetctx.codegen(), "part")
        self.state.flags = self.state.flags.copy()
        self.state.flags.noalias = True  # nothing that a part is given changes through something else it is given
