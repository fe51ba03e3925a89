"""The interface between likelihood models and their users (names in, probabilities out), and how a model is stored.

A stored model is a folder with ``model.json`` (its ``kind``, options and the sha256 of every other file) and plain data
files (safetensors, CSV). It contains no code, so loading one runs none.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mrtask.arrays import Floats
from mrtask.errors import InputError
from mrtask.files import replacing, sha256_of
from mrtask.likelihood.rows import TRIPLE

FORMAT_VERSION = 1
DESCRIPTION_FILE = "model.json"
COUNTS_FILE = "counts.csv"
PROB_FLOOR = 1e-6
"""No model is closer to certainty than this, so that the log loss and a belief's normalisation stay finite."""


class LikelihoodModel(Protocol):
    """``P(object is in the container)`` from the names of object type, container type and room type."""

    @property
    def kind(self) -> str:
        """Return the model's name in `mrtask.likelihood.kinds.KINDS`."""
        ...

    def predict(self, names: pd.DataFrame) -> Floats:
        """Return probabilities ``[N]`` in (0, 1) for a frame with the columns ``object``, ``container``, ``room``."""
        ...

    def save(self, folder: Path) -> None:
        """Write the model to a new or empty folder."""
        ...


class ModelError(InputError):
    """A stored model that is missing, damaged, or in another format."""


def check_names(names: pd.DataFrame) -> None:
    """Raise ``ValueError`` unless the frame has the three columns of strings."""
    missing = [column for column in TRIPLE if column not in names.columns]
    if missing:
        raise ValueError(f"columns {missing} are missing; a likelihood model needs {TRIPLE}, got {list(names.columns)}")
    for column in TRIPLE:
        wrong = [value for value in names[column] if not isinstance(value, str)]
        if wrong:
            raise ValueError(f"column {column!r} must hold strings, got {wrong[0]!r}")


def clip_probs(probs: NDArray[np.floating[Any]]) -> Floats:
    """Return the probabilities as float64, at least ``PROB_FLOOR`` away from 0 and 1."""
    return np.clip(probs.astype(np.float64), PROB_FLOOR, 1.0 - PROB_FLOOR)


def write_description(folder: Path, kind: str, content: Mapping[str, object]) -> None:
    """Write ``model.json`` last, with the hash of every file that is already in the folder."""
    files = {
        path.relative_to(folder).as_posix(): sha256_of(path) for path in sorted(folder.rglob("*")) if path.is_file()
    }
    text = json.dumps({"format_version": FORMAT_VERSION, "kind": kind, "files": files, **content}, indent=1)
    with replacing(folder / DESCRIPTION_FILE) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read_description(folder: Path) -> dict[str, Any]:
    """Read ``model.json`` of a folder, and check the format and every file's hash."""
    path = folder / DESCRIPTION_FILE
    if not path.is_file():
        raise ModelError(f"no likelihood model in {folder}: {DESCRIPTION_FILE} is missing; train one first")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        version, files = content["format_version"], dict(content["files"])
        str(content["kind"])
    except (ValueError, KeyError, TypeError) as error:
        raise ModelError(
            f"{path} is damaged ({error}); train the model again or roll back to another version"
        ) from error
    if version != FORMAT_VERSION:
        raise ModelError(f"{path}: format version {version}, this code reads {FORMAT_VERSION}; train the model again")
    for name, expected in files.items():
        if not (folder / name).is_file() or sha256_of(folder / name) != expected:
            raise ModelError(
                f"{folder / name} is missing or damaged (not the sha256 that {DESCRIPTION_FILE} names); "
                "train the model again or roll back to another version"
            )
    return dict(content)


def write_triples(triples: pd.DataFrame, folder: Path) -> None:
    """Write training counts as ``counts.csv``."""
    triples[[*TRIPLE, "positives", "count"]].to_csv(folder / COUNTS_FILE, index=False)


def read_triples(folder: Path) -> pd.DataFrame:
    """Read the training counts of a folder, with names unchanged (``NA`` and the like are names)."""
    triples = pd.read_csv(folder / COUNTS_FILE, keep_default_na=False, dtype=dict.fromkeys(TRIPLE, "str"))
    if list(triples.columns) != [*TRIPLE, "positives", "count"]:
        raise ModelError(f"{folder / COUNTS_FILE} has the columns {list(triples.columns)}; train the model again")
    return triples
