"""Generate homes as `Home` objects, for programs that need no house files."""

from collections.abc import Iterator, Sequence

from mrtask.homes.generator.house import generate_house
from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.homes.procthor import parse_house

SOURCE = "generated"


def generate_home(seed: int, size_class: str | None = None, rooms: int | None = None) -> Home:
    """Generate the home of a seed.

    Takes and raises what `mrtask.homes.generator.house.generate_house` does.
    """
    return parse_house(generate_house(seed, size_class, rooms), None, SOURCE, seed)


def generate_homes(count: int, seed: int = 0, size_classes: Sequence[str] = SIZE_CLASSES) -> Iterator[Home]:
    """Generate ``count`` homes whose size classes take turns; home k of a seed does not depend on ``count``."""
    for number in range(count):
        yield generate_home(seed + number, size_classes[number % len(size_classes)])
