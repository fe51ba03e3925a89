"""Turns homes into labelled rows, which object types lie in which container types, and finds them again."""

import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path

import pandas as pd

from mrtask.homes.home import Home
from mrtask.likelihood.dataset import build_dataset, is_current, write_dataset
from mrtask.likelihood.rows import SPLITS, vocabulary
from pipeline.backends.pool import Pool
from pipeline.base import console
from pipeline.base.config import content_hash
from pipeline.store.artifacts import NotMade
from pipeline.store.home_set import HomeSet
from pipeline.store.version import code_version, source_hash
from pipeline.store.worker import label_numbered


def build(home_set: HomeSet, datasets_dir: Path, pool: Pool) -> Path:
    """Return the folder of these homes' dataset, made unless it is there.

    Raises:
        DatasetError: the homes hold no object.
    """
    began_s, folder = time.monotonic(), _folder(home_set, datasets_dir)
    console.headline("dataset", "labelled rows (object, container, room)")
    if is_current(folder, home_set.split):
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
    for name in SPLITS:
        count = dataset.manifest.counts[name]
        share = f"{count['positive_share']:.1%} positive"
        console.line(f"{name:10} {count['rows']:9,.0f} rows of {count['homes']:.0f} homes, {share}")
    console.result(console.shown(folder), time.monotonic() - began_s)
    return folder


def find(home_set: HomeSet, datasets_dir: Path) -> Path:
    """Return the folder of these homes' dataset; raises `NotMade` where it is not there yet."""
    folder = _folder(home_set, datasets_dir)
    if not is_current(folder, home_set.split):
        raise NotMade("the homes are not labelled yet; python -m pipeline.dataset labels them")
    return folder


def _folder(home_set: HomeSet, datasets_dir: Path) -> Path:
    return datasets_dir / "rows" / content_hash([home_set.split, source_hash("mrtask/likelihood")])


def _label(members: Mapping[str, Sequence[Home]], pool: Pool) -> Iterator[pd.DataFrame]:
    everyone = tuple(chain.from_iterable(members.values()))
    objects = vocabulary(members["train"])
    for _, frame in pool.values(label_numbered, range(len(everyone)), everyone, objects, unit="homes"):
        yield frame
