"""Makes or reads the homes and splits them into training, validation and test homes by content."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mrtask.files import sha256_of
from mrtask.homes import procthor, split
from mrtask.homes.download import PROCTHOR_10K, DownloadError, fetch_procthor10k
from mrtask.homes.generator import house
from mrtask.homes.generator.house import write_houses
from mrtask.homes.split import HomeSplit, split_homes
from mrtask.likelihood.rows import SPLITS
from mrtask.names import counted
from mrtask.sources import hash_module
from pipeline.backends.pool import Pool
from pipeline.base import console
from pipeline.base.config import UserError, content_hash
from pipeline.base.sections import (
    GeneratedHomes,
    HousesInFiles,
    Procthor10kHomes,
    ProcthorHomes,
    RosMapHomes,
)
from pipeline.base.specs import HomesSpec
from pipeline.store import artifacts
from pipeline.store.artifacts import NotMade
from pipeline.store.home_files import (
    HouseFiles,
    MapFiles,
    check_files,
    count_by_size_class,
    distinct_layouts,
    say_faults,
)
from pipeline.store.home_set import HomeSet
from pipeline.store.records import GeneratedHousesManifest, HomesManifest
from pipeline.store.version import code_version
from pipeline.store.voted_contents import needs_download, say_match, voted_contents
from pipeline.store.worker import generate_numbered

GENERATED_FILE = "generated.jsonl.gz"
FAULTS_LISTED = 20
PROCTHOR_10K_ASSETS = "asset-database.json"


def make(spec: HomesSpec, pool: Pool | None) -> HomeSet:
    """Return the homes, generated or read and then split, unless that was done before.

    Args:
        pool: generates the homes; with None nothing is made or downloaded.

    Raises:
        NotMade: there is no pool, and the homes are not there yet.
        UserError: a file is missing or a home in it faulty, or there are fewer homes than are asked for.
        MapError: a map cannot be read.
        VotesError: the files of the contents cannot be read.
    """
    began_s, options, datasets_dir = time.monotonic(), spec.homes, spec.datasets_dir
    votes = None
    if options.contents == "housekeep":
        if needs_download(spec.contents, datasets_dir):
            _refuse_in_dry_run(pool)
        votes = voted_contents(spec.contents, datasets_dir)
    maps = _read_maps(options).model_copy(update={"contents": votes}) if isinstance(options, RosMapHomes) else None
    learned_from = options.to_learn_from() if isinstance(options, RosMapHomes) else options
    houses = _houses(learned_from, datasets_dir, pool).model_copy(update={"contents": votes})
    folder = datasets_dir / "homes" / f"{learned_from.source}-{_set_key(learned_from, houses)}"
    if (manifest := artifacts.find_manifest(folder, HomesManifest)) is not None:
        console.skipped(console.shown(folder))
    else:
        _refuse_in_dry_run(pool)
        manifest = artifacts.make(folder, lambda _: _manifest(learned_from, houses))
        say_faults(houses)
        console.line(describe(manifest))
        if votes is not None:
            say_match(votes, [*houses.read(), *(maps.read() if maps else ())])
        console.result(console.shown(folder), time.monotonic() - began_s)
    return HomeSet(folder, manifest, houses, maps)


def outline(spec: HomesSpec) -> str:
    """Return in a line which homes there are, or would be made."""
    try:
        return f"there already: {describe(make(spec, None).manifest)}"
    except NotMade:
        options = spec.homes
        test = "the rest" if options.test is None else options.test
        return (
            f"would make or read {options.source} homes: {options.train} to train on, {options.validation} for early "
            f"stopping, {test} to evaluate on"
        )


def _refuse_in_dry_run(pool: Pool | None) -> Pool:
    """Return the pool where homes must be made or downloaded; raises `NotMade` where no pool is given."""
    if pool is None:
        raise NotMade("the homes are not made yet; python -m pipeline.homes makes them")
    return pool


def _set_key(options: GeneratedHomes | HousesInFiles, houses: HouseFiles) -> str:
    """Return a hash of what decides the set: the content of files and homes, the options, the code."""
    return content_hash(
        [
            options.model_dump(mode="json", exclude={"files", "assets"}),
            sorted(sha256_of(path) for path in houses.paths),
            houses.contents.key() if houses.contents else None,
            hash_module(procthor.__name__),
            hash_module(split.__name__),
        ]
    )


def _houses(options: GeneratedHomes | HousesInFiles, datasets_dir: Path, pool: Pool | None) -> HouseFiles:
    if isinstance(options, GeneratedHomes):
        return _generated(options, datasets_dir, pool)
    if isinstance(options, ProcthorHomes):
        check_files("homes.files", options.files)
        check_files("homes.assets", [options.assets])
        houses = HouseFiles(files=options.files, assets=options.assets, skip_faulty=options.skip_faulty)
    else:
        folder = datasets_dir / "procthor10k"
        if not all((folder / name).is_file() for name in PROCTHOR_10K):
            _refuse_in_dry_run(pool)
        houses = _downloaded(options, folder)
    console.headline("homes", ", ".join(path.name for path in houses.files))
    return houses


def _generated(options: GeneratedHomes, datasets_dir: Path, pool: Pool | None) -> HouseFiles:
    """Return the generator's houses, made unless they are there: they depend only on seed, number and code."""
    console.headline("homes", f"{counted(options.total, 'generated home')}, seed {options.seed}")
    key = content_hash([options.seed, options.total, hash_module(house.__name__)])
    folder = datasets_dir / "generated" / key
    if artifacts.find_manifest(folder, GeneratedHousesManifest) is None:
        maker = _refuse_in_dry_run(pool)
        maker.start()

        def fill(temporary: Path) -> GeneratedHousesManifest:
            houses = write_houses(temporary / GENERATED_FILE, _generate(options.seed, options.total, maker))
            return GeneratedHousesManifest(seed=options.seed, houses=houses, code_version=code_version())

        artifacts.make(folder, fill)
    return HouseFiles(files=(folder / GENERATED_FILE,))


def _generate(seed: int, total: int, pool: Pool) -> Iterator[dict[str, Any]]:
    """Yield the houses in the order of their numbers, in whatever order the workers finish."""
    waiting: dict[int, dict[str, Any]] = {}
    following = 0
    for number, generated in pool.values(generate_numbered, range(total), seed, unit="homes"):
        waiting[number] = generated
        while following in waiting:
            yield waiting.pop(following)
            following += 1


def _downloaded(options: Procthor10kHomes, folder: Path) -> HouseFiles:
    try:
        fetched = fetch_procthor10k(folder, progress=True)
    except DownloadError as error:
        raise UserError(f"homes=procthor10k: {error}") from error
    assets = fetched.pop(PROCTHOR_10K_ASSETS)
    return HouseFiles(files=tuple(fetched.values()), assets=assets, skip_faulty=options.skip_faulty)


def _read_maps(options: RosMapHomes) -> MapFiles:
    """Read the maps, so that mistakes in them are reported before any work."""
    check_files("homes.map", options.map)
    check_files("homes.containers", options.containers)
    maps = MapFiles(maps=options.map, containers=options.containers, worlds=options.worlds, seed=options.seed)
    worlds = maps.read()
    layouts = distinct_layouts(worlds)
    console.headline("maps", ", ".join(scan.home.source for scan in maps.scans()))
    for scan in maps.scans():
        console.text("\n".join(scan.told))
    console.line(f"{len(worlds)} worlds to evaluate on" if len(worlds) > len(layouts) else "contents as listed")
    return maps


def _manifest(options: GeneratedHomes | HousesInFiles, houses: HouseFiles) -> HomesManifest:
    homes, faults = houses.read(), houses.faults()
    # Split before refurnishing, so that a home stays in its part whatever its contents.
    furnished = {home.id: other.id for home, other in zip(houses.as_they_come().read(), homes, strict=True)}
    try:
        parts = split_homes(furnished, options.train, options.validation, options.test, str(options.seed))
    except ValueError as error:
        raise UserError(
            f"homes: {error}; give more homes or lower homes.train, homes.validation, homes.test"
        ) from error
    return HomesManifest(
        source=options.source,
        files=houses.files,
        seed=options.seed,
        code_version=code_version(),
        content_hash=content_hash(sorted(home.id for home in homes)),
        homes=len(homes),
        skipped=len(faults),
        faults=faults[:FAULTS_LISTED],
        by_size_class=count_by_size_class(homes),
        containers=sum(len(home.containers) for home in homes),
        split=HomeSplit(
            **{name: tuple(sorted(furnished[home_id] for home_id in getattr(parts, name))) for name in SPLITS}
        ),
    )


def describe(manifest: HomesManifest) -> str:
    """Return the homes in one line."""
    sizes = ", ".join(f"{count} {name}" for name, count in manifest.by_size_class.items())
    parts = manifest.split
    return (
        f"{counted(manifest.homes, 'home')} ({sizes}), {counted(manifest.containers, 'container')}: "
        f"{len(parts.train)} to train on, {len(parts.validation)} for early stopping, {len(parts.test)} to evaluate on"
    )
