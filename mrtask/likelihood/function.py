"""The user's own likelihood model: any function of three names."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from mrtask.arrays import Floats
from mrtask.errors import InputError
from mrtask.likelihood.model import check_names, clip_probs
from mrtask.likelihood.rows import TRIPLE


@dataclass(frozen=True)
class FunctionModel:
    """``function(object, container, room)`` is the probability that such a container holds the object.

    The function is called once for each distinct triple, in order of appearance.
    """

    function: Callable[[str, str, str], float]

    @property
    def kind(self) -> str:
        """Return ``function``."""
        return "function"

    def predict(self, names: pd.DataFrame) -> Floats:
        """Return probabilities ``[N]`` for a frame with the columns ``object``, ``container``, ``room``.

        Raises:
            InputError: the function returned something that is not a probability.
        """
        check_names(names)
        known: dict[tuple[str, str, str], float] = {}
        for triple in names[TRIPLE].itertuples(index=False, name=None):
            if triple not in known:
                known[triple] = self._ask(triple)
        return clip_probs(np.array([known[triple] for triple in names[TRIPLE].itertuples(index=False, name=None)]))

    def save(self, folder: Path) -> None:
        """Raise ``InputError``, because a function cannot be stored."""
        raise InputError("a likelihood given as a function cannot be saved; keep a `build_table` of it instead")

    def _ask(self, triple: tuple[str, str, str]) -> float:
        prob = float(self.function(*triple))
        if not 0.0 <= prob <= 1.0:
            raise InputError(f"the likelihood of {' in '.join(triple)} must lie in [0, 1], the function gave {prob}")
        return prob
