"""Makes or reads the homes and splits them into training, validation and test homes by content.

Generated homes go to ``<datasets_dir>/homes`` in ProcTHOR's own schema, so that they are read like anybody's. Homes of
your own: homes=procthor homes.files=[a.jsonl.gz,...] homes.assets=asset-database.json. A scanned floor: homes=ros_map
homes.map=lab.yaml homes.containers=containers.yaml. draw=true draws floor plans.
"""

import hashlib
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from mrtask.analysis.floor_plans import draw_gallery, draw_home
from mrtask.execution.trials import key_seed
from mrtask.homes.download import DownloadError, fetch_procthor10k
from mrtask.homes.generator.house import generate_house, write_houses
from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.homes.procthor import HouseError, read_houses
from mrtask.homes.split import split_homes
from mrtask.maps.cache import cached_map
from mrtask.maps.home_map import HomeMap
from mrtask.maps.ros_map import read_map_worlds
from pipeline.app.main import main
from pipeline.backends.pool import Pool
from pipeline.base import console
from pipeline.base.config import (
    Config,
    GeneratedHomes,
    Procthor10kHomes,
    ProcthorHomes,
    RosMapHomes,
    UserError,
    content_hash,
)
from pipeline.store import artifacts
from pipeline.store.folder import Folder
from pipeline.store.version import code_version, source_hash

SPLITS = ("train", "validation", "test")
GENERATED_FILE = "generated.jsonl.gz"
DRAWN_PER_CLASS = 4
GALLERY = "gallery"
FAULTS_LISTED = 20
SKIP_KEYS = "homes.skip_faulty=true (or evaluation.homes.skip_faulty=true)"
GENERATED_KEYS = {"seed", "train", "validation", "test"}
PROCTHOR_10K_ASSETS = "asset-database.json"


@dataclass(frozen=True)
class HouseFiles:
    """House files in ProcTHOR's schema."""

    files: tuple[Path, ...]
    assets: Path | None = None
    skip_faulty: bool = False

    @property
    def paths(self) -> tuple[Path, ...]:
        """Every file that is read."""
        return (*self.files, *([self.assets] if self.assets else []))

    def read(self) -> tuple[Home, ...]:
        """The distinct homes, in order; a faulty one raises `UserError` unless those are skipped."""
        return _read_houses(self)[0]

    def faults(self) -> tuple[str, ...]:
        """What is wrong with the homes that were left out."""
        return _read_houses(self)[1]


@dataclass(frozen=True)
class MapFiles:
    """Scanned floors: ROS maps, each with its file of containers."""

    maps: tuple[Path, ...]
    containers: tuple[Path, ...]
    worlds: int
    seed: int

    @property
    def paths(self) -> tuple[Path, ...]:
        """Every file that is read."""
        return (*self.maps, *self.containers)

    def read(self) -> tuple[Home, ...]:
        """The worlds of all maps; raises `MapError`."""
        return _read_maps(self)

    def faults(self) -> tuple[str, ...]:
        """None: a faulty map is an error."""
        return ()


HomeFiles = HouseFiles | MapFiles


def home_files_facts(where: HomeFiles) -> dict[str, Any]:
    """Plain data for a manifest, from which `home_files` makes the same again."""
    kind = "maps" if isinstance(where, MapFiles) else "houses"
    return {"kind": kind, **{name: _plain(value) for name, value in vars(where).items()}}


def home_files(facts: Mapping[str, Any]) -> HomeFiles:
    """The files of `home_files_facts`."""
    paths = {name: tuple(map(Path, facts[name])) for name in ("files", "maps", "containers") if name in facts}
    if facts["kind"] == "maps":
        return MapFiles(paths["maps"], paths["containers"], facts["worlds"], facts["seed"])
    return HouseFiles(paths["files"], Path(facts["assets"]) if facts["assets"] else None, facts["skip_faulty"])


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [str(item) for item in value]
    return str(value) if isinstance(value, Path) else value


@lru_cache(maxsize=4)
def _read_houses(where: HouseFiles) -> tuple[tuple[Home, ...], tuple[str, ...]]:
    faults: list[str] = []

    def on_error(error: HouseError) -> None:
        if not where.skip_faulty:
            raise UserError(f"{error}\n{SKIP_KEYS} leaves such homes out and counts them") from error
        faults.append(str(error))

    homes = {home.id: home for home in read_houses(where.files, where.assets, on_error)}
    if not homes:
        raise UserError(f"no home can be used, all {len(faults)} are faulty; the first: {faults[0]}")
    return tuple(homes.values()), tuple(faults)


@lru_cache(maxsize=4)
def _read_maps(where: MapFiles) -> tuple[Home, ...]:
    worlds = [
        world
        for map_path, containers_path in zip(where.maps, where.containers, strict=True)
        for world in read_map_worlds(map_path, containers_path, where.worlds, where.seed)
    ]
    return tuple({home.id: home for home in worlds}.values())


@dataclass(frozen=True)
class HomeSet:
    """Homes that the stage has found in order: where they are and which is for what."""

    folder: Path
    houses: HouseFiles
    maps: MapFiles | None = None
    """With homes=ros_map: what the planners are evaluated on in place of the test homes."""

    @property
    def manifest(self) -> dict[str, Any]:
        """Source, seed, counts, content hash and the ids of each split."""
        return artifacts.read_manifest(self.folder)

    def read(self) -> dict[str, tuple[Home, ...]]:
        """The homes by split, each split in the order of its ids."""
        homes = {home.id: home for home in self.houses.read()}
        return {name: tuple(homes[home_id] for home_id in self.manifest["split"][name]) for name in SPLITS}

    def evaluation_homes(self) -> tuple[HomeFiles, tuple[Home, ...]]:
        """The homes to evaluate planners on, and the files that they are from."""
        return (self.maps, self.maps.read()) if self.maps else (self.houses, self.read()["test"])


def run(config: Config, pool: Pool) -> HomeSet:
    """The stage: generates or checks the homes, unless that was done before, and draws some with ``draw=true``."""
    found = prepare(config, pool)
    if config.draw:
        draw(config, found)
    return found


def prepare(config: Config, pool: Pool) -> HomeSet:
    """The homes, generated or checked unless that was done before."""
    options, maps = config.homes, None
    if isinstance(options, RosMapHomes):
        maps = _check_maps(options)
        options = GeneratedHomes(source="generated", **options.model_dump(include=GENERATED_KEYS))
    began_s = time.monotonic()
    inputs = options.model_dump(mode="json", exclude={"files", "assets"}) | {"code": source_hash("mrtask/homes")}
    if isinstance(options, GeneratedHomes):
        total = options.train + options.validation + options.test
        folder = config.datasets_dir / "homes" / f"generated-{content_hash(inputs)}"
        found = HomeSet(folder, HouseFiles((folder / GENERATED_FILE,)), maps)
        console.headline("homes", f"{total} generated homes, seed {options.seed}")
    else:
        files, assets = _given_files(config)
        houses = HouseFiles(files, assets, options.skip_faulty)
        hashes = sorted(_file_hash(path) for path in houses.paths)
        folder = config.datasets_dir / "homes" / f"{options.source}-{content_hash([inputs, hashes])}"
        found = HomeSet(folder, houses)
        console.headline("homes", f"{', '.join(path.name for path in files)}")
    if artifacts.ready(folder):
        console.skipped(shown(folder))
        return found

    def fill(temporary: Path) -> Mapping[str, Any]:
        houses = found.houses
        if isinstance(options, GeneratedHomes):
            write_houses(temporary / GENERATED_FILE, _generate(options.seed, total, pool))
            houses = HouseFiles((temporary / GENERATED_FILE,))
        return _manifest(options, houses)

    artifacts.make(folder, fill)
    say_faults(found.houses)
    console.line(describe(found.manifest))
    console.result(shown(folder), time.monotonic() - began_s)
    return found


def draw(config: Config, found: HomeSet) -> None:
    """Floor plans of some homes of each size class as PNG and SVG, and a gallery of them, in ``<output_dir>/homes``."""
    began_s = time.monotonic()
    target = Folder(config.output_dir) / "homes"
    picked = mapped_examples(config, found.maps or found.houses)
    console.headline("drawing", f"{len(picked)} homes")
    with console.Progress(len(picked), "homes") as progress, tempfile.TemporaryDirectory() as temporary:
        for home, home_map in picked:
            figure = Figure(figsize=(8, 8), layout="constrained")
            draw_home(home, home_map, figure.subplots())
            save_figure(figure, Path(temporary), f"{home.size_class}-{home.id}", dpi=150)
            progress.update()
        save_figure(draw_gallery({config.homes.source: picked}), Path(temporary), GALLERY, dpi=100)
        target.upload(Path(temporary))
    console.result(target, time.monotonic() - began_s)


def mapped_examples(config: Config, where: HomeFiles) -> list[tuple[Home, HomeMap]]:
    """The first few homes of each size class, of different layouts, with their maps."""
    layouts = _layouts(where.read())
    picked = [home for name in SIZE_CLASSES for home in [h for h in layouts if h.size_class == name][:DRAWN_PER_CLASS]]
    cache_dir, options = config.cache_dir / "maps", config.map
    return [(home, cached_map(home, cache_dir, options.resolution_m, options.robot_radius_m)) for home in picked]


def save_figure(figure: Figure, folder: Path, name: str, dpi: int) -> None:
    """Writes a figure as PNG and SVG."""
    for kind in ("png", "svg"):
        figure.savefig(folder / f"{name}.{kind}", dpi=dpi)


def describe(manifest: Mapping[str, Any]) -> str:
    """The homes in one line."""
    sizes = ", ".join(f"{count} {name}" for name, count in manifest["by_size_class"].items())
    split = {name: len(ids) for name, ids in manifest["split"].items()}
    return (
        f"{manifest['homes']} homes ({sizes}), {manifest['containers']} containers: "
        f"{split['train']} to train on, {split['validation']} to stop training by, {split['test']} to evaluate on"
    )


def count_by_size_class(homes: Sequence[Home]) -> dict[str, int]:
    """How many homes of each class, small to large."""
    counts = Counter(home.size_class for home in homes)
    return {name: counts[name] for name in SIZE_CLASSES}


def _layouts(homes: Sequence[Home]) -> list[Home]:
    """The first home of each layout, in order."""
    first: dict[str, Home] = {}
    for home in homes:
        first.setdefault(home.layout_id, home)
    return list(first.values())


def say_faults(where: HomeFiles) -> None:
    """Tells how many faulty homes were left out, and the first of them."""
    if faults := where.faults():
        console.line(f"faulty homes left out: {len(faults)}; the first: {faults[0]}")


def _check_maps(options: RosMapHomes) -> MapFiles:
    """Reads the maps, so that mistakes in them are told before any work."""
    for key, paths in (("homes.map", options.map), ("homes.containers", options.containers)):
        for path in paths:
            if not path.is_file():
                raise UserError(f"{key}: no such file: {path}")
    maps = MapFiles(options.map, options.containers, options.worlds, options.seed)
    worlds = maps.read()
    layouts = _layouts(worlds)
    sizes = ", ".join(
        f"{home.source} ({home.size_class}, {home.area_m2:.0f} m2, {len(home.containers)} containers)"
        for home in layouts
    )
    console.headline("maps", sizes)
    console.line(f"{len(worlds)} worlds to evaluate on" if len(worlds) > len(layouts) else "contents as listed")
    return maps


def _manifest(options: GeneratedHomes | ProcthorHomes | Procthor10kHomes, where: HouseFiles) -> dict[str, Any]:
    homes = where.read()
    try:
        split = split_homes(
            [home.id for home in homes], options.train, options.validation, options.test, str(options.seed)
        )
    except ValueError as error:
        raise UserError(
            f"homes: {error}; give more homes or lower homes.train, homes.validation, homes.test"
        ) from error
    return {
        "source": options.source,
        "files": [str(path) for path in getattr(options, "files", ())],
        "seed": options.seed,
        "code_version": code_version(),
        "content_hash": content_hash(sorted(home.id for home in homes)),
        "homes": len(homes),
        "skipped": len(where.faults()),
        "faults": where.faults()[:FAULTS_LISTED],
        "by_size_class": count_by_size_class(homes),
        "containers": sum(len(home.containers) for home in homes),
        "split": {name: list(getattr(split, name)) for name in SPLITS},
    }


def _generate(seed: int, total: int, pool: Pool) -> Iterator[dict[str, Any]]:
    """The houses in order of their number, whatever order the workers finish in."""
    waiting: dict[int, dict[str, Any]] = {}
    following = 0
    with console.Progress(total, "homes") as progress:
        for outcome in pool.run(_generate_one, range(total), seed):
            if outcome is None:
                continue
            if outcome.failure is not None or outcome.value is None:
                raise RuntimeError(f"home {outcome.item} of seed {seed} could not be generated: {outcome.failure}")
            waiting[outcome.item] = outcome.value
            progress.update()
            while following in waiting:
                yield waiting.pop(following)
                following += 1


def _generate_one(number: int, seed: int) -> dict[str, Any]:
    return generate_house(key_seed(seed, "home", number), SIZE_CLASSES[number % len(SIZE_CLASSES)])


def _given_files(config: Config) -> tuple[tuple[Path, ...], Path | None]:
    options = config.homes
    if isinstance(options, ProcthorHomes):
        check_files(options.files, options.assets, "homes")
        return options.files, options.assets
    try:
        fetched = fetch_procthor10k(config.datasets_dir / "procthor10k", progress=True)
    except DownloadError as error:
        raise UserError(f"homes=procthor10k: {error}") from error
    assets = fetched.pop(PROCTHOR_10K_ASSETS)
    return tuple(fetched.values()), assets


def check_files(files: Sequence[Path], assets: Path | None, key: str) -> None:
    """Refuses files that are not there."""
    for name, path in [*((f"{key}.files", path) for path in files), *([(f"{key}.assets", assets)] if assets else [])]:
        if not path.is_file():
            raise UserError(f"{name}: no such file: {path}")


def _file_hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def shown(folder: Path) -> Path:
    """A path as a person in this folder would type it."""
    return folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder


if __name__ == "__main__":
    main("pipeline.homes")
