"""A folder for results: on this machine or behind any fsspec URL (``s3://bucket/run``, ``memory://run``).

Files appear whole or not at all: local ones by renaming, remote ones because stores show an object when its upload
ends. Credentials and endpoints of stores come from the environment, as their fsspec packages take them.
"""

import contextlib
import fcntl
import hashlib
import json
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pipeline.base import console
from pipeline.base.config import UserError

OBJECT_STORES = {"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az"}
"""They have no folders to make, and making a missing bucket would hide a misspelt name."""
LOCK = ".lock"
LOCKS = "locks"
"""The folder in the cache with the locks of runs in stores."""
LEASE_S = 60.0
"""A run that has not renewed its lock in a store for this long is dead."""
RENEW_EVERY_S = 15.0
PATIENCE_S = 600.0
"""How long a store that a run writes to is asked again before the run gives up."""
RETRY_EVERY_S = 5.0

Result = TypeVar("Result")


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

    @contextmanager
    def _opened(self, problem: str, advice: str = "") -> Iterator[tuple[Any, str]]:
        """Give the file system and the path in it; turn its exceptions, of which each has its own, into `UserError`."""
        import fsspec  # its import is a tenth of the time in which a mistake is answered

        try:
            filesystem, path = fsspec.core.url_to_fs(self.location)
        except (ImportError, ValueError) as error:
            is_s3 = isinstance(error, ImportError) and self.location.startswith("s3")
            hint = "; pip install 'mrtask[s3]' brings it" if is_s3 else ""
            raise UserError(f"output_dir={self.location}: {error}{hint}") from error
        try:
            yield filesystem, str(path).rstrip("/")
        except UserError:
            raise
        except Exception as error:
            if self.is_local and not isinstance(error, OSError):
                raise
            reason = (isinstance(error, OSError) and error.strerror) or error
            raise UserError(f"{problem}: {reason}{advice}") from error

    def _do(self, problem: str, act: Callable[[Any, str], Result], advice: str = "", *, patient: bool = True) -> Result:
        """Return ``act(filesystem, path)``; a store that a run has begun to use is asked again for `PATIENCE_S`."""
        began_s = time.monotonic()
        silent = (self._store, problem.split()[1])
        while True:
            try:
                with self._opened(problem, advice) as (filesystem, path):
                    result = act(filesystem, path)
            except UserError as error:
                if not (patient and self._in_use) or time.monotonic() - began_s >= PATIENCE_S:
                    raise
                _say_silent(silent, error)
                time.sleep(RETRY_EVERY_S)
            else:
                if not self.is_local:
                    _say_answers(silent)
                return result

    @property
    def _store(self) -> str:
        """The store's bucket: ``s3://bucket``."""
        return "/".join(self.location.split("/")[:3])

    @property
    def _in_use(self) -> bool:
        return not self.is_local and any(self.location.startswith(held) for held in _leased_here)

    def write(self, name: str, content: bytes, *, patient: bool = True) -> None:
        """Write one file; it replaces an older one of that name at once.

        Raises:
            UserError: the folder cannot be written, or the disk is full.
        """
        advice = "; make room or give another place by output_dir=..., then run the same command again to continue"

        def act(filesystem: Any, path: str) -> None:
            if not self.is_local:
                if self.location.partition("://")[0] not in OBJECT_STORES:
                    filesystem.makedirs(path, exist_ok=True)
                filesystem.pipe_file(f"{path}/{name}", content)
                return
            os.makedirs(path, exist_ok=True)
            temporary = f"{path}/.{name}.{os.getpid()}"
            try:
                Path(temporary).write_bytes(content)
                os.replace(temporary, f"{path}/{name}")
            finally:
                Path(temporary).unlink(missing_ok=True)

        self._do(f"cannot write {self.location}/{name}", act, "" if self._in_use else advice, patient=patient)

    def read(self, name: str) -> bytes | None:
        """Return a file's content, None where there is no such file."""

        def act(filesystem: Any, path: str) -> bytes | None:
            try:
                content: bytes = filesystem.cat_file(f"{path}/{name}")
            except (FileNotFoundError, NotADirectoryError):
                return None
            return content

        return self._do(f"cannot read {self.location}/{name}", act)

    def names(self) -> list[str]:
        """Return the sorted names of the files and folders here; none where the folder is missing."""

        def act(filesystem: Any, path: str) -> list[str]:
            try:
                return sorted(Path(entry).name for entry in filesystem.ls(path, detail=False, refresh=True))
            except (FileNotFoundError, NotADirectoryError):
                return []

        return self._do(f"cannot list {self.location}", act)

    def remove(self, name: str, *, patient: bool = True) -> None:
        """Remove a file, or a folder with its content, if it exists."""

        def act(filesystem: Any, path: str) -> None:
            if filesystem.exists(f"{path}/{name}"):
                filesystem.rm(f"{path}/{name}", recursive=True)

        self._do(f"cannot remove {self.location}/{name}", act, patient=patient)

    def rename(self, old: str, new: str) -> None:
        """Rename a file."""

        def act(filesystem: Any, path: str) -> None:
            try:
                filesystem.mv(f"{path}/{old}", f"{path}/{new}")
            except FileNotFoundError:
                if not filesystem.exists(f"{path}/{new}"):  # it may have been renamed, and only the answer lost
                    raise

        self._do(f"cannot rename {self.location}/{old}", act)

    def upload(self, source: Path) -> None:
        """Copy a local folder's files here."""
        for path in sorted(source.rglob("*")):
            if path.is_file():
                parent = path.relative_to(source).parent
                target = self if parent == Path(".") else self / str(parent)
                target.write(path.name, path.read_bytes())


_leased_here: set[str] = set()
"""The locations in stores that this process has begun to write to."""
_silent: set[tuple[str, str]] = set()
"""The stores that did not write, read, ... something, and have not since."""


def _say_silent(what: tuple[str, str], error: UserError) -> None:
    if what not in _silent:
        _silent.add(what)
        console.line(
            f"{error}; the run goes on, keeps its rows and tries again for up to {console.duration(PATIENCE_S)}"
        )


def _say_answers(what: tuple[str, str]) -> None:
    if what in _silent:
        _silent.discard(what)
        console.line(f"{what[0]} answers again")


@contextmanager
def locked(folder: Folder, cache_dir: Path) -> Iterator[None]:
    """Hold the folder for this process; the lock ends with the process, however that ends.

    A folder that was made for the lock and got nothing else is removed at the end.

    For a URL, a file in ``cache_dir`` locks it on this machine, and an object in the store, which counts while it is
    renewed, on others: if two machines start a run in the same second, both may get in.

    Raises:
        UserError: another run holds it, or the folder cannot be written.
    """
    if folder.is_local:
        path = Path(folder.location) / LOCK
        new = [parent for parent in path.parents if not parent.exists()]
        with _locked_file(path, folder):
            try:
                yield
            finally:
                _remove_unused(path, new)
    else:
        path = cache_dir / LOCKS / hashlib.sha256(folder.location.encode()).hexdigest()[:16]
        with _locked_file(path, folder), _leased(folder):
            yield


def _remove_unused(lock: Path, new: Sequence[Path]) -> None:
    """Remove the lock's folder and the ``new`` ones above it, deepest first, as far as they hold nothing else."""
    if lock.parent not in new or [path.name for path in lock.parent.iterdir()] != [lock.name]:
        return
    lock.unlink()
    for parent in new:
        if any(parent.iterdir()):
            return
        parent.rmdir()


@contextmanager
def _locked_file(path: Path, folder: Folder) -> Iterator[None]:
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
        if not path.exists() or not os.path.samestat(path.stat(), os.fstat(handle.fileno())):
            # A run that left nothing has just removed it.
            raise UserError(f"output_dir={folder.location} was in use by another run until now; run the command again")
        handle.seek(0)
        handle.truncate()
        handle.write(f"{this_process()}\n")
        handle.flush()
        yield


@contextmanager
def _leased(folder: Folder) -> Iterator[None]:
    """Keep an object in the store that tells runs on other machines to stay out."""
    _refuse_if_leased(folder)
    over = threading.Event()

    def write() -> None:
        lease = {"by": this_process(), "host": socket.gethostname(), "renewed": time.time()}
        folder.write(LOCK, json.dumps(lease).encode(), patient=False)

    def renew() -> None:
        while not over.wait(RENEW_EVERY_S):
            # The run's own next write reports a store that cannot be written.
            with contextlib.suppress(UserError):
                write()

    write()
    renewing = threading.Thread(target=renew, daemon=True)
    renewing.start()
    _leased_here.add(folder.location)
    try:
        yield
    finally:
        _leased_here.discard(folder.location)
        over.set()
        renewing.join(LEASE_S / 10)
        # If the store fails and keeps it, it expires like a killed run's.
        with contextlib.suppress(UserError):
            folder.remove(LOCK, patient=False)


def _refuse_if_leased(folder: Folder) -> None:
    content = folder.read(LOCK)
    if content is None:
        return
    lease = json.loads(content)
    silent_s = time.time() - lease["renewed"]
    # One from this machine belongs to a dead run: the file lock shows that no other is alive.
    if lease["host"] != socket.gethostname() and silent_s < LEASE_S:
        raise UserError(
            f"output_dir={folder.location} is in use by another run ({lease['by']}, heard of {silent_s:.0f} s ago); "
            f"wait for it, stop it, or give another output_dir. A killed run is forgotten after {LEASE_S:.0f} s"
        )


def this_process() -> str:
    """Return which process this is, for people on other machines."""
    return f"process {os.getpid()} on {socket.gethostname()}"
