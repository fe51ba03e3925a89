"""Divide homes into training, validation and test homes by content, so that no home is in two parts.

Homes are ranked by a hash of their id, so the division depends only on the set of homes. Their order, their files and
duplicates among them have no influence.
"""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class HomeSplit:
    """Disjoint home ids; each part is sorted by id."""

    train: tuple[str, ...]
    validation: tuple[str, ...]
    test: tuple[str, ...]


def split_homes(
    home_ids: Iterable[str], train: int, validation: int, test: int | None = None, salt: str = ""
) -> HomeSplit:
    """Take the given number of homes for each part; ``test=None`` takes all the rest.

    Another ``salt`` gives another division. Raises `ValueError` if there are fewer distinct homes than requested.
    """
    if min(train, validation, test or 0) < 0:
        raise ValueError(f"the parts cannot be negative: train={train}, validation={validation}, test={test}")
    ranked = sorted(set(home_ids), key=lambda home_id: (hashlib.sha256(f"{salt}/{home_id}".encode()).digest(), home_id))
    wanted = train + validation + (test or 0)
    if wanted > len(ranked):
        parts = f"train={train}, validation={validation}, test={'the rest' if test is None else test}"
        raise ValueError(f"{wanted} homes are requested ({parts}), but only {len(ranked)} distinct ones exist")
    end = len(ranked) if test is None else wanted
    return HomeSplit(
        tuple(sorted(ranked[:train])),
        tuple(sorted(ranked[train : train + validation])),
        tuple(sorted(ranked[train + validation : end])),
    )
