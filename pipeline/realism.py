"""Compares generated homes with real ones, and likelihood models trained on either, tested on real homes.

The real homes are those of homes=procthor homes.files=[...] or homes=procthor10k; the generated ones are those of
homes=generated with the same seed and numbers. Leaves ``<output_dir>/realism/homes.csv`` and ``transfer.csv``; with
draw=true also a gallery of both.
"""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
from omegaconf import OmegaConf

from mrtask.analysis.floor_plans import draw_gallery
from mrtask.analysis.realism import DescribedHome, compare_homes, describe_home
from mrtask.homes.home import Home
from mrtask.likelihood.dataset import Dataset, read_dataset
from mrtask.likelihood.training import score, train_model
from mrtask.maps.home_map import build_map
from pipeline import dataset, homes
from pipeline.app.main import CONF_DIR, main
from pipeline.backends.pool import Pool
from pipeline.base import console, interrupt
from pipeline.base.config import Config, GeneratedHomes, Map, Procthor10kHomes, ProcthorHomes, UserError
from pipeline.store.folder import Folder
from pipeline.train import training_options

FOLDER = "realism"
HOMES_TABLE, TRANSFER_TABLE = "homes.csv", "transfer.csv"
METRICS = ("roc_auc", "log_loss", "best_log_loss")
HOMES_PER_TASK = 10
ROUNDED = "{:.3f}".format
ROUNDED_METRIC = "{:.4f}".format


def run(config: Config, pool: Pool) -> None:
    """The stage."""
    options, began_s = config.homes, time.monotonic()
    if not isinstance(options, ProcthorHomes | Procthor10kHomes):
        raise UserError(
            f"homes={options.source}: real homes are needed to compare with; give homes=procthor homes.files=[...] "
            "homes.assets=... or homes=procthor10k"
        )
    generated = GeneratedHomes(
        source="generated",
        seed=options.seed,
        train=options.train,
        validation=options.validation,
        test=config.realism.generated_test,
    )
    target = Folder(config.output_dir) / FOLDER
    real_config, generated_config = config, config.model_copy(update={"homes": generated})
    real_set, generated_set = (homes.prepare(each, pool) for each in (real_config, generated_config))
    real, ours = real_set.houses.read(), generated_set.houses.read()
    console.headline("realism", f"{len(ours)} generated homes against {len(real)} real ones")
    described = _describe((*ours, *real), config.map, pool)
    table = compare_homes(described[: len(ours)], described[len(ours) :], config.seed)
    target.write(HOMES_TABLE, table.to_csv(index=False).encode())
    _say(table.to_string(index=False, float_format=ROUNDED, na_rep=""))
    console.result(target / HOMES_TABLE, time.monotonic() - began_s)
    if config.draw:
        blocks = {"generated": generated_set.houses, "real": real_set.houses}
        with tempfile.TemporaryDirectory() as temporary:
            figure = draw_gallery({title: homes.mapped_examples(config, where) for title, where in blocks.items()})
            homes.save_figure(figure, Path(temporary), homes.GALLERY, dpi=100)
            target.upload(Path(temporary))
        console.line(f"-> {target / homes.GALLERY}.png")
    if config.realism.models:
        began_s = time.monotonic()
        rows = [
            read_dataset(dataset.build(each, pool, home_set))
            for each, home_set in ((generated_config, generated_set), (real_config, real_set))
        ]
        console.headline("transfer", f"models tested on {len(real_set.manifest['split']['test'])} real homes")
        transfer = _transfer(config, *rows)
        target.write(TRANSFER_TABLE, transfer.to_csv(index=False).encode())
        _say(transfer.to_string(index=False, float_format=ROUNDED_METRIC))
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


def _transfer(config: Config, generated: Dataset, real: Dataset) -> pd.DataFrame:
    """One row per model and kind of training homes: metrics on the real test homes."""
    test, rows = real.triples("test"), []
    for kind in config.realism.models:
        model = config.model.model_copy(update={"kind": kind, **_layers(kind)})
        options = replace(training_options(config.model_copy(update={"model": model})), checkpoint_dir=None)
        for name, data in (("generated", generated), ("real", real)):
            trained = train_model(data, options, lambda epoch, metrics: interrupt.check())
            metrics = score(trained.model, test)
            rows.append((kind, name, len(data.manifest.split["train"]), *(metrics[metric] for metric in METRICS)))
    return pd.DataFrame(rows, columns=["model", "trained_on", "training_homes", *METRICS])


def _layers(kind: str) -> dict[str, tuple[int, ...]]:
    """The layers that the model's own preset names, if any."""
    preset = OmegaConf.to_container(OmegaConf.load(CONF_DIR / "model" / f"{kind}.yaml"))
    return {"layers": tuple(preset["layers"])} if isinstance(preset, dict) and "layers" in preset else {}


def _say(table: str) -> None:
    for line in table.splitlines():
        console.line(line)


if __name__ == "__main__":
    main("pipeline.realism")
