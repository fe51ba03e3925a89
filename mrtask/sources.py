"""Which of the library's own files decide a result, and a hash of them: different code has a different hash.

Everything that is kept for later (maps, homes, rows) is named by such a hash. It is therefore never mistaken for a
result of the present code, and code on which it does not depend (such as drawing) can change freely. Only this
package's files count, not Python's version or other packages.
"""

import ast
import hashlib
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

from mrtask.files import default_cache_dir

ROOT = Path(__file__).resolve().parents[1]
"""The folder that contains the package."""
SUFFIXES = frozenset({".py", ".yaml", ".toml", ".json", ".csv", ".jinja"})

KERNEL_SOURCES = ("mrtask/maps", "mrtask/planning", "mrtask/bounds")
"""The packages that contain compiled kernels."""


@cache
def use_kernel_cache() -> Path:
    """Set numba's cache folder to one named after the hash of the packages that hold kernels, and return it.

    When a function that a cached kernel calls is edited in another file, numba does not notice. Every module that
    declares kernels therefore calls this function first. The folder is in ``$NUMBA_CACHE_DIR``, or else in our own
    cache folder.
    """
    import numba.core.config

    config: Any = numba.core.config  # numba sets its options on import
    folder = Path(config.CACHE_DIR or default_cache_dir() / "numba") / hash_folders(*KERNEL_SOURCES)
    config.CACHE_DIR = str(folder)
    return folder


def hash_folders(*folders: str, root: Path = ROOT) -> str:
    """Return 16 hex digits that hash all code and data files in the folders (``mrtask/homes``), by path and content.

    Raises:
        FileNotFoundError: a folder is missing or contains no such file.
    """
    files: set[Path] = set()
    for folder in folders:
        below = {path for path in (root / folder).rglob("*") if path.suffix in SUFFIXES and path.is_file()}
        if not below:
            raise FileNotFoundError(f"no sources in {root / folder}")
        files |= below
    return _hash(files, root)


def hash_module(module: str, root: Path = ROOT, *, beside: bool = False) -> str:
    """Return 16 hex digits that hash the `module_files`, by path and content."""
    return _hash(module_files(module, root, beside=beside), root)


def module_files(module: str, root: Path = ROOT, *, beside: bool = False) -> frozenset[Path]:
    """Return the files that decide what a module (``mrtask.maps.home_map``) does.

    These are its own files and those of all modules of the same package that it imports, directly or through others;
    with ``beside``, also of other packages in ``root``. A data file named after a module (``catalogue.yaml`` of
    ``catalogue.py``) belongs to it.

    Raises:
        ModuleNotFoundError: there is no such module below ``root``.
    """
    if _file_of(module, root) is None:
        raise ModuleNotFoundError(f"no module {module} in {root}", name=module)
    package = module.partition(".")[0]
    waiting, modules = {module}, dict[str, Path]()
    while waiting:
        name = waiting.pop()
        path = _file_of(name, root)
        if path is None or name in modules:
            continue
        modules[name] = path
        within = name if path.stem == "__init__" else name.rpartition(".")[0]
        imported = {part for imported in _imports(path.read_bytes(), within) for part in _with_parents(imported)}
        waiting |= {part for part in imported if beside or part.partition(".")[0] == package}
    return frozenset(
        file for path in modules.values() for file in path.parent.glob(f"{path.stem}.*") if file.suffix in SUFFIXES
    )


def _file_of(module: str, root: Path) -> Path | None:
    """Return the file of a module or package, or None for another name (a class, another distribution's module)."""
    base = root.joinpath(*module.split("."))
    return next((path for path in (base.with_suffix(".py"), base / "__init__.py") if path.is_file()), None)


@cache
def _imports(code: bytes, package: str) -> frozenset[str]:
    """Return the names imported anywhere in a file.

    For ``from a import b`` they include both ``a`` and ``a.b``, which may be a module.
    """
    names: set[str] = set()
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            source = resolve_name("." * node.level + (node.module or ""), package)
            names.update((source, *(f"{source}.{alias.name}" for alias in node.names)))
    return frozenset(names)


def _with_parents(module: str) -> Iterator[str]:
    """Yield ``a.b.c``, ``a.b`` and ``a``: importing the first runs them all."""
    while module:
        yield module
        module = module.rpartition(".")[0]


def _hash(files: Iterable[Path], root: Path) -> str:
    digest = hashlib.sha256()
    for name, path in sorted((path.relative_to(root).as_posix(), path) for path in files):
        digest.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
