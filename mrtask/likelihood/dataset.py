"""The dataset on disk: ``rows.parquet``, ``manifest.json`` and a data card, checked whenever written or read.

Homes, not rows, are split into train, validation and test, so that no home is in two splits. The vocabulary is that of
the training homes. The manifest is written last and holds the hash of the rows. A folder whose manifest does not match
its rows is refused.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pandera.pandas as pa

from mrtask.errors import InputError
from mrtask.files import replacing
from mrtask.homes.home import Home
from mrtask.likelihood.rows import ROW_SCHEMA, SPLITS, distinct_triples, label_rows, vocabulary

FORMAT_VERSION = 1
ROWS_FILE, MANIFEST_FILE, CARD_FILE = "rows.parquet", "manifest.json", "README.md"


class DatasetError(InputError):
    """A dataset that is missing, damaged, or different from what its manifest says."""


@dataclass(frozen=True)
class Manifest:
    """What a dataset is and where it came from.

    ``inputs_hash`` depends only on the homes and their split (see ``inputs_hash()``); if it is equal, a rebuild is
    unnecessary. ``content_hash`` is the hash of the rows. ``counts`` holds, per split, ``homes, containers, rows,
    positives, positive_share``.
    """

    source: str
    seed: int
    code_version: str
    inputs_hash: str
    content_hash: str
    vocabulary: tuple[str, ...]
    split: Mapping[str, tuple[str, ...]]
    counts: Mapping[str, Mapping[str, float]]
    format_version: int = FORMAT_VERSION


@dataclass(frozen=True, eq=False)
class Dataset:
    """Labelled rows (``rows.ROW_SCHEMA``) and their manifest."""

    rows: pd.DataFrame
    manifest: Manifest
    _triples: dict[str, pd.DataFrame] = field(default_factory=dict, repr=False)

    def triples(self, split: str) -> pd.DataFrame:
        """Return the distinct triples of one split with ``positives`` and ``count``."""
        if split not in SPLITS:
            raise ValueError(f"unknown split {split!r}; allowed: {', '.join(SPLITS)}")
        if split not in self._triples:
            self._triples[split] = distinct_triples(self.rows[self.rows["split"] == split])
        return self._triples[split]


def inputs_hash(split: Mapping[str, Sequence[str]]) -> str:
    """Return the hash of the homes' content and split; ``split`` maps train, validation, test to home ids (hashes)."""
    content = {name: sorted(split.get(name, ())) for name in SPLITS}
    return hashlib.sha256(json.dumps([FORMAT_VERSION, content]).encode()).hexdigest()


def build_dataset(
    homes: Mapping[str, Sequence[Home]],
    *,
    source: str,
    seed: int,
    code_version: str,
    frames: Iterable[pd.DataFrame] | None = None,
) -> Dataset:
    """Build the dataset of homes given by split (``train`` is required; ``validation`` and ``test`` may be empty).

    ``frames`` are the ``label_rows`` of all homes, in any order, for callers that made them in parallel. Raises
    ``DatasetError`` if no home is for training, the training homes hold no object, or a home is in two splits.
    """
    unknown = set(homes) - set(SPLITS)
    if unknown:
        raise DatasetError(f"unknown split {', '.join(sorted(unknown))}; allowed: {', '.join(SPLITS)}")
    homes = {name: list({home.id: home for home in homes.get(name, ())}.values()) for name in SPLITS}
    split = {name: tuple(sorted(home.id for home in homes[name])) for name in SPLITS}
    if not split["train"]:
        raise DatasetError("no training homes: give at least one")
    side: dict[str, str] = {}
    for name, ids in split.items():
        for home_id in ids:
            if home_id in side:
                raise DatasetError(f"home {home_id} is in {side[home_id]} and in {name}: give each home to one split")
            side[home_id] = name
    objects = vocabulary(homes["train"])
    if not objects:
        raise DatasetError("the training homes' containers hold no objects: there is nothing to learn from")
    if frames is None:
        frames = (label_rows(home, objects) for name in SPLITS for home in homes[name])
    rows = pd.concat(frames, ignore_index=True)
    rows["split"] = rows["home_id"].map(side).astype("str")
    order = np.lexsort([rows[key].to_numpy() for key in ("object", "container_id", "home_id")])
    rows = _checked(rows.iloc[order].reset_index(drop=True))
    manifest = Manifest(
        source=source,
        seed=seed,
        code_version=code_version,
        inputs_hash=inputs_hash(split),
        content_hash=_content_hash(rows),
        vocabulary=objects,
        split=split,
        counts={name: _counts(rows[rows["split"] == name]) for name in SPLITS},
    )
    return Dataset(rows, manifest)


def write_dataset(dataset: Dataset, folder: Path) -> None:
    """Write rows, data card and, last, the manifest. Each file appears whole or not at all."""
    rows = _checked(dataset.rows)
    with replacing(folder / ROWS_FILE) as path:
        rows.to_parquet(path, index=False, compression="zstd")
    with replacing(folder / CARD_FILE) as path:
        path.write_text(data_card(dataset.manifest), encoding="utf-8")
    with replacing(folder / MANIFEST_FILE) as path:
        path.write_text(json.dumps(asdict(dataset.manifest), indent=1), encoding="utf-8")


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest alone (cheap). Raises ``DatasetError`` if it is missing or has another format."""
    path = folder / MANIFEST_FILE
    if not path.is_file():
        raise DatasetError(f"no dataset in {folder} ({MANIFEST_FILE} is missing): run mrtask dataset")
    try:
        raw: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        version = raw["format_version"]
        if version != FORMAT_VERSION:
            raise DatasetError(f"{path}: format version {version}, this code reads {FORMAT_VERSION}: rebuild it")
        raw["vocabulary"] = tuple(raw["vocabulary"])
        raw["split"] = {name: tuple(ids) for name, ids in raw["split"].items()}
        return Manifest(**raw)
    except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError, AttributeError) as error:
        raise DatasetError(f"{path} is not a dataset manifest ({error}): delete the folder and rebuild it") from error


def read_dataset(folder: Path) -> Dataset:
    """Read the dataset of a folder, and check its rows against the schema and the manifest's hash."""
    manifest = read_manifest(folder)
    path = folder / ROWS_FILE
    try:
        rows = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path} cannot be read ({error}); delete the folder and rebuild the dataset") from error
    rows = _checked(rows)
    if _content_hash(rows) != manifest.content_hash:
        raise DatasetError(f"{path} is not what {MANIFEST_FILE} says; delete the folder and rebuild the dataset")
    return Dataset(rows, manifest)


def is_current(folder: Path, split: Mapping[str, Sequence[str]]) -> bool:
    """Return whether the folder holds the dataset of exactly these homes (ids by split)."""
    try:
        return (folder / ROWS_FILE).is_file() and read_manifest(folder).inputs_hash == inputs_hash(split)
    except DatasetError:
        return False


def data_card(manifest: Manifest) -> str:
    """Return a short description for people, in Markdown."""
    lines = [
        "# Labelled rows: which object types lie in which containers",
        "",
        f"Source `{manifest.source}`, seed {manifest.seed}, code `{manifest.code_version}`.",
        f"Content hash `{manifest.content_hash}`.",
        "",
        f"One row per home, container and object type of the training vocabulary ({len(manifest.vocabulary)} types);",
        "`label` is 1 if the container holds at least one object of the type. Homes, not rows, are split.",
        "",
        "| split | homes | containers | rows | positives | share |",
        "|---|---|---|---|---|---|",
    ]
    for name in SPLITS:
        n = manifest.counts[name]
        lines.append(
            f"| {name} | {n['homes']:.0f} | {n['containers']:.0f} | {n['rows']:.0f} | {n['positives']:.0f} "
            f"| {n['positive_share']:.4f} |"
        )
    lines += [
        "",
        "Limits: only object types that occur in the training homes are asked about; how many objects of a type a",
        "container holds is not recorded; labels within a home depend on each other (a home has few televisions),",
        "which no model of single triples sees.",
        "",
        f"Object types: {', '.join(manifest.vocabulary)}.",
        "",
    ]
    return "\n".join(lines)


def _counts(rows: pd.DataFrame) -> dict[str, float]:
    positives = int(rows["label"].sum())
    return {
        "homes": int(rows["home_id"].nunique()),
        "containers": len(rows[["home_id", "container_id"]].drop_duplicates()),
        "rows": len(rows),
        "positives": positives,
        "positive_share": positives / len(rows) if len(rows) else 0.0,
    }


def _checked(rows: pd.DataFrame) -> pd.DataFrame:
    try:
        return ROW_SCHEMA.validate(rows)
    except pa.errors.SchemaError as error:
        raise DatasetError(f"the dataset's rows do not match their schema: {error}") from error


def _content_hash(rows: pd.DataFrame) -> str:
    values = pd.util.hash_pandas_object(rows, index=False).to_numpy()
    return hashlib.sha256(values.tobytes()).hexdigest()
