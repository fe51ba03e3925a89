"""Compares generated homes with real ones, and likelihood models trained on either, tested on real homes.

The real homes are those of homes=procthor homes.files=[...] or homes=procthor10k; the generated ones are those of
homes=generated with the same seed and numbers. Leaves ``<output_dir>/realism/homes.csv`` and ``transfer.csv``; with
draw=true also a gallery of both.
"""

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from mrtask.analysis.drawing.floor_plans import draw_gallery
from mrtask.analysis.studies.realism import DescribedHome, compare_homes, describe_home
from mrtask.homes.home import Home
from mrtask.likelihood.dataset import Dataset, read_dataset
from mrtask.likelihood.options import TrainingOptions
from mrtask.likelihood.training import score, train_model
from mrtask.maps.home_map import build_map
from pipeline import dataset, homes
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.backends.pool import Pool
from pipeline.base import console, interrupt
from pipeline.base.config import Config, UserError
from pipeline.base.sections import GeneratedHomes, Map, Procthor10kHomes, ProcthorHomes
from pipeline.store.folder import Folder
from pipeline.store.home_files import HouseFiles
from pipeline.store.layout import REALISM
from pipeline.train import preset_options

HOMES_TABLE, TRANSFER_TABLE = "homes.csv", "transfer.csv"
METRICS = ("roc_auc", "log_loss", "best_log_loss")
HOMES_PER_TASK = 10
ROUNDED = "{:.3f}".format
ROUNDED_METRIC = "{:.4f}".format


def run(config: Config, session: Session) -> None:
    """The stage."""
    options = config.homes
    if not isinstance(options, ProcthorHomes | Procthor10kHomes):
        raise UserError(
            f"homes={options.source}: real homes are needed to compare with; give homes=procthor homes.files=[...] "
            "homes.assets=... or homes=procthor10k"
        )
    if options.contents != "procthor":
        raise UserError(
            f"homes.contents={options.contents}: the generator is compared with homes as they come; use procthor"
        )
    generated = GeneratedHomes(
        source="generated",
        contents="procthor",
        seed=options.seed,
        train=options.train,
        validation=options.validation,
        test=config.realism.generated_test,
    )
    target = Folder(config.output_dir) / REALISM
    real_set, generated_set = (
        homes.make(each, config.datasets_dir, session.pool, config.contents) for each in (options, generated)
    )
    compare(generated_set.houses, real_set.houses, config.map, config.seed, target, session.pool)
    if config.draw:
        draw(generated_set.houses, real_set.houses, config.map, config.cache_dir, target)
    if config.realism.models:
        folders = [dataset.build(each, config.datasets_dir, session.pool) for each in (generated_set, real_set)]
        ours, theirs = map(read_dataset, folders)
        options_by_kind: dict[str, TrainingOptions] = {
            kind: preset_options(config, kind) for kind in config.realism.models
        }
        transfer(ours, theirs, options_by_kind, target)


def compare(generated: HouseFiles, real: HouseFiles, map_options: Map, seed: int, target: Folder, pool: Pool) -> None:
    """Writes the table of the distances between generated and real homes."""
    began_s = time.monotonic()
    ours, theirs = generated.read(), real.read()
    console.headline("realism", f"{len(ours)} generated homes against {len(theirs)} real ones")
    described = _describe((*ours, *theirs), map_options, pool)
    table = compare_homes(described[: len(ours)], described[len(ours) :], seed)
    target.write(HOMES_TABLE, table.to_csv(index=False).encode())
    _say(table.to_string(index=False, float_format=ROUNDED, na_rep=""))
    console.result(target / HOMES_TABLE, time.monotonic() - began_s)


def draw(generated: HouseFiles, real: HouseFiles, map_options: Map, cache_dir: Path, target: Folder) -> None:
    """Draws some generated homes beside real ones."""
    columns = {
        title: homes.map_homes(homes.examples(houses.read()), map_options, cache_dir)
        for title, houses in (("generated", generated), ("real", real))
    }
    with tempfile.TemporaryDirectory() as temporary:
        homes.save_figure(draw_gallery(columns), Path(temporary), homes.GALLERY, dpi=100)
        target.upload(Path(temporary))
    console.line(f"-> {target / homes.GALLERY}.png")


def transfer(generated: Dataset, real: Dataset, options: Mapping[str, TrainingOptions], target: Folder) -> None:
    """Writes the metrics on the real test homes: one row per model kind and kind of training homes."""
    began_s, test, rows = time.monotonic(), real.triples("test"), []
    console.headline("transfer", f"models tested on {len(real.manifest.split['test'])} real homes")
    for kind, of_kind in options.items():
        for name, data in (("generated", generated), ("real", real)):
            trained = train_model(data, of_kind, lambda epoch, metrics: interrupt.check())
            metrics = score(trained.model, test)
            rows.append((kind, name, len(data.manifest.split["train"]), *(metrics[metric] for metric in METRICS)))
    table = pd.DataFrame(rows, columns=["model", "trained_on", "training_homes", *METRICS])
    target.write(TRANSFER_TABLE, table.to_csv(index=False).encode())
    _say(table.to_string(index=False, float_format=ROUNDED_METRIC))
    console.result(target / TRANSFER_TABLE, time.monotonic() - began_s)


def _describe(members: Sequence[Home], map_options: Map, pool: Pool) -> list[DescribedHome]:
    chunks = [members[start : start + HOMES_PER_TASK] for start in range(0, len(members), HOMES_PER_TASK)]
    described: dict[int, list[DescribedHome]] = {}
    with console.Progress(len(members), "homes measured") as progress:
        for outcome in pool.run(_describe_chunk, range(len(chunks)), chunks, map_options):
            if outcome is None:
                continue
            if outcome.value is None:
                raise RuntimeError(f"homes could not be measured: {outcome.failure}")
            described[outcome.item] = outcome.value
            progress.update(len(outcome.value))
    return [home for number in range(len(chunks)) for home in described[number]]


def _describe_chunk(number: int, chunks: Sequence[Sequence[Home]], map_options: Map) -> list[DescribedHome]:
    resolution_m, radius_m = map_options.resolution_m, map_options.robot_radius_m
    return [describe_home(home, build_map(home, resolution_m, radius_m)) for home in chunks[number]]


def _say(table: str) -> None:
    for line in table.splitlines():
        console.line(line)


STAGE = Stage(run)

if __name__ == "__main__":
    main("pipeline.realism")
