"""Files that appear whole or not at all, the hash by which a file is recognised, and where the user's cache is."""

import hashlib
import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def sha256_of(path: Path) -> str:
    """The sha256 of a file's content, 64 hex digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path to write to in the same folder, with the same suffix; at the block's end the file there becomes ``path``.

    Any number of processes and threads may write the same file. When the block raises, ``path`` stays as it was and
    nothing is left behind. Makes the folder where it is missing; raises ``OSError`` where it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{uuid.uuid4().hex}.{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def default_cache_dir() -> Path:
    """``$MRTASK_CACHE_DIR``, else ``mrtask`` in the user's cache folder."""
    given = os.environ.get("MRTASK_CACHE_DIR")
    return Path(given) if given else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mrtask"
