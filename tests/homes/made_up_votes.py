"""Made-up votes in the format of the real ones, small enough to know by heart."""

import io
import os
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
    """For each object, all agree on the best place; everybody has two more right ones and two wrong ones, at random."""
    rng = np.random.default_rng(seed)
    ranks = np.zeros((len(PLACEMENTS), len(OBJECTS), ANNOTATORS), dtype=np.int64)
    for index in range(len(OBJECTS)):
        best, *others = rng.permutation(len(PLACEMENTS))
        for annotator in range(ANNOTATORS):
            ranks[[best, *rng.permutation(others)[:4]], index, annotator] = (1, 2, 3, -1, -2)
    return {"ranks": ranks, "objects": [np.str_(name) for name in OBJECTS], "room_receptacles": list(PLACEMENTS)}


class Evil:
    """What a pickle can do: makes a folder where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return os.mkdir, (str(self.path),)


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
