"""The maps of a team: robots of another width than the home's map was made for have their own, on the same grid."""

from collections.abc import Callable, Mapping

import numpy as np

from mrtask.arrays import Bools
from mrtask.errors import InputError
from mrtask.execution.make_trial import free_cell_near
from mrtask.execution.team_spec import Team
from mrtask.homes.home import Home
from mrtask.maps.home_map import HomeMap, build_map

Maps = Mapping[float | None, HomeMap]
"""A home's maps by the robots' radius in metres; None: the home's own map."""
MakeMap = Callable[[float], HomeMap]


def maps_for(team: Team, home: Home, home_map: HomeMap, make: MakeMap | None = None) -> Maps:
    """Return the home's map, and maps on the same grid for the robots of another width.

    Args:
        make: returns the map for a radius in metres; by default it is built like the home's.
    """
    ways = "shortest" if home_map.steps is None else "soft"
    make = make or (lambda radius_m: build_map(home, home_map.resolution_m, radius_m, ways))
    widths = {member.radius_m for member in team.members} - {None}
    return {None: home_map} | {width: make(width) for width in widths if width is not None}


def in_reach(team: Team, home: Home, maps: Maps) -> Bools:
    """Return the home's containers [C] that some robot can get to and use."""
    return np.asarray(
        np.any([maps[member.radius_m].reachable & member.can_use(home.containers) for member in team.members], axis=0)
    )


def start_cells(team: Team, maps: Maps, start_cell: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the cells in which the robots start.

    Args:
        start_cell: where the team starts; a robot that does not fit there starts at the nearest place where it does.

    Raises:
        InputError: a robot's own start is no place where it fits.
    """
    cells = []
    for number, member in enumerate(team.members):
        own = maps[member.radius_m]
        if member.start_m is None:
            fits = own.free[start_cell]
            cells.append(start_cell if fits else free_cell_near(own, own.cell_center(start_cell), np.inf))
            continue
        try:
            cells.append(free_cell_near(own, member.start_m))
        except InputError as error:
            raise InputError(
                f"team {team.name!r}, {team.called(number)}: start: in the home {own.home_id}, {error}"
            ) from None
    return cells
