"""A frozen suite: homes, trials, likelihoods and travel lengths in one file, identified by its sha256.

The file holds everything on which a score depends, except the planner, the building of maps and the simulation of
episodes. To guard against changed maps, it also holds the lengths of the ways between all containers. If this version
of mrtask maps a home differently, the suite is refused, because its scores could not be compared with any others.
``benchmarks/freeze_suite.py`` made the file.
"""

import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from mrtask.errors import InputError
from mrtask.execution.trials import Trial
from mrtask.files import replacing, sha256_of
from mrtask.homes.home import Home
from mrtask.likelihood.table import LikelihoodTable
from mrtask.maps.cache import cached_map
from mrtask.maps.home_map import HomeMap

SUITES: Mapping[str, str] = {
    "mrtask-1": "0b3cebd1a3d02c0015d072e0bbe689379966ee4b014fc0db8ba10b3af2fdd3c2",
}
"""The suites that come with the package, with the sha256 of their files."""
DEFAULT_SUITE = "mrtask-1"
LENGTH_TOLERANCE_M = 1e-3
"""Lengths are sums of single-precision steps; the suite stores them in whole millimetres."""
UNREACHABLE = -1
MM_PER_M = 1000.0


class SuiteError(InputError):
    """A suite that is unknown or damaged, or whose homes this version maps differently."""


@dataclass(frozen=True, eq=False)
class Suite:
    """Trials on homes, with the likelihoods that planners receive."""

    name: str
    homes: Mapping[str, Home]
    trials: tuple[Trial, ...]
    table: LikelihoodTable
    travel_mm: Mapping[str, NDArray[np.int64]]
    """The lengths [C, C] of the ways between containers by home id, `UNREACHABLE` if no way exists."""

    def map_of(self, home_id: str, cache_dir: Path | None = None) -> HomeMap:
        """Return the home's map. Raises `SuiteError` if it differs from the map with which the suite was frozen."""
        home_map = cached_map(self.homes[home_id], cache_dir)
        frozen, found = self.travel_mm[home_id], home_map.travel_m
        there = frozen != UNREACHABLE
        same = (np.isfinite(found) == there).all() and np.allclose(
            found[there], frozen[there] / MM_PER_M, rtol=0, atol=LENGTH_TOLERANCE_M
        )
        if not same:
            raise SuiteError(
                f"suite {self.name}: this version of mrtask maps home {home_id} in another way than the suite was "
                "frozen with, so its scores would compare with no others; use the version that the scores are from"
            )
        return home_map


@lru_cache(maxsize=2)
def load_suite(name: str = DEFAULT_SUITE) -> Suite:
    """Return the suite of that name, checked by its sha256."""
    if name not in SUITES:
        raise SuiteError(f"unknown suite {name!r}; allowed: {', '.join(SUITES)}")
    with as_file(files("mrtask.suite").joinpath(f"{name}.json.gz")) as path:
        if not path.is_file() or (found := sha256_of(path)) != SUITES[name]:
            problem = f"has sha256 {found}, not {SUITES[name]}" if path.is_file() else "is missing"
            raise SuiteError(f"suite {name}: {path} {problem}; install mrtask again")
        return read_suite(path)


def read_suite(path: Path) -> Suite:
    """Read a suite's file."""
    raw = json.loads(gzip.decompress(path.read_bytes()))
    homes = TypeAdapter(tuple[Home, ...]).validate_python(raw["homes"])
    probs = np.array(raw["likelihood"]["probs"], dtype=np.float64)
    probs.setflags(write=False)
    kinds = tuple((container, room) for container, room in raw["likelihood"]["kinds"])
    return Suite(
        name=raw["name"],
        homes={home.id: home for home in homes},
        trials=TypeAdapter(tuple[Trial, ...]).validate_python([_with_members(trial) for trial in raw["trials"]]),
        table=LikelihoodTable(kinds, tuple(raw["likelihood"]["objects"]), probs),
        travel_mm={home.id: np.array(lengths) for home, lengths in zip(homes, raw["travel_mm"], strict=True)},
    )


def _with_members(trial: dict[str, Any]) -> dict[str, Any]:
    """Return a trial with its team's members: files from before robots could differ have a number and one kind."""
    team = trial["team"]
    return trial if "members" in team else trial | {"team": {"members": [team["spec"]] * team["robots"]}}


def write_suite(path: Path, name: str, homes: Sequence[Home], trials: Sequence[Trial], table: LikelihoodTable) -> str:
    """Freeze a suite into a file and return its sha256. Equal content gives an equal file."""
    content: dict[str, Any] = {
        "name": name,
        "homes": [asdict(home) for home in homes],
        "trials": [asdict(trial) for trial in trials],
        "likelihood": {"kinds": table.kinds, "objects": table.objects, "probs": table.probs.round(6).tolist()},
        "travel_mm": [_in_mm(cached_map(home, None).travel_m).tolist() for home in homes],
    }
    text = json.dumps(content, separators=(",", ":"))
    with replacing(path) as temporary:
        temporary.write_bytes(gzip.compress(text.encode(), mtime=0))
    return sha256_of(path)


def _in_mm(travel_m: NDArray[np.float64]) -> NDArray[np.int64]:
    reached = np.isfinite(travel_m)
    return np.where(reached, np.round(np.where(reached, travel_m, 0.0) * MM_PER_M), UNREACHABLE).astype(np.int64)
