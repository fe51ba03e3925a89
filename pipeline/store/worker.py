"""What workers do for homes and rows. They import this module alone, not the rooms with all that those need."""

from collections.abc import Sequence
from typing import Any

import pandas as pd

from mrtask.execution.trials import key_seed
from mrtask.homes.generator.house import generate_house
from mrtask.homes.generator.residence import generate_residence
from mrtask.homes.generator.residence_size import ResidenceSize
from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.likelihood.rows import label_rows


def generate_numbered(number: int, seed: int) -> dict[str, Any]:
    """Return the house of this number of a seed; the size classes take turns."""
    return generate_house(key_seed(seed, "home", number), SIZE_CLASSES[number % len(SIZE_CLASSES)])


def generate_numbered_residence(number: int, seed: int, size: ResidenceSize) -> dict[str, Any]:
    """Return the residence of this number of a seed."""
    return generate_residence(key_seed(seed, "residence", number), size)


def label_numbered(number: int, homes: Sequence[Home], objects: tuple[str, ...]) -> pd.DataFrame:
    """Return the labelled rows of the home of this number."""
    return label_rows(homes[number], objects)
