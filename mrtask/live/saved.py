"""What a saved state holds: its fields, how its lines add up to them, and what cannot be true of them."""

import json
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from mrtask.errors import InputError
from mrtask.execution.acts import ActKind
from mrtask.execution.motion import Position
from mrtask.execution.trace import Leg, Letter
from mrtask.live.barriers import Barrier
from mrtask.live.state import EventKey, LiveSetup
from mrtask.planning.problem import NONE_UNNAMED

READ_VERSIONS: Final = (1, 2)
IDS, LEGS, PASSED = "ids", "legs", "passed"
"""What only grows, of the team and of each robot: lines of changes hold what was added."""
GROWN = "grown"
"""In a line of changes, what was added to each robot: new legs, how much of its way it keeps, and what came after."""
MAX_SHOWN = 200

_Prob = Annotated[float, Field(ge=0, le=1)]


class StateError(InputError):
    """A state that cannot be restored here."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class SavedRobot(_Part):
    """A robot of a saved state."""

    name: str
    heard_s: float
    position: Position
    place: int
    mode: ActKind
    container: int
    interaction: int
    since_s: float
    moved_s: float
    until_s: float | None
    under_way: bool
    passed: tuple[tuple[float, float], ...] = ()
    obj: int
    legs: tuple[Leg, ...] = ()
    setbacks: tuple[tuple[int, int, int, float], ...] = ()
    """(container, what failed there, how often, when last)"""
    spoke_s: float = 0.0
    silent: bool = False
    beating: bool = False


class SavedState(_Part):
    """Everything that a saved state holds; `mistake` checks how it fits the home and the task."""

    version: Literal[1, 2]
    fingerprint: str
    time_s: float
    state: int
    news: bool
    searched: tuple[bool, ...]
    presence_prob: tuple[tuple[_Prob, ...], ...]
    posterior: tuple[tuple[_Prob, ...], ...] | None = None
    detected: tuple[tuple[bool, ...], ...] | None = None
    searches: tuple[Annotated[int, Field(ge=0)], ...] | None = None
    seen_s: tuple[tuple[float | None, ...], ...]
    robots: tuple[SavedRobot, ...] = Field(min_length=1)
    letters: tuple[Letter, ...]
    barriers: dict[str, Barrier]
    start: tuple[float, float]
    decisions: int
    orders: int
    map_version: int
    told: dict[str, tuple[str, int, int, int]]
    busy: tuple[int, ...]
    ended: tuple[int, ...]
    surprise: bool
    decided_s: float = 0.0
    ids: tuple[EventKey, ...] = ()
    zero_s: float = 0.0

    @field_validator("ids", mode="before")
    @classmethod
    def _of_any_sender(cls, ids: object) -> object:
        """Older states hold ids without senders."""
        return [("", one) if isinstance(one, str) else one for one in ids] if isinstance(ids, list | tuple) else ids


def read_saved(text: str) -> SavedState:
    """Return the state in a text.

    Raises:
        StateError: a damaged text, or one of another version.
    """
    raw = _whole(text)
    if isinstance(raw, dict) and raw.get("version") not in READ_VERSIONS:
        readable = " and ".join(map(str, READ_VERSIONS))
        raise StateError(f"the state is of version {raw.get('version')}, this program reads {readable}")
    try:
        return SavedState.model_validate(raw)
    except (ValidationError, RecursionError) as error:
        raise damaged(_first_mistake(error)) from None


def mistake(setup: LiveSetup, state: SavedState) -> str | None:
    """Return what in a state does not fit the home and the task, which its fingerprint says are these."""
    shape, robots = setup.likelihood.shape, len(state.robots)
    for name in ("presence_prob", "posterior", "detected", "seen_s"):
        rows = getattr(state, name)
        if rows is not None and (len(rows) != shape[0] or any(len(row) != shape[1] for row in rows)):
            return f"{name} is not of {shape[0]} containers x {shape[1]} objects"
    if len(state.searched) != shape[0] or len(state.searches or state.searched) != shape[0]:
        return f"searched or searches is not of {shape[0]} containers"
    letters = [one.robot for one in state.letters]
    containers = [(one.place, "place") for one in state.robots] + [(one.container, "container") for one in state.robots]
    containers += [(container, "setbacks") for one in state.robots for container, *_ in one.setbacks]
    # Below the objects stand ANY_SAFE and, only for what was ordered, NONE_UNNAMED.
    objects = [(one.obj, "obj") for one in state.robots]
    objects += [(one.interaction, "interaction") for one in state.robots if one.interaction != NONE_UNNAMED]
    objects += [(what, "setbacks") for one in state.robots for _, what, *_ in one.setbacks if what >= 0]
    for numbers, count, kind in ((containers, shape[0], "container"), (objects, shape[1], "object")):
        if wrong := [f"{name} is {number}" for number, name in numbers if not -1 <= number < count]:
            return f"{wrong[0]}, and there are {count} {kind}s"
    if any(number not in range(robots) for number in (*state.busy, *state.ended, *letters)):
        return f"there are {robots} robots, and busy, ended or letters name another"
    free = setup.home_map.free
    for one in state.robots:
        cells = (one.position.back, one.position.ahead)
        if not all(0 <= row < free.shape[0] and 0 <= col < free.shape[1] and free[row, col] for row, col in cells):
            return f"robot {one.name} is off the free floor"
        if one.under_way != (one.mode is ActKind.MOVE) or (one.under_way and one.container < 0):
            return f"robot {one.name} is under way to nowhere"
    if len({one.name for one in state.robots}) < robots:
        return "two robots have one name"
    return None


def damaged(what: str) -> StateError:
    """Return the error for a state that cannot be used."""
    return StateError(f"the state is damaged ({what[:MAX_SHOWN]}); begin anew without it")


def _whole(text: str) -> Any:
    """Return the state that the lines add up to, as JSON.

    Raises:
        StateError: a line that cannot be read, but for a last one that was cut off.
    """
    lines = text.splitlines()
    if len(lines) > 1 and not text.endswith("\n"):
        lines.pop()
    try:
        whole, *later = [json.loads(line) for line in lines] or [None]
        if not later:
            return whole
        grown = [(robot[LEGS], robot[PASSED]) for robot in whole["robots"]]
        for entry in later:
            whole[IDS] += entry.pop(IDS, [])
            for number, (legs, kept, passed) in enumerate(entry.pop(GROWN, [])):
                if number == len(grown):
                    grown.append(([], []))
                known_legs, known_passed = grown[number]
                known_legs += legs
                known_passed[kept:] = passed
            whole |= entry
        robots = zip(whole["robots"], grown, strict=True)
        whole["robots"] = [{**robot, LEGS: legs, PASSED: passed} for robot, (legs, passed) in robots]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise damaged(f"its lines do not fit together: {error}") from None
    return whole


def _first_mistake(error: ValidationError | RecursionError) -> str:
    if isinstance(error, RecursionError):
        return "nested too deeply"
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
