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
from mrtask.sources import hash_module
from pipeline.backends.pool import Pool
from pipeline.base import console
from pipeline.base.config import UserError, content_hash
from pipeline.base.sections import (
    Contents,
    GeneratedHomes,
    Homes,
    HousesInFiles,
    Procthor10kHomes,
    ProcthorHomes,
    RosMapHomes,
)
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
from pipeline.store.voted_contents import VotedContents, needs_download, say_match, voted_contents
from pipeline.store.worker import generate_numbered

GENERATED_FILE = "generated.jsonl.gz"
FAULTS_LISTED = 20
PROCTHOR_10K_ASSETS = "asset-database.json"
_NOT_MADE = "the homes are not made yet; python -m pipeline.homes makes them"


def make(options: Homes, datasets_dir: Path, pool: Pool, contents: Contents) -> HomeSet:
    """Return the homes, generated or read and then split, unless that was done before.

    Raises:
        UserError: a file is missing or a home in it faulty, or there are fewer homes than are asked for.
        MapError: a map cannot be read.
        VotesError: the files of the contents cannot be read.
    """
    began_s = time.monotonic()
    votes = _voted(options, contents, datasets_dir)
    maps = _maps(options, votes)
    learned_from = _learned_from(options)
    if isinstance(learned_from, GeneratedHomes):
        houses = _generated(learned_from, datasets_dir, pool)
    else:
        houses = _in_files(learned_from, datasets_dir)
    houses = houses.model_copy(update={"contents": votes})
    folder = _folder(learned_from, houses, datasets_dir)
    if (manifest := artifacts.find_manifest(folder, HomesManifest)) is not None:
        console.skipped(console.shown(folder))
    else:
        manifest = artifacts.make(folder, lambda _: _manifest(learned_from, houses))
        say_faults(houses)
        console.line(describe(manifest))
        if votes is not None:
            say_match(votes, [*houses.read(), *(maps.read() if maps else ())])
        console.result(console.shown(folder), time.monotonic() - began_s)
    return HomeSet(folder, manifest, houses, maps)


def find(options: Homes, datasets_dir: Path, contents: Contents) -> HomeSet:
    """Return the homes without making or downloading anything.

    Raises:
        NotMade: they are not there yet.
        UserError: as `make` does.
    """
    learned_from = _learned_from(options)
    if options.contents == "housekeep" and needs_download(contents, datasets_dir):
        raise NotMade(_NOT_MADE)
    if isinstance(learned_from, GeneratedHomes):
        generated = _generated_folder(learned_from, datasets_dir)
        if artifacts.find_manifest(generated, GeneratedHousesManifest) is None:
            raise NotMade(_NOT_MADE)
        houses = HouseFiles(files=(generated / GENERATED_FILE,))
    else:
        if not isinstance(learned_from, ProcthorHomes) and not all(
            (datasets_dir / "procthor10k" / name).is_file() for name in PROCTHOR_10K
        ):
            raise NotMade(_NOT_MADE)
        houses = _in_files(learned_from, datasets_dir)
    votes = _voted(options, contents, datasets_dir)
    houses = houses.model_copy(update={"contents": votes})
    folder = _folder(learned_from, houses, datasets_dir)
    if (manifest := artifacts.find_manifest(folder, HomesManifest)) is None:
        raise NotMade(_NOT_MADE)
    return HomeSet(folder, manifest, houses, _maps(options, votes))


def outline(options: Homes, datasets_dir: Path, contents: Contents) -> str:
    """Return in a line which homes there are, or would be made."""
    try:
        return f"there already: {describe(find(options, datasets_dir, contents).manifest)}"
    except NotMade:
        test = "the rest" if options.test is None else options.test
        return (
            f"would make or read {options.source} homes: {options.train} to train on, {options.validation} for early "
            f"stopping, {test} to evaluate on"
        )


def _learned_from(options: Homes) -> GeneratedHomes | HousesInFiles:
    return options.to_learn_from() if isinstance(options, RosMapHomes) else options


def _voted(options: Homes, contents: Contents, datasets_dir: Path) -> VotedContents | None:
    return voted_contents(contents, datasets_dir) if options.contents == "housekeep" else None


def _maps(options: Homes, votes: VotedContents | None) -> MapFiles | None:
    return _read_maps(options).model_copy(update={"contents": votes}) if isinstance(options, RosMapHomes) else None


def _folder(options: GeneratedHomes | HousesInFiles, houses: HouseFiles, datasets_dir: Path) -> Path:
    """Return the folder named by what decides the set: the content of files and homes, the options, the code."""
    key = [
        options.model_dump(mode="json", exclude={"files", "assets"}),
        sorted(sha256_of(path) for path in houses.paths),
        houses.contents.key() if houses.contents else None,
        hash_module(procthor.__name__),
        hash_module(split.__name__),
    ]
    return datasets_dir / "homes" / f"{options.source}-{content_hash(key)}"


def _in_files(options: HousesInFiles, datasets_dir: Path) -> HouseFiles:
    if isinstance(options, ProcthorHomes):
        check_files("homes.files", options.files)
        check_files("homes.assets", [options.assets])
        houses = HouseFiles(files=options.files, assets=options.assets, skip_faulty=options.skip_faulty)
    else:
        houses = _downloaded(options, datasets_dir)
    console.headline("homes", ", ".join(path.name for path in houses.files))
    return houses


def _generated_folder(options: GeneratedHomes, datasets_dir: Path) -> Path:
    """Return the folder named by all that generated houses depend on: the seed, their number and the code."""
    key = content_hash([options.seed, options.total, hash_module(house.__name__)])
    return datasets_dir / "generated" / key


def _generated(options: GeneratedHomes, datasets_dir: Path, pool: Pool) -> HouseFiles:
    console.headline("homes", f"{options.total} generated homes, seed {options.seed}")
    folder = _generated_folder(options, datasets_dir)
    if artifacts.find_manifest(folder, GeneratedHousesManifest) is None:

        def fill(temporary: Path) -> GeneratedHousesManifest:
            houses = write_houses(temporary / GENERATED_FILE, _generate(options.seed, options.total, pool))
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


def _downloaded(options: Procthor10kHomes, datasets_dir: Path) -> HouseFiles:
    try:
        fetched = fetch_procthor10k(datasets_dir / "procthor10k", progress=True)
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
    sizes = ", ".join(
        f"{home.source} ({home.size_class}, {home.area_m2:.0f} m2, {len(home.containers)} containers)"
        for home in layouts
    )
    console.headline("maps", sizes)
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
        f"{manifest.homes} homes ({sizes}), {manifest.containers} containers: {len(parts.train)} to train on, "
        f"{len(parts.validation)} for early stopping, {len(parts.test)} to evaluate on"
    )
