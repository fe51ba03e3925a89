"""Turns homes into labelled rows: which object types lie in which container types, home by home.

The rows go to ``<datasets_dir>/rows`` as Parquet with a manifest and a data card. They are made again only when homes,
split or code have changed.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd

from mrtask.homes.home import Home
from mrtask.likelihood.dataset import build_dataset, is_current, write_dataset
from mrtask.likelihood.rows import SPLITS, vocabulary
from pipeline import homes
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.backends.pool import Pool
from pipeline.base import console
from pipeline.base.config import Config, content_hash
from pipeline.store.home_set import HomeSet
from pipeline.store.version import code_version, source_hash
from pipeline.store.worker import label_chunk

HOMES_PER_TASK = 25


def run(config: Config, session: Session) -> Path:
    """The stage: the folder of the dataset of the configured homes."""
    return build(homes.run(config, session), config.datasets_dir, session.pool)


def build(home_set: HomeSet, datasets_dir: Path, pool: Pool) -> Path:
    """The folder of these homes' dataset, made unless it is there; raises `DatasetError` where they hold no object."""
    began_s = time.monotonic()
    split = home_set.split
    folder = datasets_dir / "rows" / content_hash([split, source_hash("mrtask/likelihood")])
    console.headline("dataset", "labelled rows (object, container, room)")
    if is_current(folder, split):
        console.skipped(console.shown(folder))
        return folder
    members = home_set.read()
    dataset = build_dataset(
        members,
        source=home_set.manifest.source,
        seed=home_set.manifest.seed,
        code_version=code_version(),
        frames=_label(members, pool),
    )
    write_dataset(dataset, folder)
    counts = dataset.manifest.counts
    for name in SPLITS:
        count = counts[name]
        share = f"{count['positive_share']:.1%} positive"
        console.line(f"{name:10} {count['rows']:9,.0f} rows of {count['homes']:.0f} homes, {share}")
    console.result(console.shown(folder), time.monotonic() - began_s)
    return folder


def _label(members: Mapping[str, Sequence[Home]], pool: Pool) -> Iterator[pd.DataFrame]:
    everyone = [home for split in members.values() for home in split]
    chunks = [everyone[start : start + HOMES_PER_TASK] for start in range(0, len(everyone), HOMES_PER_TASK)]
    with console.Progress(len(everyone), "homes") as progress:
        for outcome in pool.run(label_chunk, range(len(chunks)), chunks, vocabulary(members["train"])):
            if outcome is None:
                continue
            if outcome.value is None:
                raise RuntimeError(f"homes could not be labelled: {outcome.failure}")
            progress.update(len(chunks[outcome.item]))
            yield outcome.value


STAGE = Stage(run)

if __name__ == "__main__":
    main("pipeline.dataset")
