"""Refuses teams before any work: types that do not exist, and tasks that nobody in the team can do in any home."""

from collections.abc import Iterable, Sequence

import numpy as np

from mrtask.arrays import Bools
from mrtask.errors import InputError
from mrtask.execution.team_spec import Team
from mrtask.homes.catalogue import CONTAINER_TYPES, load_catalogue
from mrtask.homes.home import Home
from mrtask.names import listed, name_to_text, suggest
from mrtask.tasks.automaton import NEVER_ACCEPTS, Automaton, build_automaton


def check_types(team: Team, homes: Sequence[Home] = ()) -> None:
    """Refuse a type of objects or containers that neither these homes nor the catalogue have.

    Raises:
        InputError: there is such a type among those that a robot handles or opens.
    """
    furniture = [container for home in homes for container in home.containers]
    objects = {name for container in furniture for name in container.objects}
    _check_types(team, "handles", objects | _catalogue_objects())
    _check_types(team, "opens", {container.type for container in furniture} | CONTAINER_TYPES)


def check_doable(team: Team, formula: str | None, objects: tuple[str, ...]) -> None:
    """Refuse a team none of whose robots can do a task in any home; ``formula`` None: any task with some object.

    Raises:
        InputError: nobody can do it; the message says what would help.
    """
    if all(member.opens == () for member in team.members):
        raise InputError(
            f"team {team.name!r}: nobody opens any container; {team.called(0)} could if it opened one (`opens`)"
        )
    if all(member.handles == () for member in team.members):
        raise InputError(
            f"{_first(team)} can handle no object, so it can do no task; {team.called(0)} could if it handled any "
            "(`handles`); list a robot with an arm first, or ask for more robots"
        )
    if formula is None:
        return
    automaton = build_automaton(formula, objects)
    can = np.any([member.can_touch(objects) for member in team.members], axis=0)
    if can_finish(automaton, can):
        return
    lacking = least_needed(automaton, can, {obj: 1 for obj in np.flatnonzero(~can).tolist()})
    robot = _most_able(team, objects)
    raise InputError(
        f"{_first(team)} cannot do {formula!r}, because nobody handles {listed(objects[obj] for obj in lacking)}; "
        f"{team.called(robot)} could if it handled {listed(objects[obj] for obj in lacking)}"
    )


def can_finish(automaton: Automaton, objects: Bools) -> bool:
    """Return whether the task can be done with these objects [O]."""
    return bool(automaton.steps_with(objects)[automaton.initial] < NEVER_ACCEPTS)


def least_needed(automaton: Automaton, can: Bools, costs: dict[int, int]) -> list[int]:
    """Return as few of the objects in ``costs`` as the task needs besides those that it ``can`` have, cheap ones."""
    kept = np.array(can)
    kept[list(costs)] = True
    for obj in sorted(costs, key=lambda obj: -costs[obj]):
        kept[obj] = False
        if not can_finish(automaton, kept):
            kept[obj] = True
    return [obj for obj in costs if kept[obj]]


def _check_types(team: Team, what: str, known: Iterable[str]) -> None:
    by_text = {name_to_text(name): name for name in sorted(known)}
    for number, member in enumerate(team.members):
        for name in getattr(member, what) or ():
            if name_to_text(name) not in by_text:
                raise InputError(
                    f"team {team.name!r}, {team.called(number)}: {what}: no type {name!r}; "
                    f"{suggest(name, by_text.values())}"
                )


def _catalogue_objects() -> set[str]:
    kinds = [kind for containers in load_catalogue().objects.values() for kind in containers.values()]
    return {name for kind in kinds for name in kind["likelihoods"]}


def _most_able(team: Team, objects: tuple[str, ...]) -> int:
    return int(np.argmax([member.can_touch(objects).sum() for member in team.members]))


def _first(team: Team) -> str:
    return f"team {team.name!r}" + (
        f" with {team.robots} robots" if team.robots > 1 else f" with only {team.called(0)}"
    )
