"""Save a live team's state as one versioned JSON text, and restore it in another process.

States of version 1, which know nothing of searches that err, are read too. Unknown fields are ignored, and fields that
are added later are optional.

What does not change (home, task, planner) is not in the text; a fingerprint of it is, so that no state is restored into
another task. Routes are planned again: the same map and the same start give the same route.
"""

import hashlib
import json
from dataclasses import replace
from typing import Any, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from mrtask.errors import InputError
from mrtask.execution.acts import Act, ActKind
from mrtask.execution.motion import Position, plan_route
from mrtask.execution.trace import Leg, Letter
from mrtask.live.barriers import Barrier, barred_map
from mrtask.live.live_team import LiveTeam
from mrtask.live.state import LiveSetup
from mrtask.planning.problem import Assignment

STATE_VERSION: Final = 2
READ_VERSIONS: Final = (1, 2)


class StateError(InputError):
    """A state that cannot be restored here."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class _Robot(_Part):
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
    passed: tuple[tuple[float, float], ...]
    obj: int
    legs: tuple[Leg, ...]


class _State(_Part):
    version: Literal[1, 2]
    fingerprint: str
    time_s: float
    state: int
    news: bool
    searched: tuple[bool, ...]
    presence_prob: tuple[tuple[float, ...], ...]
    posterior: tuple[tuple[float, ...], ...] | None = None
    detected: tuple[tuple[bool, ...], ...] | None = None
    searches: tuple[int, ...] | None = None
    seen_s: tuple[tuple[float | None, ...], ...]
    robots: tuple[_Robot, ...]
    letters: tuple[Letter, ...]
    failures: tuple[tuple[int, int, int], ...]
    barriers: dict[str, Barrier]
    start: tuple[float, float]
    decisions: int
    orders: int
    map_version: int
    told: dict[str, tuple[str, int, int, int]]
    busy: tuple[int, ...]
    ended: tuple[int, ...]
    surprise: bool
    ids: tuple[str, ...]


def fingerprint(setup: LiveSetup) -> str:
    """Return the fingerprint of what a saved state belongs to: the layout, the grid and the task."""
    home_map = setup.home_map
    content = [
        setup.home.layout_id, home_map.resolution_m, home_map.free.shape, int(home_map.free.sum()),
        setup.task.formula, setup.task.propositions,
    ]  # fmt: skip
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


def save(live: LiveTeam) -> str:
    """Return the state as JSON; call this between two calls of `LiveTeam.handle`."""
    team, belief = live.team, live.team.belief
    robots = [
        _Robot(
            name=name,
            heard_s=heard_s,
            position=robot.position,
            place=robot.place,
            mode=robot.act.kind,
            container=robot.assignment.container,
            interaction=robot.assignment.interaction,
            since_s=robot.since_s,
            moved_s=robot.moved_s,
            until_s=robot.act.until_s if np.isfinite(robot.act.until_s) else None,
            under_way=robot.route is not None,
            passed=robot.passed,
            obj=robot.act.obj,
            legs=tuple(robot.legs),
        )
        for name, heard_s, robot in zip(live.names, live.heard_s, team.robots, strict=True)
    ]
    return _State(
        version=STATE_VERSION,
        fingerprint=fingerprint(live.setup),
        time_s=team.time_s,
        state=team.state,
        news=team.news,
        searched=tuple(map(bool, belief.searched)),
        presence_prob=tuple(tuple(map(float, row)) for row in belief.presence_prob),
        posterior=tuple(tuple(map(float, row)) for row in belief.posterior),
        detected=tuple(tuple(map(bool, row)) for row in belief.detected),
        searches=tuple(map(int, belief.searches)),
        seen_s=tuple(tuple(float(at) if np.isfinite(at) else None for at in row) for row in live.seen_s),
        robots=tuple(robots),
        letters=tuple(team.letters),
        failures=tuple((*key, count) for key, count in belief.failures.items()),
        barriers=live.barriers,
        start=team.start,
        decisions=live.decisions,
        orders=live.orders,
        map_version=live.map_version,
        told=live.told,
        busy=tuple(sorted(live.busy)),
        ended=tuple(live.ended),
        surprise=live.surprise,
        ids=tuple(live.ids),
    ).model_dump_json()


def restore(setup: LiveSetup, text: str) -> LiveTeam:
    """Return the live team of a saved state.

    Raises:
        StateError: a damaged text, or one of another version, home or task.
    """
    try:
        raw: Any = json.loads(text)
        if isinstance(raw, dict) and raw.get("version") not in READ_VERSIONS:
            readable = " and ".join(map(str, READ_VERSIONS))
            raise StateError(f"the state is of version {raw.get('version')}, this program reads {readable}")
        state = _State.model_validate(raw)
    except (json.JSONDecodeError, ValidationError, RecursionError) as error:
        raise StateError(f"the state is damaged ({str(error).splitlines()[0]}); begin anew without it") from None
    if state.fingerprint != fingerprint(setup):
        raise StateError("the state is of another home, map or task; give those it was saved with, or another file")
    live = LiveTeam(setup, {robot.name: setup.home_map.cell_center(robot.position.back) for robot in state.robots})
    team = live.team
    belief = team.belief
    shape = belief.presence_prob.shape
    belief.searched = np.array(state.searched)
    belief.presence_prob = np.array(state.presence_prob, dtype=float).reshape(shape)
    posterior = state.presence_prob if state.posterior is None else state.posterior
    belief.posterior = np.array(posterior, dtype=float).reshape(shape)
    sure = (belief.presence_prob == 1.0) & belief.searched[:, None]
    belief.detected = sure if state.detected is None else np.array(state.detected, dtype=bool).reshape(shape)
    belief.searches = np.array(state.searched if state.searches is None else state.searches, dtype=np.int64)
    belief.failures = {(container, obj): count for container, obj, count in state.failures}
    live.seen_s = np.array([[-np.inf if at is None else at for at in row] for row in state.seen_s]).reshape(shape)
    live.barriers, live.map_version = dict(state.barriers), state.map_version
    if live.barriers:
        team.use_map(barred_map(setup.home_map, list(live.barriers.values())))
    team.time_s, team.state, team.news, team.start = state.time_s, state.state, state.news, state.start
    team.letters = list(state.letters)
    team.robots = [
        replace(
            team.new_robot(one.position),
            place=one.place,
            act=Act(one.mode, float("inf") if one.until_s is None else one.until_s, one.obj),
            assignment=Assignment(one.container, one.interaction),
            since_s=one.since_s,
            moved_s=one.moved_s,
            route=plan_route(team.home_map, one.position, one.container) if one.under_way else None,
            passed=one.passed,
            legs=list(one.legs),
        )
        for one in state.robots
    ]
    live.heard_s = [one.heard_s for one in state.robots]
    live.decisions, live.orders, live.told = state.decisions, state.orders, dict(state.told)
    live.busy, live.ended, live.surprise = set(state.busy), list(state.ended), state.surprise
    live.ids = dict.fromkeys(state.ids)
    return live
