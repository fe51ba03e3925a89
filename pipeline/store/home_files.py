"""Where homes come from: files of houses or of maps, read into homes and checked.

Each kind of file is a frozen model that a record can hold and that reads the same homes again; `HomeFiles` is any.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.homes.procthor import HouseError, read_houses
from mrtask.maps.ros_map import ScannedFloor, map_worlds, scan_floor
from pipeline.base import console
from pipeline.base.config import UserError
from pipeline.base.values import Section
from pipeline.store.voted_contents import VotedContents

SKIP_KEYS = "homes.skip_faulty=true (or evaluation.homes.skip_faulty=true)"


class _Files(Section):
    contents: VotedContents | None = None
    """What the containers hold instead of the contents in the files."""

    @property
    def _contents_paths(self) -> tuple[Path, ...]:
        return self.contents.paths if self.contents else ()


class HouseFiles(_Files):
    """House files in ProcTHOR's schema, with the database of their assets if there is one."""

    kind: Literal["houses"] = "houses"
    files: tuple[Path, ...]
    assets: Path | None = None
    skip_faulty: bool = False

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files that it reads."""
        return (*self.files, *([self.assets] if self.assets else []), *self._contents_paths)

    def read(self) -> tuple[Home, ...]:
        """Return the distinct homes, in the order of the files.

        Raises:
            UserError: a home is faulty and faulty ones are not skipped, or all are faulty.
            HouseError: a file cannot be read to its end.
            VotesError: the contents' files cannot be read.
        """
        return _furnish(self)

    def as_they_come(self) -> "HouseFiles":
        """Return the same homes in the same order, with the contents from the files."""
        return self.model_copy(update={"contents": None})

    def faults(self) -> tuple[str, ...]:
        """Return what is wrong with the homes that were left out."""
        return _read_houses(self.as_they_come())[1]


class MapFiles(_Files):
    """Scanned floors: ROS maps, each with a file that lists its containers."""

    kind: Literal["maps"] = "maps"
    maps: tuple[Path, ...]
    containers: tuple[Path, ...]
    worlds: int
    """How many homes each map gives where its containers' contents are drawn."""
    seed: int

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files that it reads."""
        return (*self.maps, *self.containers, *self._contents_paths)

    def read(self) -> tuple[Home, ...]:
        """Return the distinct worlds of all maps; raises `MapError`."""
        return _furnish(self)

    def scans(self) -> tuple[ScannedFloor, ...]:
        """Return the maps as they were read, with what their owners should know; raises `MapError`."""
        return _scans(self.model_copy(update={"contents": None}))

    def faults(self) -> tuple[str, ...]:
        """Return nothing: a faulty map is an error."""
        return ()


HomeFiles = Annotated[HouseFiles | MapFiles, Field(discriminator="kind")]
"""Either kind, as a field of a record."""


@lru_cache(maxsize=4)
def _furnish(source: HouseFiles | MapFiles) -> tuple[Home, ...]:
    plain = source.model_copy(update={"contents": None})
    homes = _read_houses(plain)[0] if isinstance(plain, HouseFiles) else _read_maps(plain)
    return source.contents.furnish(homes) if source.contents else homes


@lru_cache(maxsize=4)
def _read_houses(source: HouseFiles) -> tuple[tuple[Home, ...], tuple[str, ...]]:
    faults: list[str] = []

    def on_error(error: HouseError) -> None:
        if not source.skip_faulty:
            raise UserError(f"{error}\n{SKIP_KEYS} leaves such homes out and counts them") from error
        faults.append(str(error))

    homes = {home.id: home for home in read_houses(source.files, source.assets, on_error)}
    if not homes:
        raise UserError(f"no home can be used, all {len(faults)} are faulty; the first: {faults[0]}")
    return tuple(homes.values()), tuple(faults)


@lru_cache(maxsize=4)
def _read_maps(source: MapFiles) -> tuple[Home, ...]:
    worlds = [world for scan in source.scans() for world in map_worlds(scan, source.worlds, source.seed)]
    return tuple({home.id: home for home in worlds}.values())


@lru_cache(maxsize=4)
def _scans(source: MapFiles) -> tuple[ScannedFloor, ...]:
    return tuple(scan_floor(*paths) for paths in zip(source.maps, source.containers, strict=True))


def check_files(key: str, paths: Iterable[Path | None]) -> None:
    """Refuse files that do not exist; ``key`` is the configuration key that names them, None stands for no file."""
    for path in paths:
        if path is not None and not path.is_file():
            raise UserError(f"{key}: no such file: {path}")


def say_faults(source: HomeFiles) -> None:
    """Say how many faulty homes were left out, and what is wrong with the first."""
    if faults := source.faults():
        console.line(f"faulty homes left out: {len(faults)}; the first: {faults[0]}")


def count_by_size_class(homes: Sequence[Home]) -> dict[str, int]:
    """Return the number of homes in each size class, small to large."""
    counts = Counter(home.size_class for home in homes)
    return {name: counts[name] for name in SIZE_CLASSES}


def distinct_layouts(homes: Sequence[Home]) -> list[Home]:
    """Return the first home of each layout, in order; homes of one layout differ in their contents."""
    first: dict[str, Home] = {}
    for home in homes:
        first.setdefault(home.layout_id, home)
    return list(first.values())
