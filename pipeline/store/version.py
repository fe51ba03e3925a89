"""Which code made a result: git's word for people and a hash of the sources for deciding what is up to date."""

import hashlib
import subprocess
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCE_SUFFIXES = {".py", ".yaml", ".toml", ".json", ".csv", ".jinja"}


@cache
def source_hash(*folders: str) -> str:
    """16 hex digits of all code and catalogue files below the folders (``mrtask/homes``, ...), by path and content."""
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in SOURCE_SUFFIXES and path.is_file():
                digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


@cache
def code_version() -> str:
    """The commit (``-dirty`` with uncommitted changes), or the sources' hash where there is no git."""
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return f"source-{source_hash('mrtask', 'pipeline')}"
