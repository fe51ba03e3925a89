"""The least makespan of a team that knows where everything is.

A run spells a word of the automaton; robots at containers perform its letters. Between two letters, a robot can do no
better than drive straight to its next container without delay. Dijkstra's algorithm over the states (automaton state,
where and when each robot finished its last letter) therefore finds the least makespan. A letter is complete once its
robot has arrived and interacted, and never before the letters that precede it in the word.

The result is exact when searches take no time, and always exact for one robot. For teams with ``search_time_s > 0`` it
is a lower bound: a letter only has to wait until the first robot could have reached and searched its container, as if
the search took none of the robots' time. (The robot itself, or another one before it, must have searched there.) With
``interact_time_s > 0``, a letter may begin as soon as its object first advanced the task; no run can be faster.
"""

from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from math import inf

import numpy as np

from mrtask.arrays import Bools
from mrtask.planning.solver_belief import Belief

Robots = tuple[tuple[int, float], ...]
"""For each robot, in sorted order, the container of its last letter and the time at which that letter was complete.

A robot that has performed no letter yet is at ``-1 - row`` of `Belief.start_s`. Robots that start together share a row,
which makes them interchangeable.
"""


@dataclass(frozen=True)
class Letter:
    """A letter of a fastest run."""

    obj: int
    container: int
    row: int
    """The row of `Belief.start_s` from which its robot came, or -1 if it is not the robot's first letter. The first of
    the robots that start together stands for all."""
    before: "Letter | None"
    """The letter before this one in the word."""


@dataclass(frozen=True)
class Run:
    """A fastest run."""

    makespan_s: float
    """inf if the task cannot be done."""
    rows: tuple[int, ...]
    """[R] the row of `Belief.start_s` that stands for each robot."""
    last: Letter | None = None
    """The last letter of the word."""


class TooManyStatesError(Exception):
    """The search for a fastest run was given up at its limit."""


def clairvoyant_s(belief: Belief, world: Bools, free: frozenset[int] = frozenset()) -> float:
    """Return the least makespan in seconds with contents ``world`` [C, O], or inf if the task cannot be done.

    Letters of the objects ``free`` cost nothing and can be performed anywhere at any time.
    """
    return fastest_run(belief, world, free).makespan_s


def fastest_run(belief: Belief, world: Bools, free: frozenset[int] = frozenset(), max_states: float = inf) -> Run:
    """Return a fastest run with contents ``world`` [C, O]; ``free`` is as in `clairvoyant_s`.

    Raises:
        TooManyStatesError: more than ``max_states`` states were looked at.
    """
    automaton = belief.automaton
    objects = range(world.shape[1])
    options = [[obj for obj in objects if automaton.advancing[z, obj]] for z in range(len(automaton.transitions))]
    places = [np.flatnonzero(world[:, obj]).tolist() for obj in objects]
    travel_s, start_s = belief.travel_s.tolist(), belief.start_s.tolist()
    opening_s = (belief.start_s.min(axis=0) + belief.search_time_s).tolist()
    unsearched = belief.unsearched.tolist()
    searches = belief.search_time_s > 0 and belief.robots == 1
    overlap = belief.interact_time_s > 0
    interact_s = belief.interact_time_s

    def since_when(since: tuple[float, ...], z: int, now_s: float) -> tuple[float, ...]:
        if not overlap:
            return since
        return tuple(min(old, now_s) if obj in options[z] else old for obj, old in enumerate(since))

    rows = [start_s.index(row) for row in start_s]
    team: Robots = tuple(sorted((-1 - row, 0.0) for row in rows))
    since = since_when((inf,) * world.shape[1] if overlap else (), belief.state, 0.0)
    number = count()
    last: Letter | None = None
    queue = [(0.0, next(number), belief.state, team, frozenset[int](), since, last)]
    seen = set()
    while queue:
        now_s, _, z, team, opened, since, last = heappop(queue)
        if automaton.accepting[z]:
            return Run(now_s, tuple(rows), last)
        if (z, team, opened, since) in seen:
            continue
        seen.add((z, team, opened, since))
        if len(seen) > max_states:
            raise TooManyStatesError
        for obj in options[z]:
            after = int(automaton.transitions[z, obj])
            if obj in free:
                heappush(queue, (now_s, next(number), after, team, opened, since_when(since, after, now_s), last))
                continue
            for container in places[obj]:
                for index, (place, ready_s) in enumerate(team):
                    if index and team[index - 1] == team[index]:
                        continue
                    arrived_s = ready_s + (travel_s[place] if place >= 0 else start_s[-1 - place])[container]
                    if unsearched[container]:
                        if searches and container not in opened:
                            arrived_s += belief.search_time_s
                        arrived_s = max(arrived_s, opening_s[container])
                    begun_s = max(arrived_s, since[obj]) if overlap else arrived_s
                    done_s = max(begun_s + interact_s, now_s)
                    if done_s == inf:
                        continue
                    moved = tuple(sorted((*team[:index], (container, done_s), *team[index + 1 :])))
                    then = opened | {container} if searches else opened
                    letter = Letter(obj, container, -1 - place if place < 0 else -1, last)
                    heappush(
                        queue, (done_s, next(number), after, moved, then, since_when(since, after, done_s), letter)
                    )
    return Run(inf, tuple(rows))
