"""Write files whole or not at all, hash their content, and locate the user's cache folder."""

import hashlib
import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def sha256_of(path: Path) -> str:
    """Return the sha256 of a file's content, 64 hex digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a path to write to, in the same folder and with the same suffix; when the block ends, it replaces ``path``.

    Any number of processes and threads may write the same file. If the block raises, ``path`` stays unchanged and
    nothing is left behind. A missing folder is created. Raises ``OSError`` if the folder cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{uuid.uuid4().hex}.{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def default_cache_dir() -> Path:
    """Return ``$MRTASK_CACHE_DIR``, or else ``mrtask`` in the user's cache folder."""
    given = os.environ.get("MRTASK_CACHE_DIR")
    return Path(given) if given else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mrtask"
