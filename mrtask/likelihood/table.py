"""All likelihoods that an evaluation needs, scored in one batch in advance; small enough to send to each worker."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from mrtask.arrays import Floats
from mrtask.errors import InputError
from mrtask.homes.home import Home
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.rows import TRIPLE, vocabulary


@dataclass(frozen=True, eq=False)
class LikelihoodTable:
    """``probs [K, O]`` for K (container type, room type) ``kinds`` and O object types, both sorted."""

    kinds: tuple[tuple[str, str], ...]
    objects: tuple[str, ...]
    probs: Floats

    def matrix(self, home: Home, objects: Sequence[str]) -> Floats:
        """Return ``P(object in container)``, ``[C, O]``, in the order of the home's containers and of ``objects``.

        Raises ``KeyError`` that names an object or a kind of container for which the table was not built.
        """
        rows = [_index(self._row_of, kind, "(container, room)") for kind in home.container_kinds()]
        columns = [_index(self._column_of, name, "object") for name in objects]
        return self.probs[np.ix_(rows, columns)]

    @cached_property
    def _row_of(self) -> dict[tuple[str, str], int]:
        return {kind: row for row, kind in enumerate(self.kinds)}

    @cached_property
    def _column_of(self) -> dict[str, int]:
        return {name: column for column, name in enumerate(self.objects)}


def build_table(model: LikelihoodModel, homes: Iterable[Home], extra_objects: Iterable[str] = ()) -> LikelihoodTable:
    """Return the table of all container kinds in the homes by all objects and ``extra_objects``, in one prediction.

    Raises:
        InputError: the model has no method `predict`.
    """
    if not callable(getattr(model, "predict", None)):
        raise InputError(
            f"a likelihood is a model with a method predict(names), not a {type(model).__name__}; fit_on_homes(homes) "
            "makes one, and so does FunctionModel(function) of a function of object, container and room"
        )
    homes = list(homes)
    kinds = tuple(sorted({kind for home in homes for kind in home.container_kinds()}))
    objects = tuple(sorted({*vocabulary(homes), *extra_objects}))
    names = pd.DataFrame([(name, *kind) for kind in kinds for name in objects], columns=TRIPLE, dtype="str")
    probs = model.predict(names).reshape(len(kinds), len(objects))
    probs.setflags(write=False)
    return LikelihoodTable(kinds, objects, probs)


def _index(known: Mapping[Any, int], key: object, what: str) -> int:
    if key not in known:
        raise KeyError(f"no likelihood for the {what} {key!r}: build the table with it in its homes or extra_objects")
    return known[key]
