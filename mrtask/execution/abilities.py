"""Says what a team lacks that cannot do a task in a home: which robot could do it, after which smallest change.

Legend for array shapes: C containers, O objects.
"""

import numpy as np
from numpy.typing import NDArray

from mrtask.arrays import Bools
from mrtask.execution.team_checks import can_finish, least_needed
from mrtask.execution.team_maps import Maps
from mrtask.execution.team_spec import RobotSpec, Team
from mrtask.homes.home import Home
from mrtask.names import listed
from mrtask.tasks.automaton import Automaton


def missing_ability(automaton: Automaton, team: Team, home: Home, maps: Maps, holds: NDArray[np.bool_]) -> str | None:
    """Return which robot could do the task after which smallest change; None where that is not what is missing.

    Args:
        holds: [C, O] where the objects are.
    """
    touch = np.array([_touch(member, home, maps, automaton.propositions) for member in team.members])
    obtained = np.asarray((holds & touch.any(axis=0)).any(axis=0))
    if can_finish(automaton, obtained):
        return None
    changes: dict[int, tuple[int, tuple[str, ...]]] = {}
    for obj in np.flatnonzero(~obtained).tolist():
        ways = [
            (robot, needed)
            for container in np.flatnonzero(holds[:, obj]).tolist()
            for robot in range(team.robots)
            if (needed := _needed(team, robot, home, maps, container, automaton.propositions[obj])) is not None
        ]
        if ways:
            changes[obj] = min(ways, key=lambda way: len(way[1]))
    obtained[list(changes)] = True
    if not can_finish(automaton, obtained):
        return None
    obtained[list(changes)] = False
    least = least_needed(automaton, obtained, {obj: len(needed) for obj, (_, needed) in changes.items()})
    by_robot: dict[int, dict[str, None]] = {}
    for obj in least:
        robot, needed = changes[obj]
        by_robot.setdefault(robot, {}).update(dict.fromkeys(needed))
    return ", and ".join(f"{team.called(robot)} could if it {listed(said)}" for robot, said in by_robot.items())


def _touch(member: RobotSpec, home: Home, maps: Maps, objects: tuple[str, ...]) -> Bools:
    """Return [C, O] whether the robot gets to the container, opens it and handles the object."""
    usable = maps[member.radius_m].reachable & member.can_use(home.containers)
    return np.asarray(usable[:, None] & member.can_touch(objects))


def _needed(team: Team, robot: int, home: Home, maps: Maps, container: int, obj: str) -> tuple[str, ...] | None:
    """Return what must change so that the robot can interact with the object there; None where no map leads there."""
    member, furniture = team.members[robot], home.containers[container]
    needed = []
    if not member.can_touch((obj,))[0]:
        needed.append(f"handled {obj}")
    if not member.can_use((furniture,))[0]:
        needed.append(f"opened {furniture.type}")
    if not maps[member.radius_m].reachable[container]:
        slim = [number for number, other in enumerate(team.members) if maps[other.radius_m].reachable[container]]
        if slim:
            needed.append(f"were as narrow as {team.called(slim[0])}")
        elif maps[None].reachable[container]:
            needed.append("were as narrow as the robots of the home's map")
        else:
            return None
    return tuple(needed)
