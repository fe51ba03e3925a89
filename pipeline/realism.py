"""Compares generated homes with real ones, and likelihood models trained on either, tested on real homes.

The real homes are those of homes=procthor homes.files=[...] or homes=procthor10k; the generated ones are those of
homes=generated with the same seed and numbers. Leaves ``<output_dir>/realism/homes.csv`` and ``transfer.csv``; with
draw=true also a gallery of both.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.realism")

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from mrtask.analysis.studies.realism import DescribedHome, compare_homes, describe_home
from mrtask.homes.home import Home
from mrtask.likelihood.dataset import Dataset, read_dataset
from mrtask.likelihood.options import TrainingOptions
from mrtask.likelihood.training import score, train_model
from pipeline.app.stage import Session, Stage
from pipeline.backends.pool import Pool
from pipeline.base import console, interrupt
from pipeline.base.config import Config, UserError
from pipeline.base.sections import GeneratedHomes, Homes, Procthor10kHomes, ProcthorHomes
from pipeline.base.specs import HomesSpec, MapOptions
from pipeline.inputs import homes, rows
from pipeline.inputs.floor_plans import draw_side_by_side
from pipeline.inputs.training import preset
from pipeline.store.folder import Folder
from pipeline.store.home_files import HouseFiles
from pipeline.store.layout import REALISM

HOMES_TABLE, TRANSFER_TABLE = "homes.csv", "transfer.csv"
METRICS = ("roc_auc", "log_loss", "best_log_loss")
ROUNDED = "{:.3f}".format
ROUNDED_METRIC = "{:.4f}".format


@dataclass(frozen=True)
class RealismJob:
    """The real homes and the generated ones, how they are mapped, and the options of each kind of model to train."""

    real: HomesSpec
    generated: HomesSpec
    maps: MapOptions
    presets: Mapping[str, TrainingOptions]
    seed: int
    target: Folder
    draw: bool

    def run(self, session: Session) -> None:
        """Compare the homes, and the models trained on either."""
        theirs, ours = (homes.make(each, session.pool) for each in (self.real, self.generated))
        compare(ours.houses, theirs.houses, self.maps, self.seed, self.target, session.pool)
        if self.draw:
            draw_side_by_side({"generated": ours.houses, "real": theirs.houses}, self.maps, self.target)
        if self.presets:
            folders = [rows.build(each, self.real.datasets_dir, session.pool) for each in (ours, theirs)]
            generated, real = map(read_dataset, folders)
            transfer(generated, real, self.presets, self.target)

    def outline(self, session: Session) -> Iterator[str]:
        """Say which homes would be compared, and which models trained."""
        for each in (self.real, self.generated):
            yield f"{each.homes.source} homes: {homes.outline(each)}"
        yield f"would compare them, and train on either: {', '.join(self.presets) or 'nothing'}"


def job(config: Config) -> RealismJob:
    """Return the configured comparison; raises `UserError` where the configured homes are no real ones."""
    spec = config.homes_spec
    return RealismJob(
        real=spec,
        generated=replace(spec, homes=_like(spec.homes, config.realism.generated_test)),
        maps=config.maps,
        presets={kind: preset(config.training_spec, kind) for kind in config.realism.models},
        seed=config.seed,
        target=Folder(config.output_dir) / REALISM,
        draw=config.draw,
    )


def _like(options: Homes, test: int) -> GeneratedHomes:
    """Return generated homes to compare with real ones."""
    if not isinstance(options, ProcthorHomes | Procthor10kHomes):
        raise UserError(
            f"homes={options.source}: real homes are needed to compare with; give homes=procthor homes.files=[...] "
            "homes.assets=... or homes=procthor10k"
        )
    if options.contents != "procthor":
        raise UserError(
            f"homes.contents={options.contents}: the generator is compared with homes as they come; use procthor"
        )
    shared = options.model_dump(include={"contents", "seed", "train", "validation"})
    return GeneratedHomes(source="generated", test=test, **shared)


def compare(generated: HouseFiles, real: HouseFiles, maps: MapOptions, seed: int, target: Folder, pool: Pool) -> None:
    """Write the table of the distances between generated and real homes."""
    began_s = time.monotonic()
    ours, theirs = generated.read(), real.read()
    console.headline("realism", f"{len(ours)} generated homes against {len(theirs)} real ones")
    members = (*ours, *theirs)
    described = dict(pool.values(_describe, range(len(members)), members, maps, unit="homes measured"))
    in_order = [described[number] for number in range(len(members))]
    table = compare_homes(in_order[: len(ours)], in_order[len(ours) :], seed)
    target.write(HOMES_TABLE, table.to_csv(index=False).encode())
    console.text(table.to_string(index=False, float_format=ROUNDED, na_rep=""))
    console.result(target / HOMES_TABLE, time.monotonic() - began_s)


def transfer(generated: Dataset, real: Dataset, options: Mapping[str, TrainingOptions], target: Folder) -> None:
    """Write the metrics on the real test homes: one row per model kind and kind of training homes."""
    began_s, test, found = time.monotonic(), real.triples("test"), []
    console.headline("transfer", f"models tested on {len(real.manifest.split['test'])} real homes")
    for kind, of_kind in options.items():
        for name, data in (("generated", generated), ("real", real)):
            trained = train_model(data, of_kind, lambda epoch, metrics: interrupt.check())
            metrics = score(trained.model, test)
            found.append((kind, name, len(data.manifest.split["train"]), *(metrics[metric] for metric in METRICS)))
    table = pd.DataFrame(found, columns=["model", "trained_on", "training_homes", *METRICS])
    target.write(TRANSFER_TABLE, table.to_csv(index=False).encode())
    console.text(table.to_string(index=False, float_format=ROUNDED_METRIC))
    console.result(target / TRANSFER_TABLE, time.monotonic() - began_s)


def _describe(number: int, members: Sequence[Home], maps: MapOptions) -> DescribedHome:
    return describe_home(members[number], maps.map_of(members[number]))


STAGE = Stage(job)
