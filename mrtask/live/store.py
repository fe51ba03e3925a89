"""Save a live team's state as lines of JSON, and restore it in another process.

The first line is the whole state; each line after it holds what one message changed (`mrtask.live.state_file`). A last
line that was cut off was never answered for, and is left out.

States of version 1, which know nothing of searches that err, are read too. Unknown fields are ignored, and fields that
are added later are optional.

What does not change (home, task, planner) is not in the text; a fingerprint of it is, so that no state is restored into
another task. Routes are planned again: the same map and the same start give the same route.
"""

import hashlib
import json
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
from pydantic import TypeAdapter

from mrtask.execution.acts import Act
from mrtask.execution.motion import plan_route
from mrtask.execution.setbacks import Setback, Setbacks
from mrtask.execution.trace import Leg
from mrtask.homes.home import Point
from mrtask.live.live_team import LiveTeam
from mrtask.live.saved import IDS, LEGS, PASSED, SavedRobot, SavedState, StateError, damaged, mistake, read_saved
from mrtask.live.state import LiveSetup
from mrtask.planning.problem import Assignment

STATE_VERSION: Final = 2
LEGS_JSON: Final = TypeAdapter(list[Leg])


@lru_cache(maxsize=1)
def fingerprint(setup: LiveSetup) -> str:
    """Return the fingerprint of what a saved state belongs to: the layout, the grid and the task."""
    home_map = setup.home_map
    content = [
        setup.home.layout_id, home_map.resolution_m, home_map.free.shape, int(home_map.free.sum()),
        setup.task.formula, setup.task.propositions,
    ]  # fmt: skip
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Mark:
    """A moment of a live team: what it takes to say what changed since, or to return to it."""

    fields: dict[str, Any]
    """The state as JSON, without what only grows."""
    legs: tuple[int, ...]
    """[R] how many legs each robot had."""
    passed: tuple[tuple[Point, ...], ...]
    """[R] the way that each robot had driven in its present leg."""
    taken: int
    """How many events were taken in."""


def save(live: LiveTeam) -> str:
    """Return the whole state as one line; call this between two calls of `LiveTeam.handle`."""
    return json.dumps(_fields_at(live, mark(live)), separators=(",", ":"))


def return_to(live: LiveTeam, moment: Mark) -> None:
    """Undo everything since a mark of this live team."""
    restored = _team_of(live.setup, SavedState.model_validate(_fields_at(live, moment)))
    vars(live).update(vars(restored) | {"planner": live.planner, "taken": moment.taken})


def mark(live: LiveTeam) -> Mark:
    """Return the present moment of a live team; this costs the same however long the team has worked."""
    team, belief = live.team, live.team.belief
    robots = [
        SavedRobot(
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
            obj=robot.act.obj,
            setbacks=tuple((*key, setback.count, setback.last_s) for key, setback in robot.setbacks.by.items()),
            spoke_s=live.spoke_s[number],
            silent=number in live.silent,
            beating=number in live.beating,
        )
        for number, (name, heard_s, robot) in enumerate(zip(live.names, live.heard_s, team.robots, strict=True))
    ]
    state = SavedState(
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
        barriers=live.barriers,
        start=team.start,
        decisions=live.decisions,
        orders=live.orders,
        map_version=live.map_version,
        told=live.told,
        busy=tuple(sorted(live.busy)),
        ended=tuple(live.ended),
        surprise=live.surprise,
        decided_s=live.decided_s,
        zero_s=live.clock.zero_s,
    )
    fields = state.model_dump(mode="json", exclude={IDS: True, "robots": {"__all__": {LEGS, PASSED}}})
    legs = tuple(len(robot.legs) for robot in team.robots)
    return Mark(fields, legs, tuple(robot.passed for robot in team.robots), live.taken)


def restore(setup: LiveSetup, text: str) -> LiveTeam:
    """Return the live team of a saved state: one line, or one and the changes since.

    Raises:
        StateError: a damaged text, or one of another version, home or task.
    """
    state = read_saved(text)
    if state.fingerprint != fingerprint(setup):
        raise StateError("the state is of another home, map or task; give those it was saved with, or another file")
    if (wrong := mistake(setup, state)) is not None:
        raise damaged(wrong)
    return _team_of(setup, state)


def _fields_at(live: LiveTeam, moment: Mark) -> dict[str, Any]:
    """Return the whole state as JSON, as it was at a mark."""
    robots = [
        {**fields, LEGS: LEGS_JSON.dump_python(robot.legs[:count], mode="json"), PASSED: passed}
        for fields, robot, count, passed in zip(
            moment.fields["robots"], live.team.robots, moment.legs, moment.passed, strict=False
        )
    ]
    return moment.fields | {"robots": robots, IDS: live.ids_until(moment.taken)}


def _team_of(setup: LiveSetup, state: SavedState) -> LiveTeam:
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
    live.seen_s = np.array([[-np.inf if at is None else at for at in row] for row in state.seen_s]).reshape(shape)
    live.barriers, live.map_version = dict(state.barriers), state.map_version
    team.use_map(live.barred(tuple(live.barriers.values())))
    if not 0 <= state.state < len(team.automaton.transitions):
        raise damaged(f"state is {state.state}, and the task has {len(team.automaton.transitions)}")
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
            home_map=live.map_at(one.position),
            route=plan_route(live.map_at(one.position), one.position, one.container) if one.under_way else None,
            passed=one.passed,
            legs=list(one.legs),
            setbacks=Setbacks({(at, what): Setback(count, last_s) for at, what, count, last_s in one.setbacks}),
        )
        for one in state.robots
    ]
    live.heard_s = [one.heard_s for one in state.robots]
    live.spoke_s = [one.spoke_s for one in state.robots]
    live.silent = {number for number, one in enumerate(state.robots) if one.silent}
    live.beating = {number for number, one in enumerate(state.robots) if one.beating}
    live.decisions, live.orders, live.told = state.decisions, state.orders, dict(state.told)
    live.busy, live.ended, live.surprise = set(state.busy), list(state.ended), state.surprise
    live.decided_s = state.decided_s
    live.ids = dict.fromkeys(state.ids)
    live.clock.zero_s = state.zero_s
    return live
