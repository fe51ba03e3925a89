"""Made-up votes in the format of the real ones, small enough to know by heart."""

import io
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

PLACEMENTS = (
    "bedroom|bed", "bedroom|chest", "bedroom|shelf", "kitchen|counter", "kitchen|fridge", "kitchen|table",
    "living_room|sofa", "living_room|table", "living_room|shelf", "bathroom|sink", "bathroom|toilet",
    "bedroom|console_table", "living_room|coffee_table", "living_room|chair", "living_room|sofa_chair",
    "kitchen|stool", "bedroom|bottom_cabinet",
)  # fmt: skip
OBJECTS = ("mug", "remote_control", "pillow", "tooth-brush", "cat toy", "spare_key")
ANNOTATORS = 4
SPLITS = {"train": ["mug", "remote_control", "pillow"], "val": ["tooth-brush"], "test": ["cat toy", "spare_key"]}


def content(seed: int = 0) -> dict[str, Any]:
    """Everybody ranks three right and two wrong places for each object, at random."""
    rng = np.random.default_rng(seed)
    ranks = np.zeros((len(PLACEMENTS), len(OBJECTS), ANNOTATORS), dtype=np.int64)
    for index in range(len(OBJECTS)):
        for annotator in range(ANNOTATORS):
            ranks[rng.permutation(len(PLACEMENTS))[:5], index, annotator] = (1, 2, 3, -1, -2)
    return {"ranks": ranks, "objects": [np.str_(name) for name in OBJECTS], "room_receptacles": list(PLACEMENTS)}


def write(path: Path, given: object = None, numpy_1: bool = True) -> Path:
    """A file as ``np.save`` writes a dict, with the module names of numpy 1 or as this numpy has them."""
    array = np.empty((), dtype=object)
    array[()] = content() if given is None else given
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|O", "fortran_order": False, "shape": ()})
    body = pickle.dumps(array, protocol=3)
    if numpy_1:
        body = body.replace(b"cnumpy._core.", b"cnumpy.core.")
    path.write_bytes(head.getvalue() + body)
    return path


def write_splits(path: Path, splits: Mapping[str, list[str]] = SPLITS) -> Path:
    """A file of splits."""
    lines = [f"  {name}: [{', '.join(names)}]" for name, names in splits.items()]
    path.write_text("objects:\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return path
