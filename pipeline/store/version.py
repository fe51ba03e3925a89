"""Which code made a result: git's description for people, and a hash of the sources to check what is current."""

import importlib.metadata
import subprocess
from functools import cache
from pathlib import Path

from mrtask.sources import ROOT, hash_folders

STAGES = Path(__file__).parents[1].relative_to(ROOT).as_posix()
"""The folder of the stages: ``pipeline`` in a checkout, ``mrtask/pipeline`` where a wheel was installed."""

DECIDING_PACKAGES = ("networkx", "numba", "numpy", "scikit-image", "scipy", "sentence-transformers", "shapely", "torch")
"""The packages that compute maps, likelihoods and plans; a paper names them to say how its results were made."""


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


def _without_git() -> str:
    return f"source-{source_hash('mrtask', STAGES)}"
