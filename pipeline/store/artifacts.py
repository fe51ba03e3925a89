"""Folders that are named by what they were made from and appear whole or not at all.

The name is ``<kind>/<name>-<key>``, where the key is a hash of inputs, configuration and code. An existing folder is
therefore right: a stage with unchanged inputs has nothing to do, and concurrent makers of one folder do not disturb
each other. Each folder holds a record of its content, its manifest.
"""

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from pipeline.base.config import UserError
from pipeline.store.folder import Folder
from pipeline.store.records import Record

MANIFEST = "manifest.json"

R = TypeVar("R", bound=Record)


class NotMade(UserError):
    """Something that a dry run would have to make first."""


def find_manifest(folder: Path, kind: type[R]) -> R | None:
    """Return the manifest of a finished folder; None where this version can read none and must make the folder."""
    return kind.find(Folder(str(folder)), MANIFEST)


def make(folder: Path, fill: Callable[[Path], R]) -> R:
    """Fill a new folder and give it its name; ``fill`` puts files into the folder it gets and returns the manifest.

    Raises:
        UserError: the place cannot be written.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    except OSError as error:
        raise UserError(
            f"cannot write in {folder.parent}: {error.strerror}; give another place by datasets_dir=..."
        ) from error
    try:
        manifest = fill(temporary)
        (temporary / MANIFEST).write_bytes(manifest.to_json())
        temporary.chmod(0o755)
        try:
            os.replace(temporary, folder)
        except OSError:  # another process has made it meanwhile, or something unfinished is in the way
            if find_manifest(folder, type(manifest)) is None:
                shutil.rmtree(folder, ignore_errors=True)
                os.replace(temporary, folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return manifest
