"""Measure how much generated homes resemble real ones, by statistic, relative to the spread among real homes.

Numbers are compared by the Kolmogorov-Smirnov distance, kinds (room types, container types, objects) by the total
variation distance. The yardstick of a row is the same distance between two random halves of the real homes. ``python -m
pipeline.realism`` makes the table.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.maps.home_map import DEFAULT_ROBOT_RADIUS_M, HomeMap, main_region_share

HALVINGS = 20
ROOM_TYPES = ("Kitchen", "LivingRoom", "Bedroom", "Bathroom")

Values = Sequence[Any]
"""Numbers or kinds; several per home if the statistic describes rooms or containers."""


@dataclass(frozen=True)
class DescribedHome:
    """The data that the comparison needs of one home. Statistics that need no map are computed from ``home``."""

    home: Home
    travel_m: tuple[float, ...]
    """Path lengths between all pairs of reachable containers."""
    reachable_share: float
    free_floor_share: float
    """The free floor in the main region, relative to all floor."""
    main_region_share: float


def describe_home(home: Home, home_map: HomeMap) -> DescribedHome:
    """Measure one home."""
    known = np.flatnonzero(home_map.reachable)
    first, second = np.triu_indices(len(known), 1)
    return DescribedHome(
        home,
        tuple(home_map.travel_m[known[first], known[second]].tolist()),
        float(home_map.reachable.mean()),
        float(home_map.free.sum() * home_map.resolution_m**2 / home.area_m2),
        main_region_share(home, home_map.resolution_m, DEFAULT_ROBOT_RADIUS_M),
    )


def _containers_in(room_type: str) -> Callable[[DescribedHome], Values]:
    def count(described: DescribedHome) -> list[float]:
        home = described.home
        counts = Counter(container.room_id for container in home.containers)
        return [float(counts[room.id]) for room in home.rooms if room.type == room_type]

    return count


def _travel(reduce: Callable[[Sequence[float]], float]) -> Callable[[DescribedHome], Values]:
    return lambda described: [float(reduce(described.travel_m))] if described.travel_m else []


NUMBERS: dict[str, Callable[[DescribedHome], Values]] = {
    "rooms": lambda d: [float(len(d.home.rooms))],
    "area, m2": lambda d: [d.home.area_m2],
    "inner doors": lambda d: [float(sum(door.rooms[0] != door.rooms[1] for door in d.home.doors))],
    "containers": lambda d: [float(len(d.home.containers))],
    **{f"containers in a {room_type}": _containers_in(room_type) for room_type in ROOM_TYPES},
    "objects in a container": lambda d: [float(len(c.objects)) for c in d.home.containers],
    "share of empty containers": lambda d: [float(np.mean([not c.objects for c in d.home.containers]))],
    "mean travel, m": _travel(np.mean),
    "spread of travel, m": _travel(np.std),
    "free floor share": lambda d: [d.free_floor_share],
    "main region share": lambda d: [d.main_region_share],
    "reachable share": lambda d: [d.reachable_share],
}
KINDS: dict[str, Callable[[DescribedHome], Values]] = {
    "room types": lambda d: [room.type for room in d.home.rooms],
    "container types": lambda d: [container.type for container in d.home.containers],
    "containers by room": lambda d: [f"{kind} in {room}" for kind, room in d.home.container_kinds()],
    "object types": lambda d: [name for container in d.home.containers for name in container.objects],
    "objects by container": lambda d: [f"{name} in {c.type}" for c in d.home.containers for name in c.objects],
}


def compare_homes(generated: Sequence[DescribedHome], real: Sequence[DescribedHome], seed: int = 0) -> pd.DataFrame:
    """Return one row per size class and statistic.

    Columns: size_class, statistic, measure (KS or TV), generated and real (means; None for kinds), distance, yardstick
    (mean over random halvings of the real homes), ratio of the two.
    """
    rows = []
    for size_class in SIZE_CLASSES:
        ours = [described for described in generated if described.home.size_class == size_class]
        theirs = [described for described in real if described.home.size_class == size_class]
        if not ours or len(theirs) < 2:
            continue
        rng = np.random.default_rng(seed)
        halvings = [np.array_split(rng.permutation(len(theirs)), 2) for _ in range(HALVINGS)]
        for measure, statistics in (("KS", NUMBERS), ("TV", KINDS)):
            distance_of = _ks_distance if measure == "KS" else _tv_distance
            for name, statistic in statistics.items():
                per_home = [statistic(described) for described in theirs]
                pooled = _pool(statistic(described) for described in ours)
                distance = distance_of(pooled, _pool(per_home))
                halves = [[_pool(per_home[index] for index in half) for half in halving] for halving in halvings]
                yardstick = float(np.mean([distance_of(first, second) for first, second in halves]))
                means = [float(np.mean(v)) if measure == "KS" and v else None for v in (pooled, _pool(per_home))]
                ratio = distance / yardstick if yardstick > 0 else np.inf if distance > 0 else 0.0
                rows.append((size_class, name, measure, *means, distance, yardstick, ratio))
    columns = ["size_class", "statistic", "measure", "generated", "real", "distance", "yardstick", "ratio"]
    return pd.DataFrame(rows, columns=columns)


def _pool(per_home: Iterable[Values]) -> list[Any]:
    return [value for values in per_home for value in values]


def _ks_distance(first: Values, second: Values) -> float:
    """Return the largest gap between the two cumulative shares: 0 if neither has values, 1 if only one has."""
    if not len(first) or not len(second):
        return float(len(first) != len(second))
    places = np.concatenate([first, second])
    below = [np.searchsorted(np.sort(values), places, side="right") / len(values) for values in (first, second)]
    return float(np.abs(below[0] - below[1]).max())


def _tv_distance(first: Values, second: Values) -> float:
    """Return half the summed gaps between the two shares of each kind."""
    ours, theirs = Counter(first), Counter(second)
    return 0.5 * sum(
        abs(ours[kind] / max(len(first), 1) - theirs[kind] / max(len(second), 1)) for kind in ours | theirs
    )
