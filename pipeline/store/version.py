"""Which code made a result: git's description for people, and hashes of the sources to check what is current."""

import importlib.metadata
import platform
import subprocess
import sysconfig
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from mrtask.sources import ROOT, hash_folders, hash_module

MISSING = "missing"
"""Stands for the code or version of what is not installed."""

STAGES = Path(__file__).parents[1].relative_to(ROOT).as_posix()
"""The folder of the stages: ``pipeline`` in a checkout, ``mrtask/pipeline`` where a wheel was installed."""

RESULT_SOURCES = ("homes", "maps", "tasks", "likelihood", "planning", "execution")
"""The library packages whose code decides an episode's row."""
WORKER_SOURCES = (*RESULT_SOURCES, "bounds")
"""The library packages whose code runs in workers."""

DECIDING_PACKAGES = ("networkx", "numba", "numpy", "scikit-image", "scipy", "sentence-transformers", "shapely", "torch")
"""The packages that compute maps, likelihoods and plans; a paper names them to say how its results were made."""

WORKER_PACKAGES = (*DECIDING_PACKAGES, "llvmlite", "pandas", "scikit-learn")
"""The packages whose version can change a number that a worker returns."""


@cache
def source_hash(*folders: str) -> str:
    """Return 16 hex digits for the path and content of all sources below the folders (``mrtask/homes``, ...)."""
    return hash_folders(*folders)


@cache
def code_version() -> str:
    """Return the commit (``-dirty`` with uncommitted changes), or the sources' hash where there is no git.

    Installed code may lie in an environment below somebody else's repository, whose commit says nothing about it.
    """
    if not (ROOT / ".git").exists():
        return _without_git()
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return _without_git()


def public_version(package: str) -> str:
    """Return the version as package indexes know it: ``2.13.0``, not the local build ``2.13.0+cpu``."""
    return importlib.metadata.version(package).partition("+")[0]


def package_versions() -> dict[str, str]:
    """Return the versions of `DECIDING_PACKAGES`."""
    return {name: public_version(name) for name in DECIDING_PACKAGES}


@cache
def worker_code(modules: tuple[str, ...]) -> Mapping[str, str]:
    """Return, part by part, a hash of the code or the version of all that decides what this process computes.

    The parts are the library's packages, these modules with all that they import from their own folder, the packages
    that compute, and Python.
    """
    parts = {f"mrtask.{name}": source_hash(f"mrtask/{name}") for name in WORKER_SOURCES}
    parts |= {module: _module_hash(module) for module in modules}
    parts |= {name: _version_here(name) for name in WORKER_PACKAGES}
    return parts | {"python": platform.python_version()}


def differences_in_code(expected: Mapping[str, str], modules: tuple[str, ...]) -> list[str]:
    """Return in which parts this process's `worker_code` is not as expected: ``numba 0.67.0 instead of 0.68.1``."""
    here = worker_code(modules)
    return [
        _difference(part, here.get(part, MISSING), there)
        for part, there in expected.items()
        if here.get(part, MISSING) != there
    ]


def _difference(part: str, here: str, there: str) -> str:
    if here == MISSING:
        return f"no {part}"
    return f"{part} {here} instead of {there}" if part in (*WORKER_PACKAGES, "python") else f"other code in {part}"


def _module_hash(module: str) -> str:
    """Return the hash of a module; that of nothing where there is no such module, or no source of it."""
    try:
        spec = find_spec(module.partition(".")[0])
    except ValueError:  # it was made at run time
        return MISSING
    if spec is None or (spec.origin is None and spec.submodule_search_locations is None):
        return MISSING
    place = spec.submodule_search_locations or [str(spec.origin)]
    root = Path(next(iter(place))).resolve().parent
    installed = {Path(sysconfig.get_path(name)).resolve() for name in ("purelib", "platlib", "stdlib")}
    ours = module.partition(".")[0] in ("mrtask", Path(STAGES).parts[0])
    try:
        return hash_module(module, root, beside=not ours and root not in installed)
    except ModuleNotFoundError:
        return MISSING


def _version_here(package: str) -> str:
    try:
        return public_version(package)
    except importlib.metadata.PackageNotFoundError:
        return MISSING


def _without_git() -> str:
    return f"source-{source_hash('mrtask', STAGES)}"
