"""Labelled rows of a set of homes: the data on which the likelihood models are trained and judged.

One row asks "is this object in this container?" for every object type of the vocabulary and every container of every
home (label 1 if it is; the paper's section IV). Many rows share one (object, container type, room type), which is all
that a model sees. ``distinct_triples`` condenses them to counts, on which any loss summed over the rows has the same
value.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd
import pandera.pandas as pa

from mrtask.homes.home import Home

SPLITS = ("train", "validation", "test")
TRIPLE = ["object", "container", "room"]

_NAME = pa.Column(str, pa.Check.str_length(min_value=1))

ROW_SCHEMA = pa.DataFrameSchema(
    {
        "object": _NAME,
        "container": _NAME,
        "room": _NAME,
        "home_id": _NAME,
        "container_id": _NAME,
        "label": pa.Column("int8", pa.Check.isin([0, 1])),
        "split": pa.Column(str, pa.Check.isin(SPLITS)),
    },
    strict=True,
    unique=["home_id", "container_id", "object"],
)


def vocabulary(homes: Iterable[Home]) -> tuple[str, ...]:
    """Return the object types that lie in any container of the homes, sorted."""
    return tuple(sorted({name for home in homes for container in home.containers for name in container.objects}))


def label_rows(home: Home, objects: Sequence[str]) -> pd.DataFrame:
    """Return ``C x O`` rows ``object, container, room, home_id, container_id, label`` of one home."""
    kinds = home.container_kinds()
    held = [set(container.objects) for container in home.containers]
    each = len(objects)
    return pd.DataFrame(
        {
            "object": pd.array(list(objects) * len(kinds), dtype="str"),
            "container": pd.array(np.repeat([kind for kind, _ in kinds], each), dtype="str"),
            "room": pd.array(np.repeat([room for _, room in kinds], each), dtype="str"),
            "home_id": pd.array([home.id] * (each * len(kinds)), dtype="str"),
            "container_id": pd.array(np.repeat([container.id for container in home.containers], each), dtype="str"),
            "label": np.array([name in content for content in held for name in objects], dtype=np.int8),
        }
    )


def count_triples(homes: Sequence[Home], about: Sequence[str] | None = None) -> pd.DataFrame:
    """Return the `distinct_triples` of the homes' rows, without making the rows.

    ``about`` restricts them to some objects.
    """
    objects = {name: index for index, name in enumerate(sorted(vocabulary(homes) if about is None else about))}
    kinds = {kind: index for index, kind in enumerate(sorted({k for home in homes for k in home.container_kinds()}))}
    positives, count = np.zeros((len(objects), len(kinds)), dtype=np.int64), np.zeros(len(kinds), dtype=np.int64)
    for home in homes:
        for container, kind in zip(home.containers, home.container_kinds(), strict=True):
            count[kinds[kind]] += 1
            for name in objects.keys() & container.objects:
                positives[objects[name], kinds[kind]] += 1
    names = pd.DataFrame([(name, *kind) for name in objects for kind in kinds], columns=TRIPLE, dtype="str")
    return names.assign(positives=positives.ravel(), count=np.tile(count, len(objects)))


def distinct_triples(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the distinct ``object, container, room`` of the rows with ``positives`` and ``count`` (int64).

    They are sorted by name.
    """
    grouped = rows.groupby(TRIPLE, sort=True, observed=True)["label"].agg(["sum", "count"]).reset_index()
    grouped = grouped.rename(columns={"sum": "positives"})
    return grouped.astype({"positives": np.int64, "count": np.int64})
