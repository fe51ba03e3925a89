"""Checks that this machine has what mrtask needs, and says what to do where it does not.

    make doctor, or mrtask doctor

It needs only Python itself, so that it also runs before anything is installed.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from mrtask.files import default_cache_dir

MIN_PYTHON = (3, 11)
DISK_GB = 5.0
"""The environment and one run of the paper's experiment."""
MEMORY_GB = 4.0
"""Two workers, the driver and MLflow."""
DASHBOARD_PORT = 5000
GIB = 2.0**30


@dataclass(frozen=True)
class Finding:
    """The result of one check; ``advice`` says what to do where it is not ``good``."""

    good: bool
    what: str
    advice: str = ""

    def __str__(self) -> str:
        mark = "ok      " if self.good else "PROBLEM "
        return mark + self.what + ("" if self.good else f"\n        -> {self.advice}")


def findings(folder: Path, cache_dir: Path) -> Iterator[Finding]:
    """Yield the results of all checks, for runs in ``folder``."""
    yield python_version(sys.version_info[:2])
    yield disk(folder, shutil.disk_usage(folder).free / GIB)
    yield memory(available_memory_gb())
    yield cores(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
    yield writable("the cache of maps and compiled kernels", cache_dir, "set MRTASK_CACHE_DIR to another folder")
    yield writable("the folder of runs", folder, "give output_dir=... and datasets_dir=... elsewhere")
    yield writable("shared memory", Path("/dev/shm"), "in a container, start it with --shm-size=2g; Ray needs it")
    yield port(DASHBOARD_PORT)
    yield installed("the library", ("numba", "scipy", "pandas", "shapely"), "make install, or pip install mrtask")
    yield installed(
        "the pipeline", ("hydra", "ray", "mlflow", "torch"), "make install, or pip install 'mrtask[pipeline]'"
    )


def python_version(found: tuple[int, ...]) -> Finding:
    """Check that Python is new enough."""
    text, least = ".".join(map(str, found)), ".".join(map(str, MIN_PYTHON))
    advice = f"Python {least} or newer is needed: make install PYTHON=/path/to/python{least}"
    return Finding(found >= MIN_PYTHON, f"Python {text}", advice)


def disk(folder: Path, free_gb: float) -> Finding:
    """Check that the disk has room."""
    return Finding(
        free_gb >= DISK_GB,
        f"{free_gb:.1f} GB free on the disk of {folder}",
        f"about {DISK_GB:g} GB are needed: make room, or run elsewhere",
    )


def memory(available_gb: float | None) -> Finding:
    """Check that there is memory for a few workers."""
    if available_gb is None:
        return Finding(True, "memory unknown on this system")
    return Finding(
        available_gb >= MEMORY_GB,
        f"{available_gb:.1f} GB of memory available",
        f"{MEMORY_GB:g} GB are recommended: close programs, or use fewer workers (cluster.cpus=1)",
    )


def cores(count: int) -> Finding:
    """Say how many cores may be used."""
    return Finding(True, f"{count} core{'s' if count > 1 else ''}")


def writable(what: str, folder: Path, advice: str) -> Finding:
    """Check that a folder, or the first of its parents that exists, can be written."""
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        return Finding(False, f"{what} cannot be written ({existing}: {error.strerror})", advice)
    return Finding(True, f"{what}: {folder}")


def port(number: int) -> Finding:
    """Check that nothing else listens on the dashboard's port."""
    with socket.socket() as probe:
        taken = probe.connect_ex(("127.0.0.1", number)) == 0
    advice = f'something listens there (an open dashboard?); choose another: make dashboard ARGS="--port {number + 1}"'
    return Finding(not taken, f"port {number} for make dashboard", advice)


def installed(what: str, modules: tuple[str, ...], advice: str) -> Finding:
    """Check that packages can be found."""
    missing = [name for name in modules if find_spec(name) is None]
    return Finding(not missing, f"{what}: {', '.join(missing) + ' missing' if missing else 'installed'}", advice)


def available_memory_gb() -> float | None:
    """Return the free memory, in a container within its limit; None where it cannot be known."""
    bytes_known = []
    with contextlib.suppress(OSError, ValueError, IndexError):
        bytes_known.append(1024 * int(Path("/proc/meminfo").read_text().split("MemAvailable:")[1].split()[0]))
    with contextlib.suppress(OSError, ValueError):  # "max" where there is no limit
        bytes_known.append(int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return min(bytes_known) / GIB if bytes_known else None


def main() -> int:
    """Print all findings; return exit code 1 where there is a problem."""
    checked = list(findings(Path.cwd(), default_cache_dir()))
    for finding in checked:
        print(finding)
    problems = sum(not finding.good for finding in checked)
    print("all is well" if not problems else f"{problems} problem{'s' if problems > 1 else ''}")
    return int(problems > 0)


if __name__ == "__main__":
    sys.exit(main())
