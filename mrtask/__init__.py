"""Multi-robot, learning-informed task planning under uncertainty, as a library.

The packages follow the data: ``homes -> maps -> tasks -> likelihood -> planning -> execution -> bounds -> analysis ->
suite``; each imports only those before it. The names that most programs need can be imported from here. They are listed
in ``__init__.pyi`` and loaded when they are first used, so that ``import mrtask`` is cheap.
"""

import lazy_loader

__version__ = "0.1.0"
"""The version of the library and of the pipeline, which `pyproject.toml` reads from here."""

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Return a name of the library, from the module that defines it."""
    if name not in __all__:
        raise AttributeError(f"module 'mrtask' has no attribute {name!r}; it has {', '.join(__all__)}")
    return _load(name)
