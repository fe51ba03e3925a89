"""A lower bound for one robot by information relaxation with penalties.

Source: Brown, Smith and Sun 2010, Operations Research.

**The bound.** A planner decides on what it has seen: it is non-anticipative. A robot that knows the world in advance
can do what the planner does, and better. The clairvoyant makespan is therefore a lower bound, but a loose one, because
such a robot never has to search in vain. So each search is charged a *penalty*,

    E[v(what is known after the search) | what is known before] - v(what is known after it, in this world),

for some function v of what is known. Given the past, a penalty has mean zero over what the search may find, whatever
led to that search. All penalties of a run together therefore have mean zero under every non-anticipative policy (they
are a sum of martingale differences, at most one per container), and a policy's mean makespan equals its mean penalised
makespan. In each world, the penalised makespan is at least the least penalised makespan of a robot that knows the
world; `one_robot_bound` returns the latter world by world. Its mean over worlds is thus a lower bound for every v. If v
is the true expected time to go, the bound is the optimum, and the same in every world: the penalties for finding
nothing then make foreknowledge worthless.

**The inner problem.** What a robot knows follows from the world and from the set S of containers that it has searched.
Dynamic programming over (S, automaton state, place) therefore finds the least penalised makespan exactly.

**The function v** is the optimal time to go in a simplified problem, which dynamic programming solves too. An object
with which the robot can interact for good as soon as it finds it needs no memory. For an object that may have to wait
for its turn, the simplified problem remembers the place of one copy. If no object of the task may have to wait, v is
exact, and so is the bound.

**A planner's own penalties.** If the searches of a planner in each world are given, the penalties that it was charged
are subtracted from the bound's values. This leaves their mean unchanged and keeps each value at or below the planner's
cost in that world. The two vary together, so that a few worlds show how far apart their means are.

**Too many containers.** If the sets of containers become too many, one more relaxation helps: the contents of all but
the n most promising containers are revealed at the start, to the planner too. More knowledge never makes the optimum
worse, so the mean, over what is revealed, of a lower bound for the remaining problem is itself a lower bound.
Containers that turn out useless are left out; those that hold something needed become known places.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrtask.arrays import Bools, Floats, Ints
from mrtask.bounds import one_robot_kernel as kernel
from mrtask.planning.solver_belief import Belief

MAX_TABLE_WORK = 6e8
"""The elementary steps, roughly counted, for a table of v: less than a second."""
MAX_WORLD_WORK = 1e8
"""The elementary steps for each world: a fifth of a second."""
MAX_ENTRIES = 2e7
"""The entries of the table of v: 160 MB."""


class SearchMade(NamedTuple):
    """One search of a run: the container, and the automaton's state at that time."""

    container: int
    state: int


@dataclass(frozen=True, eq=False)
class OneRobotBound:
    """The least penalised makespan in each of K worlds; their mean is the bound."""

    values_s: Floats
    """[K] values, less the penalties of the planner's own run if runs are given."""
    exact: bool
    """Whether the mean over all worlds is the optimum itself.

    This is so if no object may have to wait, no needed object was found before, and nothing was revealed.
    """


def one_robot_bound(belief: Belief, worlds: Bools, runs: Sequence[Sequence[SearchMade]] | None = None) -> OneRobotBound:
    """Return the bound for a team of one in ``worlds`` [K, C, O].

    Args:
        runs: a planner's searches in each world, in the order in which it made them.

    Raises:
        ValueError: the team has more than one robot.
    """
    if belief.robots != 1:
        raise ValueError(f"this bound is for one robot, not for {belief.robots}")
    if belief.automaton.accepting[belief.state]:
        return OneRobotBound(np.zeros(len(worlds)), exact=True)
    needed = belief.needed[belief.state]
    promising = _by_promise(belief)
    count = _affordable(belief, len(promising))
    hidden = np.zeros(len(belief.unsearched), dtype=bool)
    hidden[promising[:count]] = True
    values_s = np.empty(len(worlds))
    revealed = worlds & ~hidden[:, None] & needed
    _, groups = np.unique(revealed.reshape(len(worlds), -1), axis=0, return_inverse=True)
    for group in range(groups.max() + 1):
        members = np.flatnonzero(groups == group)
        table = Table(belief, np.flatnonzero(hidden), revealed[members[0]])
        for member in members.tolist():
            values_s[member] = table.solve(worlds[member])
            if runs is not None:
                values_s[member] -= table.paid_s(runs[member])
    known = belief.known.any(axis=0) & needed
    exact = count == len(promising) and not (known | _waiting(belief)).any() and _only_nearer(belief)
    return OneRobotBound(values_s, exact)


class Table:
    """The table of v for one outcome of what is revealed at the start.

    Args:
        hidden: the n containers whose contents stay hidden.
        known: [C, O] the contents of all other containers.
    """

    def __init__(self, belief: Belief, hidden: NDArray[np.intp], known: Bools) -> None:
        self.hidden, self._state = hidden, belief.state
        sites = np.flatnonzero(known.any(axis=1))
        places = np.concatenate([hidden, sites])
        automaton, objects = belief.automaton, known.shape[1]
        strides = np.zeros(objects, dtype=np.int64)
        locations = 1
        for obj in np.flatnonzero(_waiting(belief) & ~known.any(axis=0)):
            strides[obj] = locations
            locations *= len(hidden) + 1
        order = np.argsort(automaton.steps_to_accept, kind="stable")
        self.search = kernel.Search(
            travel_s=np.vstack([belief.travel_s[np.ix_(places, places)], belief.start_s[:1, places]]),
            prob=np.ascontiguousarray(belief.prob[hidden]),
            nowhere=products(1.0 - belief.prob[hidden]),
            known=np.concatenate([np.zeros(len(hidden), dtype=np.int64), masks(known[sites])]),
            transitions=automaton.transitions.astype(np.int32),
            accepting=automaton.accepting.astype(np.uint8),
            advancing=masks(automaton.advancing),
            safe=masks(belief.safe),
            needed=masks(belief.needed),
            steps=automaton.steps_to_accept.astype(np.int32),
            order=order[~automaton.accepting[order] & (order != automaton.sink)].astype(np.int32),
            nearer_only=_only_nearer(belief),
            known_mask=int(masks(np.asarray(known.any(axis=0)))),
            waiting_mask=int(masks(_waiting(belief))),
            stride=strides,
            locations=locations,
            search_time_s=float(belief.search_time_s),
            interact_time_s=float(belief.interact_time_s),
            relevant=np.zeros(objects, dtype=np.int32),
            costs=np.zeros(len(hidden)),
        )
        shape = (1 << len(hidden), len(automaton.transitions))
        value = np.zeros((*shape, locations, len(places)))
        kernel.solve_simplified(self.search, value)
        self._value, self._cost_s = value, np.zeros((*shape, len(places) + 1))
        self.penalty_s = np.zeros((*shape, len(hidden)))
        """[2^n, Z, n] the penalty for searching a container in the world solved last, by the set searched before."""

    def solve(self, world: Bools) -> float:
        """Return the least penalised makespan in a world [C, O]."""
        kernel.solve_world(self.search, self._value, masks(world[self.hidden]), self._cost_s, self.penalty_s)
        return float(self._cost_s[0, self._state, -1])

    def paid_s(self, run: Sequence[SearchMade]) -> float:
        """Return the sum of the penalties that a run is charged in the world solved last."""
        number = {int(container): index for index, container in enumerate(self.hidden)}
        searched, total_s = 0, 0.0
        for container, state in run:
            if container in number:
                total_s += float(self.penalty_s[searched, state, number[container]])
                searched |= 1 << number[container]
        return total_s


def masks(members: Bools) -> Ints:
    """Return the bit masks [...] of the last axis."""
    weights = np.int64(1) << np.arange(members.shape[-1], dtype=np.int64)
    return np.asarray((members * weights).sum(axis=-1), dtype=np.int64)


def _by_promise(belief: Belief) -> NDArray[np.intp]:
    """Return the unsearched containers, starting with those likeliest to hold objects that are still needed."""
    exists = np.where(belief.found, 1.0, 1.0 - belief.nowhere_prob)
    promise = (belief.prob / np.maximum(exists, belief.prob.max(axis=0)))[:, belief.needed[belief.state]].sum(axis=1)
    ranked = np.argsort(-promise, kind="stable")
    return np.asarray(ranked[belief.unsearched[ranked]])


def _affordable(belief: Belief, containers: int) -> int:
    """Return how many containers may stay hidden."""
    while containers > 1 and not _is_affordable(belief, containers):
        containers -= 1
    return containers


def _is_affordable(belief: Belief, containers: int) -> bool:
    objects = int(belief.needed[belief.state].sum())
    steps = 2.0**containers * len(belief.needed) * containers
    entries = steps * (containers + 1) ** int((_waiting(belief) & ~belief.found).sum())
    return bool(
        entries <= MAX_ENTRIES
        and entries * (2**objects + containers) <= MAX_TABLE_WORK
        and steps * (2**objects * objects + containers) <= MAX_WORLD_WORK
    )


def _waiting(belief: Belief) -> Bools:
    """Return the objects [O] that may be found at a time when the robot should not interact with them at once."""
    automaton = belief.automaton
    steps = automaton.steps_to_accept
    at_once = belief.safe & (steps[automaton.transitions] < steps[:, None])
    return np.asarray((belief.needed & ~at_once)[_reached(belief)].any(axis=0))


def _only_nearer(belief: Belief) -> bool:
    """Return whether every interaction that advances the task leads nearer to acceptance."""
    steps = belief.automaton.steps_to_accept
    nearer = steps[belief.automaton.transitions] < steps[:, None]
    return bool((nearer | ~belief.automaton.advancing)[_reached(belief)].all())


def _reached(belief: Belief) -> list[int]:
    """Return the states that may come, starting with the present one."""
    automaton = belief.automaton
    reached = [belief.state]
    for state in reached:
        after = automaton.transitions[state, automaton.advancing[state]].tolist()
        reached += [one for one in dict.fromkeys(after) if one not in reached]
    return reached


def products(factors: Floats) -> Floats:
    """Return the product [2^n, O] of ``factors`` [n, O] over the rows that are not in each set."""
    result = np.ones((1, factors.shape[1]))
    for row in factors:
        result = np.concatenate([result * row, result])
    return result
