"""How large a residence is to be: its containers or flats, and how they share floors and corridors.

Apart from `mrtask.homes.generator.residence`, so that a configuration can be checked before the generator is imported.
"""

import math
from dataclasses import dataclass

from mrtask.errors import InputError

CONTAINERS_ALLOWED = (50, 500)
MAX_FLATS_PER_SIDE, MAX_FLOORS = 8, 4
"""More would not fit into `mrtask.homes.procthor.MAX_EXTENT_M`."""
FLATS_ALLOWED = (2, 2 * MAX_FLATS_PER_SIDE * MAX_FLOORS)
TOLERANCE = 0.1
"""The largest share by which the number of containers may differ from the number wanted."""
CONTAINERS_PER_FLAT = 10.0
"""About how many containers a flat has."""
FLATS_OVER_SQUARE = 1.1
"""The square of the flats on a side over their number, with which a site is about as long as it is wide."""


@dataclass(frozen=True)
class ResidenceSize:
    """The size of a residence. Raises `InputError` for one that no residence has."""

    containers: int = 100
    """About how many containers there are in all, 50 to 500; a residence has within 10 % of it."""
    flats: int | None = None
    """The number of flats, 2 to 64, instead of the number of containers."""
    flats_per_side: int | None = None
    """How many flats lie on each side of a floor's corridor at most, 1 to 8; None: as many as make the site about
    square."""

    def __post_init__(self) -> None:
        for name, value, (low, high) in (
            ("containers", self.containers, CONTAINERS_ALLOWED),
            ("flats", self.flats, FLATS_ALLOWED),
            ("flats_per_side", self.flats_per_side, (1, MAX_FLATS_PER_SIDE)),
        ):
            if value is not None and not low <= value <= high:
                raise InputError(f"{name} = {value} is not allowed; choose {low} to {high}")
        floors = floors_of(self._flats_expected, self.most_a_side)
        if floors > MAX_FLOORS:
            least = math.ceil(self._flats_expected / (2 * MAX_FLOORS))
            about = "" if self.flats else "about "
            raise InputError(
                f"flats_per_side = {self.flats_per_side} makes {floors} floors of {about}{self._flats_expected} flats, "
                f"and a residence has at most {MAX_FLOORS}; choose {least} to {MAX_FLATS_PER_SIDE}, or a smaller one"
            )

    @property
    def most_a_side(self) -> int:
        """Return how many flats lie on a side of a corridor at most."""
        return self.flats_per_side or min(flats_on_a_side(self._flats_expected), MAX_FLATS_PER_SIDE)

    @property
    def _flats_expected(self) -> int:
        return self.flats or math.ceil(self.containers / CONTAINERS_PER_FLAT)

    def __str__(self) -> str:
        """Return the size in words."""
        size = f"{self.containers} containers" if self.flats is None else f"{self.flats} flats"
        return f"{size}, with up to {self.most_a_side} flats on a side of a corridor"


def floors_of(flats: int, flats_per_side: int) -> int:
    """Return the number of floors for so many flats."""
    return math.ceil(flats / (2 * flats_per_side))


def flats_on_a_side(flats: int) -> int:
    """Return how many of the flats must lie on a side of a corridor for a site that is about as long as it is wide."""
    return math.ceil(math.sqrt(FLATS_OVER_SQUARE * flats))
