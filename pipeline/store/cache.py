"""The user's cache: maps, embeddings of names, compiled kernels and copies of models; all can be removed at any time.

``mrtask clean`` removes it. Every evaluation trims it to ``cache_limit_gb``; the least recently used files go first.
"""

import contextlib
from pathlib import Path


def trim(folder: Path, limit_bytes: float) -> int:
    """Remove the least recently used files until the folder is within its limit; return how many."""
    files = []
    for path in folder.rglob("*"):
        with contextlib.suppress(OSError):
            if path.is_file():
                status = path.stat()
                files.append((max(status.st_atime, status.st_mtime), status.st_size, path))
    total, removed = sum(size for _, size, _ in files), 0
    for _, size, path in sorted(files):
        if total <= limit_bytes:
            break
        with contextlib.suppress(OSError):
            path.unlink()
            total, removed = total - size, removed + 1
    return removed
