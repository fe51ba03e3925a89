"""Removes what runs left on this machine: mrtask clean [really=true] [runs=outputs] [days=30]

Without ``really=true`` this only shows what would go: the cache (maps, embeddings, kernels, copies of models), the logs
of Ray sessions that have ended, and locks that nobody holds. With ``runs=FOLDER`` also the runs in that folder to which
nothing was written for ``days`` days, with their results. Rows that a store did not take are never removed.
"""

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mrtask.files import default_cache_dir
from mrtask.names import suggest
from pipeline.app import tool
from pipeline.base.config import UserError, explain_error
from pipeline.base.values import LocalPath
from pipeline.store.folder import LOCK, LOCKS
from pipeline.store.layout import IDENTITY

DAY_S = 86_400.0
SESSIONS = "ray"
"""Where Ray keeps the logs of its sessions, in the folder for temporary files."""


class Options(BaseModel):
    """The command line's options."""

    model_config = ConfigDict(extra="forbid")

    really: bool = False
    runs: LocalPath | None = None
    days: float = Field(default=30.0, ge=0)


@dataclass(frozen=True)
class Leftover:
    """Something that may be removed."""

    what: str
    path: Path

    @property
    def size_bytes(self) -> int:
        """Of all its files."""
        return sum(size for size, _ in _files(self.path))

    def remove(self) -> None:
        """Remove it; a file that another process has just removed is no error."""
        if self.path.is_dir():
            shutil.rmtree(self.path, ignore_errors=True)
        else:
            self.path.unlink(missing_ok=True)


def main(arguments: Sequence[str]) -> None:
    """Show what would go, or remove it."""
    options = _options(arguments)
    total_bytes = 0
    for one in list(leftovers(options, time.time())):  # a mistake shows before anything goes
        size_bytes = one.size_bytes
        total_bytes += size_bytes
        print(f"{size_bytes / 1e6:10.1f} MB  {one.what}: {one.path}", flush=True)
        if options.really:
            one.remove()
    end = "removed" if options.really else "would go; mrtask clean really=true removes it"
    print(f"{total_bytes / 1e6:10.1f} MB  {end}")


def leftovers(options: Options, now: float) -> Iterator[Leftover]:
    """Yield what may be removed, as of this Unix time."""
    cache, temporary = default_cache_dir(), Path(tempfile.gettempdir())
    if cache.is_dir():
        yield from (Leftover("cache", path) for path in sorted(cache.iterdir()) if path.name != LOCKS)
    locks = [*(cache / LOCKS).glob("*"), *temporary.glob(f"mrtask-mlflow-{os.getuid()}-*.lock")]
    yield from (Leftover("lock that nobody holds", path) for path in sorted(locks) if not _is_held(path))
    running = _command_lines()
    for path in sorted((temporary / SESSIONS).glob("session_*")):
        if path.is_dir() and not path.is_symlink() and path.stat().st_uid == os.getuid() and path.name not in running:
            yield Leftover("logs of a Ray session that has ended", path)
    if options.runs is not None:
        yield from _old_runs(options.runs, now - options.days * DAY_S)


def _old_runs(folder: Path, before: float) -> Iterator[Leftover]:
    """Yield the runs in the folder to which nothing was written since this Unix time."""
    if not folder.is_dir():
        raise UserError(f"runs={folder}: no such folder")
    for identity in sorted(folder.rglob(IDENTITY)):
        run = identity.parent
        newest = max((written for _, written in _files(run)), default=0.0)
        if newest <= before and not _is_held(run / LOCK):
            yield Leftover(f"run, last written {time.strftime('%Y-%m-%d', time.localtime(newest))}", run)


def _files(path: Path) -> Iterator[tuple[int, float]]:
    """Yield size in bytes and Unix time of the last change of a file, or of all files of a folder."""
    for one in [path, *path.rglob("*")]:
        with suppress(OSError):  # it has just been removed
            status = one.lstat()
            if not one.is_dir():
                yield status.st_size, status.st_mtime


def _is_held(lock: Path) -> bool:
    try:
        with lock.open("r") as handle:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False


def _command_lines() -> str:
    """Return the command lines of all processes: those of Ray name the folder of their session."""
    lines = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            lines.append(" ".join(process.cmdline()))
    return "\n".join(lines)


def _options(arguments: Sequence[str]) -> Options:
    given = tool.overrides(arguments)
    for key in given:
        if key not in Options.model_fields:
            raise UserError(f"{key}: no such key; {suggest(key, list(Options.model_fields))}")
    try:
        return Options.model_validate(given)
    except ValidationError as error:
        raise UserError("\n".join(explain_error(item) for item in error.errors())) from error


if __name__ == "__main__":
    tool.main(main, __doc__)
