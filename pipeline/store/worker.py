"""What workers do for the stages of homes and rows; they import this, and not the stages with all that these need."""

from collections.abc import Sequence
from typing import Any

import pandas as pd

from mrtask.execution.trials import key_seed
from mrtask.homes.generator.house import generate_house
from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.likelihood.rows import label_rows


def generate_numbered(number: int, seed: int) -> dict[str, Any]:
    """The house of this number of a seed; the size classes take turns."""
    return generate_house(key_seed(seed, "home", number), SIZE_CLASSES[number % len(SIZE_CLASSES)])


def label_chunk(number: int, chunks: Sequence[Sequence[Home]], objects: tuple[str, ...]) -> pd.DataFrame:
    """The labelled rows of a chunk of homes."""
    return pd.concat([label_rows(home, objects) for home in chunks[number]], ignore_index=True)
