"""Makes or reads the homes and splits them into training, validation and test homes by content.

Generated homes go to ``<datasets_dir>/generated`` in ProcTHOR's own schema and are read like anybody's. Homes of your
own: homes=procthor homes.files=[a.jsonl.gz,...] homes.assets=asset-database.json. A scanned floor: homes=ros_map
homes.map=lab.yaml homes.containers=containers.yaml. draw=true draws floor plans. homes.contents=housekeep refurnishes
any of them with what people put where.
"""

import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from mrtask.analysis.drawing.floor_plans import draw_gallery, draw_home
from mrtask.files import sha256_of
from mrtask.homes import procthor, split
from mrtask.homes.download import DownloadError, fetch_procthor10k
from mrtask.homes.generator import house
from mrtask.homes.generator.house import write_houses
from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.homes.split import HomeSplit, split_homes
from mrtask.likelihood.rows import SPLITS
from mrtask.maps.cache import cached_map
from mrtask.maps.home_map import HomeMap
from mrtask.sources import hash_module
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.backends.pool import Pool
from pipeline.base import console
from pipeline.base.config import Config, UserError, content_hash
from pipeline.base.sections import (
    Contents,
    GeneratedHomes,
    Homes,
    HousesInFiles,
    Map,
    Procthor10kHomes,
    ProcthorHomes,
    RosMapHomes,
)
from pipeline.store import artifacts
from pipeline.store.folder import Folder
from pipeline.store.home_files import (
    HomeSource,
    HouseFiles,
    MapFiles,
    check_files,
    count_by_size_class,
    distinct_layouts,
    say_faults,
)
from pipeline.store.home_set import HomeSet
from pipeline.store.layout import HOMES
from pipeline.store.records import GeneratedHousesManifest, HomesManifest
from pipeline.store.version import code_version
from pipeline.store.voted_contents import say_match, voted_contents
from pipeline.store.worker import generate_numbered

GENERATED_FILE = "generated.jsonl.gz"
DRAWN_PER_CLASS = 4
GALLERY = "gallery"
FAULTS_LISTED = 20
PROCTHOR_10K_ASSETS = "asset-database.json"


def run(config: Config, session: Session) -> HomeSet:
    """The stage: the homes, and with ``draw=true`` floor plans of some in ``<output_dir>/homes``."""
    home_set = make(config.homes, config.datasets_dir, session.pool, config.contents)
    if config.draw:
        drawn = home_set.instead_of_test or home_set.houses
        draw(drawn, config.homes.source, config.map, config.cache_dir, Folder(config.output_dir) / HOMES)
    return home_set


def make(options: Homes, datasets_dir: Path, pool: Pool, contents: Contents) -> HomeSet:
    """The homes, generated or read and then split, unless that was done before.

    Raises:
        UserError: a file is missing or a home in it faulty, or there are fewer homes than are asked for.
        MapError: a map cannot be read.
        VotesError: the files of the contents cannot be read.
    """
    began_s = time.monotonic()
    held = {"contents": voted_contents(contents, datasets_dir) if options.contents == "housekeep" else None}
    maps = None
    if isinstance(options, RosMapHomes):
        maps = _read_maps(options).model_copy(update=held)
        options = options.to_learn_from()
    houses = _houses(options, datasets_dir, pool).model_copy(update=held)
    folder = datasets_dir / "homes" / f"{options.source}-{_set_key(options, houses)}"
    if (manifest := artifacts.find_manifest(folder, HomesManifest)) is not None:
        console.skipped(console.shown(folder))
    else:
        manifest = artifacts.make(folder, lambda _: _manifest(options, houses))
        say_faults(houses)
        console.line(describe(manifest))
        if houses.contents is not None:
            say_match(houses.contents, [*houses.read(), *(maps.read() if maps else ())])
        console.result(console.shown(folder), time.monotonic() - began_s)
    return HomeSet(folder, manifest, houses, maps)


def _set_key(options: GeneratedHomes | HousesInFiles, houses: HouseFiles) -> str:
    """What decides which homes there are and how they are split: the files' and homes' contents, options and code."""
    return content_hash(
        [
            options.model_dump(mode="json", exclude={"files", "assets"}),
            sorted(sha256_of(path) for path in houses.paths),
            houses.contents.key() if houses.contents else None,
            hash_module(procthor.__name__),
            hash_module(split.__name__),
        ]
    )


def _houses(options: GeneratedHomes | HousesInFiles, datasets_dir: Path, pool: Pool) -> HouseFiles:
    if isinstance(options, GeneratedHomes):
        return _generated(options, datasets_dir, pool)
    if isinstance(options, ProcthorHomes):
        check_files("homes.files", options.files)
        check_files("homes.assets", [options.assets])
        houses = HouseFiles(files=options.files, assets=options.assets, skip_faulty=options.skip_faulty)
    else:
        houses = _downloaded(options, datasets_dir)
    console.headline("homes", ", ".join(path.name for path in houses.files))
    return houses


def _generated(options: GeneratedHomes, datasets_dir: Path, pool: Pool) -> HouseFiles:
    """The generator's houses, made unless they are there: they depend on the seed, their number and its code only."""
    console.headline("homes", f"{options.total} generated homes, seed {options.seed}")
    key = content_hash([options.seed, options.total, hash_module(house.__name__)])
    folder = datasets_dir / "generated" / key
    if artifacts.find_manifest(folder, GeneratedHousesManifest) is None:

        def fill(temporary: Path) -> GeneratedHousesManifest:
            houses = write_houses(temporary / GENERATED_FILE, _generate(options.seed, options.total, pool))
            return GeneratedHousesManifest(seed=options.seed, houses=houses, code_version=code_version())

        artifacts.make(folder, fill)
    return HouseFiles(files=(folder / GENERATED_FILE,))


def _generate(seed: int, total: int, pool: Pool) -> Iterator[dict[str, Any]]:
    """The houses in order of their number, whatever order the workers finish in."""
    waiting: dict[int, dict[str, Any]] = {}
    following = 0
    with console.Progress(total, "homes") as progress:
        for outcome in pool.run(generate_numbered, range(total), seed):
            if outcome is None:
                continue
            if outcome.failure is not None or outcome.value is None:
                raise RuntimeError(f"home {outcome.item} of seed {seed} could not be generated: {outcome.failure}")
            waiting[outcome.item] = outcome.value
            progress.update()
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
    """Reads the maps, so that mistakes in them are reported before any work."""
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
    # Split as they come, so that a home stays in its part whatever it is furnished with.
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
    """The homes in one line."""
    sizes = ", ".join(f"{count} {name}" for name, count in manifest.by_size_class.items())
    parts = manifest.split
    return (
        f"{manifest.homes} homes ({sizes}), {manifest.containers} containers: {len(parts.train)} to train on, "
        f"{len(parts.validation)} to stop training by, {len(parts.test)} to evaluate on"
    )


def draw(source: HomeSource, title: str, options: Map, cache_dir: Path, target: Folder) -> None:
    """Floor plans of some homes of each size class as PNG and SVG, and a gallery of them called ``title``."""
    began_s = time.monotonic()
    mapped = map_homes(examples(source.read()), options, cache_dir)
    console.headline("drawing", f"{len(mapped)} homes")
    with console.Progress(len(mapped), "homes") as progress, tempfile.TemporaryDirectory() as temporary:
        for home, home_map in mapped:
            figure = Figure(figsize=(8, 8), layout="constrained")
            draw_home(home, home_map, figure.subplots())
            save_figure(figure, Path(temporary), f"{home.size_class}-{home.id}", dpi=150)
            progress.update()
        save_figure(draw_gallery({title: mapped}), Path(temporary), GALLERY, dpi=100)
        target.upload(Path(temporary))
    console.result(target, time.monotonic() - began_s)


def examples(homes: Sequence[Home]) -> list[Home]:
    """The first few homes of each size class, each of another layout."""
    layouts = distinct_layouts(homes)
    return [home for name in SIZE_CLASSES for home in [h for h in layouts if h.size_class == name][:DRAWN_PER_CLASS]]


def map_homes(homes: Sequence[Home], options: Map, cache_dir: Path) -> list[tuple[Home, HomeMap]]:
    """The homes with their maps, from the cache where they are there."""
    resolution_m, radius_m = options.resolution_m, options.robot_radius_m
    return [(home, cached_map(home, cache_dir / "maps", resolution_m, radius_m)) for home in homes]


def save_figure(figure: Figure, folder: Path, name: str, dpi: int) -> None:
    """Writes a figure as PNG and SVG."""
    for kind in ("png", "svg"):
        figure.savefig(folder / f"{name}.{kind}", dpi=dpi)


STAGE = Stage(run)

if __name__ == "__main__":
    main("pipeline.homes")
