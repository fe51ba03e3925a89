"""Match the containers of a home with the receptacles of the votes (`mrtask.homes.votes`).

A table, ``receptacles.toml``, decides. For types that the table does not list, the most similar name decides.
"""

import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mrtask.homes.home import Home
from mrtask.homes.votes import Placement, VotesError

BUNDLED_TABLE = Path(__file__).with_suffix(".toml")
SECTIONS = ("containers", "rooms")

Kind = tuple[str, str]
"""``(container type, room type)``."""
Nearest = Callable[[str, Sequence[str]], str | None]
"""Returns the candidate whose name is most similar to a name, or None if no name is similar enough."""


@dataclass(frozen=True)
class ReceptacleTable:
    """The receptacles for each container type, and the votes' rooms for each room type, both in order of preference."""

    containers: Mapping[str, tuple[str, ...]]
    rooms: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class Match:
    """The places in the votes (their numbers) that each kind of container stands for, and the types without a match.

    ``by_name``: container and room types that are not in the table, with the most similar name that was found.
    ``unknown``: names that the table gives for the homes' types, but on which nobody voted.
    """

    places: Mapping[Kind, tuple[int, ...]]
    by_name: Mapping[str, str]
    unknown: tuple[str, ...] = ()

    @property
    def unmatched(self) -> tuple[str, ...]:
        """Return the container types without any place, which stay empty."""
        return tuple(sorted({container for (container, _), places in self.places.items() if not places}))


def read_table(path: Path = BUNDLED_TABLE) -> ReceptacleTable:
    """Read the table in a TOML file.

    Raises:
        VotesError: the file is missing or is not such a table.
    """
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise VotesError(f"{path} is not a table of receptacles: {error}") from error
    if wrong := [name for name in raw if name not in SECTIONS]:
        raise VotesError(f"{path}: no section {wrong[0]!r}; allowed: {', '.join(SECTIONS)}")
    for section in SECTIONS:
        for name, listed in dict(raw.get(section, {})).items():
            if not isinstance(listed, list) or not all(isinstance(entry, str) for entry in listed):
                raise VotesError(f"{path}: {section}.{name} must be a list of names, got {listed!r}")
    return ReceptacleTable(
        *({name: tuple(listed) for name, listed in raw.get(section, {}).items()} for section in SECTIONS)
    )


def match_homes(
    homes: Iterable[Home], placements: Sequence[Placement], table: ReceptacleTable, nearest: Nearest
) -> Match:
    """Find the places in the votes that each kind of container in the homes stands for."""
    rooms, receptacles = (tuple(dict.fromkeys(pair[part] for pair in placements)) for part in (0, 1))
    by_name: dict[str, str] = {}
    unknown: set[str] = set()

    def names(name: str, listed: Mapping[str, tuple[str, ...]], candidates: Sequence[str]) -> tuple[str, ...]:
        if name in listed:
            unknown.update(set(listed[name]) - set(candidates))
            return listed[name]
        if (found := nearest(name, candidates)) is None:
            return ()
        by_name[name] = found
        return (found,)

    places = {}
    for container, room in sorted({kind for home in homes for kind in home.container_kinds()}):
        wanted = names(container, table.containers, receptacles)
        places[container, room] = _places(wanted, names(room, table.rooms, rooms), placements)
    return Match(places, by_name, tuple(sorted(unknown)))


def _places(wanted: Sequence[str], rooms: Sequence[str], placements: Sequence[Placement]) -> tuple[int, ...]:
    """Return the wanted receptacles in the first room that has any.

    If no room has any, return those in every room.
    """
    for room in rooms:
        if found := tuple(n for n, (place, name) in enumerate(placements) if place == room and name in wanted):
            return found
    return tuple(number for number, (_, name) in enumerate(placements) if name in wanted)
