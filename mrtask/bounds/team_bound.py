"""A lower bound for teams: a bound on the makespan's distribution, from how much a team can search in a given time.

**The bound.** Let G be a set of objects of which every way to finish the task needs at least one (a single necessary
object, or the two sides of an *or*), and let none of them be found yet. Reveal all other objects, to the planner too:
more knowledge never makes the optimum worse. Only the places of the objects of G are then still to be learned. Until
the team finds the first of them, it sees nothing but "not here", so its actions until then are fixed: let A(s) be the
set that it would have searched by time s if it found nothing. Consider the worlds in which the task is done by time t.
Among them, take the one in which the first find comes last, at s. All finds of these worlds are in A(s). In that one
world the team had searched A(s), and by t it had also visited a container of each other object that the task needs. So

    P(done by t | the other objects) <= F(t) = max P(some object of G is in S),

where the maximum is over the sets S of containers that the team can search by t and that include a container of each
other necessary object. F is 0 before the clairvoyant makespan of a team that finds G wherever it likes. P(done by t) is
also at most the share of worlds whose clairvoyant makespan is at most t. The mean makespan is the integral of P(not
done by t). For every t we may use whichever of these bounds is best, provided that the choice does not depend on the
worlds on which it is evaluated.

F considers sets of n containers. To search a set, the team needs at least the time of its slowest robot's shortest way
through its share, for the best division. The other containers count as searched as soon as any robot could be there.

**What it leaves out.** With one object of G = {o} hidden at a time, the bound says nothing about two that are hidden at
once: it does not use the fact that a team which looks for both in vain must continue for both.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mrtask.arrays import Bools, Floats
from mrtask.bounds.one_robot import masks, products
from mrtask.bounds.team_bound_kernel import divide, shortest_ways
from mrtask.planning.clairvoyant import clairvoyant_s
from mrtask.planning.solver_belief import Belief

MAX_CONTAINERS = 12
"""The largest n for the sets that are searched. Dividing one among the team takes 3^n steps."""
GRID = 1024
"""The number of instants at which distributions are compared. Between two of them, the later, higher value counts."""
SAME_TIME_S = 1e-9


def team_curves(belief: Belief, worlds: Bools) -> tuple[Floats, Floats]:
    """Return upper bounds on P(done by t) on a grid of instants, one for each kind of bound.

    Returns:
        The grid [T + 1] from 0, and the curves [B, K, T]: curve b in world k, at the end of each interval of the grid.
        For any one b at each instant, their mean over worlds bounds the probability. The first kind is clairvoyance.
    """
    searches = [_HiddenGroup(belief, group) for group in _groups(belief)]
    clairvoyant = np.array([clairvoyant_s(belief, world) for world in worlds])
    longest_s = max([float(clairvoyant.max(initial=0.0)), *(search.longest_s for search in searches)])
    grid_s = np.linspace(0.0, longest_s + SAME_TIME_S, GRID + 1)
    curves = [(clairvoyant[:, None] <= grid_s[1:]).astype(np.float64)]
    for search in searches:
        curves.append(np.array([search.curve(world, grid_s[1:]) for world in worlds]))
    return grid_s, np.array(curves)


def team_bound(belief: Belief, worlds: Bools, pilot: Bools) -> Floats:
    """Return values [K] whose mean over ``worlds`` is the bound.

    The worlds ``pilot`` are others, on which the bounds are chosen.
    """
    grid_s, curves = team_curves(belief, np.concatenate([pilot, worlds]))
    choice = best_curves(curves[:, : len(pilot)])
    return integrate(grid_s, curves[:, len(pilot) :], choice)


def best_curves(curves: Floats, weights: Floats | None = None) -> NDArray[np.intp]:
    """Return, for each instant [T], the curve with the least mean over worlds [B, K, T]."""
    return np.asarray(np.argmin(np.average(curves, axis=1, weights=weights), axis=0))


def integrate(grid_s: Floats, curves: Floats, choice: NDArray[np.intp]) -> Floats:
    """Return the integral [K] of 1 - P(done by t) with the chosen curve at each instant."""
    chosen = np.take_along_axis(curves, choice[None, None, :], axis=0)[0]
    return np.asarray((1.0 - chosen) @ np.diff(grid_s))


class _HiddenGroup:
    """The bound if the objects of one group are hidden."""

    def __init__(self, belief: Belief, group: frozenset[int]) -> None:
        self._belief, self._group = belief, group
        members = sorted(group)
        prob = belief.prob[:, members]
        likeliest = np.argsort(-(1.0 - np.prod(1.0 - prob, axis=1)), kind="stable")
        likeliest = likeliest[belief.unsearched[likeliest]]
        self._inside, outside = likeliest[:MAX_CONTAINERS], likeliest[MAX_CONTAINERS:]
        self._others = [obj for obj in _necessary(belief) if obj not in group]
        self._visit_s = self._visiting_times()
        self._order = np.argsort(self._visit_s, kind="stable")
        reached_s = belief.start_s[:, outside].min(axis=0) + belief.search_time_s
        by_time = np.argsort(reached_s, kind="stable")
        self._stages_s = np.concatenate([[0.0], reached_s[by_time]])
        missed = products(1.0 - prob[self._inside])[::-1]
        left = np.cumprod(np.vstack([np.ones(len(members)), 1.0 - prob[outside][by_time]]), axis=0)
        nowhere = np.prod(1.0 - prob, axis=0)
        # [Y, 2^n] the probability that none of the group is in a set or in one of the first Y containers outside.
        unseen = np.maximum(missed[None] * left[:, None] - nowhere, 0.0) / (1.0 - nowhere)
        self._found_prob = 1.0 - np.prod(unseen, axis=-1)
        self.longest_s = float(max(self._visit_s.max(), self._stages_s[-1])) + belief.interact_time_s

    def curve(self, world: Bools, ends_s: Floats) -> Floats:
        """Return a bound [T] on P(done by t), given all but the group's objects in a world [C, O]."""
        belief = self._belief
        allowed = np.ones(len(self._visit_s), dtype=bool)
        sets = np.arange(len(self._visit_s))
        for obj in self._others:
            places = np.flatnonzero(world[:, obj])
            if np.isin(places, self._inside).all():
                allowed &= (sets & masks(np.isin(self._inside, places))) != 0
        order = self._order[allowed[self._order]]
        times_s = self._visit_s[order]
        result = np.zeros(len(ends_s))
        searching_s = ends_s - belief.interact_time_s
        for stage_s, found_prob in zip(self._stages_s, self._found_prob, strict=True):
            best = np.concatenate([[0.0], np.maximum.accumulate(found_prob[order])])
            reached = best[np.searchsorted(times_s, searching_s, side="right")]
            result = np.where(searching_s >= stage_s, np.maximum(result, reached), result)
        others_s = clairvoyant_s(belief, world, self._group)
        return np.where(ends_s >= others_s, result, 0.0)

    def _visiting_times(self) -> Floats:
        """Return the least time [2^n] in which the team can have searched each set."""
        belief, count = self._belief, len(self._inside)
        travel_s = np.ascontiguousarray(belief.travel_s[np.ix_(self._inside, self._inside)]) + belief.search_time_s
        best = np.zeros(0)
        for start_s in belief.start_s[:, self._inside] + belief.search_time_s:
            alone = np.zeros(1 << count)
            shortest_ways(travel_s, np.ascontiguousarray(start_s), np.zeros((1 << count, count)), alone)
            if len(best):
                divided = np.zeros(1 << count)
                divide(best, alone, divided)
                alone = divided
            best = alone
        return best


def _groups(belief: Belief) -> Iterator[frozenset[int]]:
    """Yield the smallest sets of one or two objects, not found yet, of which every way to finish needs at least one."""
    single = [obj for obj in _necessary(belief) if not belief.found[obj]]
    yield from (frozenset([obj]) for obj in single)
    rest = [obj for obj in np.flatnonzero(belief.needed[belief.state]) if not belief.found[obj] and obj not in single]
    yield from (frozenset(pair) for pair in combinations(map(int, rest), 2) if not _can_finish(belief, frozenset(pair)))


def _necessary(belief: Belief) -> list[int]:
    """Return the objects without which the task cannot be finished."""
    return [obj for obj in range(belief.needed.shape[1]) if not _can_finish(belief, frozenset([obj]))]


def _can_finish(belief: Belief, without: frozenset[int]) -> bool:
    """Return whether acceptance can be reached without interacting with some objects."""
    automaton = belief.automaton
    reached = [belief.state]
    for state in reached:
        for obj in range(automaton.transitions.shape[1]):
            after = int(automaton.transitions[state, obj])
            if obj not in without and after not in reached:
                reached.append(after)
    return bool(automaton.accepting[reached].any())
