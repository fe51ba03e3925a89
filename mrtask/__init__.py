"""Multi-robot, learning-informed task planning under uncertainty, as a library.

The packages follow the way of the data: ``homes -> maps -> tasks -> likelihood -> planning -> execution -> analysis ->
suite``; each imports only those before it. The names that most programs need can be imported from here; they are
listed in ``__init__.pyi`` and loaded when they are first used, so that ``import mrtask`` costs next to nothing.
"""

import ast
from functools import cache
from importlib import import_module
from pathlib import Path


@cache
def _modules() -> dict[str, str]:
    """The module of each name that is exported, as the stub beside this file imports them."""
    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom) and node.module]
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def __getattr__(name: str) -> object:
    """A name of the library, from the module that defines it."""
    if name not in _modules():
        raise AttributeError(f"module 'mrtask' has no attribute {name!r}; it has {', '.join(sorted(_modules()))}")
    return getattr(import_module(_modules()[name]), name)


def __dir__() -> list[str]:
    """All names, for completion and ``from mrtask import *``."""
    return sorted(_modules())
