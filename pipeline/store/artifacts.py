"""Folders that are named by what they were made from and appear whole or not at all.

``<kind>/<name>-<key>`` with the key a hash of inputs, configuration and code: if it is there it is right, so a stage
with unchanged inputs has nothing to do, and concurrent makers of the same folder do not disturb each other.
"""

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pipeline.base.config import UserError

MANIFEST = "manifest.json"


def ready(folder: Path) -> bool:
    """Whether the folder has been made."""
    return (folder / MANIFEST).is_file()


def read_manifest(folder: Path) -> dict[str, Any]:
    """What a finished folder's maker wrote about it."""
    content: dict[str, Any] = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    return content


def make(folder: Path, fill: Callable[[Path], Mapping[str, Any]]) -> None:
    """Fills a new folder and gives it its name; ``fill`` returns the manifest.

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
        (temporary / MANIFEST).write_text(json.dumps(manifest, indent=1), encoding="utf-8")
        temporary.chmod(0o755)
        try:
            os.replace(temporary, folder)
        except OSError:  # somebody else made it meanwhile, or a folder without manifest is in the way
            if not ready(folder):
                shutil.rmtree(folder, ignore_errors=True)
                os.replace(temporary, folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
