"""A folder for results: on this machine or behind any fsspec URL (``s3://bucket/run``, ``memory://run``).

Files appear whole or not at all: local ones by renaming, remote ones because stores show an object when its upload
ends.
"""

import fcntl
import hashlib
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fsspec

from pipeline.config import UserError


@dataclass(frozen=True)
class Folder:
    """A folder of files, addressed by its location (an absolute local path or an fsspec URL)."""

    location: str

    @property
    def is_local(self) -> bool:
        """Whether this is a path on this machine."""
        return "://" not in self.location

    def __truediv__(self, name: str) -> "Folder":
        return Folder(f"{self.location.rstrip('/')}/{name}")

    def __str__(self) -> str:
        if not self.is_local:
            return self.location
        relative = os.path.relpath(self.location)
        return self.location if relative.startswith("..") else relative

    def _filesystem(self) -> tuple[Any, str]:
        try:
            filesystem, path = fsspec.core.url_to_fs(self.location)
        except (ValueError, ImportError) as error:
            raise UserError(f"output_dir={self.location}: {error}") from error
        return filesystem, str(path).rstrip("/")

    def write(self, name: str, content: bytes) -> None:
        """Writes one file; an older one of that name is replaced at once.

        Raises:
            UserError: the folder cannot be written, or there is no room.
        """
        filesystem, path = self._filesystem()
        try:
            if self.is_local:
                os.makedirs(path, exist_ok=True)
                temporary = f"{path}/.{name}.{os.getpid()}"
                try:
                    Path(temporary).write_bytes(content)
                    os.replace(temporary, f"{path}/{name}")
                finally:
                    Path(temporary).unlink(missing_ok=True)
            else:
                filesystem.makedirs(path, exist_ok=True)
                filesystem.pipe_file(f"{path}/{name}", content)
        except OSError as error:
            raise UserError(
                f"cannot write {self.location}/{name}: {error.strerror or error}; "
                "make room or give another place by output_dir=..., then run the same command again to continue"
            ) from error

    def read(self, name: str) -> bytes | None:
        """A file's content, None where there is no such file."""
        filesystem, path = self._filesystem()
        try:
            content: bytes = filesystem.cat_file(f"{path}/{name}")
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise UserError(f"cannot read {self.location}/{name}: {error.strerror or error}") from error
        return content

    def names(self) -> list[str]:
        """The names of the files and folders here, sorted; none where the folder is missing."""
        filesystem, path = self._filesystem()
        try:
            return sorted(Path(entry).name for entry in filesystem.ls(path, detail=False, refresh=True))
        except (FileNotFoundError, NotADirectoryError):
            return []

    def remove(self, name: str) -> None:
        """Removes a file or a folder with all in it; nothing happens where there is none."""
        filesystem, path = self._filesystem()
        if filesystem.exists(f"{path}/{name}"):
            filesystem.rm(f"{path}/{name}", recursive=True)

    def rename(self, old: str, new: str) -> None:
        """Renames a file."""
        filesystem, path = self._filesystem()
        filesystem.mv(f"{path}/{old}", f"{path}/{new}")

    def upload(self, source: Path) -> None:
        """Copies a local folder's files here."""
        for path in sorted(source.rglob("*")):
            if path.is_file():
                parent = path.relative_to(source).parent
                target = self if parent == Path(".") else self / str(parent)
                target.write(path.name, path.read_bytes())


@contextmanager
def locked(folder: Folder, cache_dir: Path) -> Iterator[None]:
    """Holds the folder for this process; the lock ends with the process, however that ends.

    A URL is locked for this machine only (by a file in ``cache_dir``): stores have no locks.

    Raises:
        UserError: another run holds it, or the folder cannot be written.
    """
    if folder.is_local:
        path = Path(folder.location) / ".lock"
    else:
        path = cache_dir / "locks" / hashlib.sha256(folder.location.encode()).hexdigest()[:16]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = path.open("a+")
    except OSError as error:
        raise UserError(
            f"cannot write in output_dir={folder.location}: {error.strerror or error}; give another by output_dir=..."
        ) from error
    with handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            handle.seek(0)
            raise UserError(
                f"output_dir={folder.location} is in use by another run ({handle.read().strip() or 'unknown'}); "
                "wait for it, stop it, or give another output_dir"
            ) from error
        handle.seek(0)
        handle.truncate()
        handle.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        handle.flush()
        yield
