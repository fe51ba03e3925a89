"""Estimate the value of the rest of a task at a leaf of `pouct_paper`'s tree.

It is zero, a bound on the remaining time, or the time of a greedy rollout.

Legend: R robots, C containers, O objects. Sets of objects are bit masks.
"""

from typing import NamedTuple

import numpy as np

from mrtask.arrays import Floats, Ints, UInt64s
from mrtask.planning import team_kernel as team
from mrtask.planning.compiled import inlined, random_unit
from mrtask.planning.greedy_kernel import GreedyPolicy, rollout
from mrtask.planning.paper.belief_kernel import LOCATED, PaperBelief, PaperModel, distance_s
from mrtask.planning.shared_kernel import AUTOMATON, NONE

ZERO, NEAREST, REVEALED = 0, 1, 2
NEGLIGIBLE_PROB = 1e-12
"""The bound ignores what is less probable than this."""


class Bound(NamedTuple):
    """The kind of bound that leaves have, and scratch space for it."""

    kind: int  # ZERO, NEAREST or REVEALED
    nearest_s: Floats  # [C] seconds that the nearest robot needs
    order: Ints  # [C] the containers, starting with the nearest
    nowhere: Floats  # [O]
    rest_s: Floats  # [O] seconds until each object is finished


class Rollouts(NamedTuple):
    """The greedy policy and the world in which it finishes the task."""

    model: team.Model
    world: team.World  # scratch
    greedy: GreedyPolicy


@inlined
def _sort_by_distance(model: PaperModel, belief: PaperBelief, bound: Bound) -> None:
    """Fill ``nearest_s``, counted from where robots are or will arrive, and sort ``order`` by it (insertion sort)."""
    for c in range(belief.containers.size):
        bound.nearest_s[c] = np.inf
    for r in range(belief.robots.size):
        ready_s = 0.0 if belief.robots[r].obj == NONE else max(belief.robots[r].arrive_s - belief.clock[0], 0.0)
        for c in range(belief.containers.size):
            bound.nearest_s[c] = min(bound.nearest_s[c], ready_s + distance_s(model, belief, r, c))
    for c in range(belief.containers.size):
        here_s, spot = bound.nearest_s[c], c
        while spot > 0 and bound.nearest_s[bound.order[spot - 1]] > here_s:
            bound.order[spot] = bound.order[spot - 1]
            spot -= 1
        bound.order[spot] = c


@inlined
def _fetch_times(model: PaperModel, belief: PaperBelief, bound: Bound) -> None:
    """Fill ``rest_s`` of the needed objects with the time from the nearest robot to the nearest container.

    This is the mean over the places where the object may be, given that it exists. For NEAREST, it is the time to the
    nearest place where the object may be at all.
    """
    objects = model.prob.shape[1]
    wanted = model.states[belief.state[AUTOMATON]].needed
    _sort_by_distance(model, belief, bound)
    for obj in range(objects):
        bound.nowhere[obj], bound.rest_s[obj] = 1.0, 0.0
    for spot in range(belief.containers.size):
        c = bound.order[spot]
        nearest_s = bound.nearest_s[c]
        if wanted == 0 or nearest_s == np.inf:
            break
        here = wanted & (model.possible[c] & ~belief.containers[c].absent | belief.containers[c].present)
        for obj in range(objects):
            if (here >> obj) & 1:
                prob = model.prob[c, obj]
                if bound.kind == NEAREST or (belief.containers[c].present >> obj) & 1:
                    prob = 1.0
                bound.rest_s[obj] += bound.nowhere[obj] * prob * nearest_s
                bound.nowhere[obj] *= 1.0 - prob
                if bound.nowhere[obj] < NEGLIGIBLE_PROB:
                    wanted &= ~(1 << obj)
    for obj in range(objects):
        there = 1.0 - bound.nowhere[obj]
        bound.rest_s[obj] = bound.rest_s[obj] / there if there > 0.0 else np.inf


@inlined
def bound_s(model: PaperModel, belief: PaperBelief, bound: Bound) -> float:
    """Return the time to acceptance if the team learned all contents now and fetched all objects at once.

    Each object takes its fetch time plus an interaction, or the rest of one that has begun. A set of objects takes as
    long as its slowest member, or as all its interactions divided among the robots, whichever is longer. The task takes
    as long as its fastest sufficient set.
    """
    z = belief.state[AUTOMATON]
    if model.states[z].accepting:
        return 0.0
    _fetch_times(model, belief, bound)
    robots, begun = belief.robots.size, 0
    for obj in range(model.prob.shape[1]):
        bound.rest_s[obj] += model.least_interact_time_s
    for r in range(robots):
        robot = belief.robots[r]
        obj = robot.obj
        if obj != NONE and robot.arrive_s <= belief.clock[0] and (belief.containers[robot.place].present >> obj) & 1:
            begun |= 1 << obj
            bound.rest_s[obj] = min(bound.rest_s[obj], max(robot.done_s - belief.clock[0], 0.0))
    best_s = np.inf
    for s in range(model.sufficient.shape[1]):
        members = model.sufficient[z, s]
        if members == NONE:
            break
        slowest_s, count = 0.0, 0
        for obj in range(model.prob.shape[1]):
            if (members >> obj) & 1:
                slowest_s = max(slowest_s, bound.rest_s[obj])
                if (begun >> obj) & 1 == 0:
                    count += 1
        best_s = min(best_s, max(slowest_s, (count + robots - 1) // robots * model.least_interact_time_s))
    return best_s if best_s < np.inf else model.penalty_s


@inlined
def _reveal_rest(belief: PaperBelief, rollouts: Rollouts, rng: UInt64s) -> None:
    """Set the contents of a rollout's world.

    A search reveals everything there, so the unknown contents of searched containers are drawn.
    """
    containers, objects = rollouts.model.prob.shape
    world = rollouts.world
    needed, found = rollouts.model.states[belief.state[AUTOMATON]].needed, belief.state[LOCATED]
    for o in range(objects):
        world.nowhere[o] = 1.0
        for c in range(containers):
            if ((belief.containers[c].present | belief.containers[c].absent) >> o) & 1 == 0:
                world.nowhere[o] *= 1.0 - rollouts.model.prob[c, o]
    for c in range(containers):
        known, container = belief.containers[c], world.containers[c]
        container.searched, container.holds, container.targeted = known.searched, known.present, 0
        if known.searched == 0:
            continue
        for o in range(objects):
            if (needed & ~(known.present | known.absent)) >> o & 1:
                prob = rollouts.model.prob[c, o]
                exists = 1.0 if (found >> o) & 1 else 1.0 - world.nowhere[o]
                if random_unit(rng) * exists < prob:
                    container.holds |= 1 << o
                    found |= 1 << o
                world.nowhere[o] = min(world.nowhere[o] / (1.0 - prob), 1.0)
    world.state[team.FOUND] = found
    world.state[team.SEEN] = found


@inlined
def _place_robots(belief: PaperBelief, rollouts: Rollouts) -> None:
    """Let the robots of a rollout's world do what those of the belief do."""
    world, clock_s = rollouts.world, belief.clock[0]
    state = rollouts.model.states[belief.state[AUTOMATON]]
    for r in range(belief.robots.size):
        ours, theirs = belief.robots[r], world.robots[r]
        place, obj = ours.place, ours.obj
        theirs.mode, theirs.place, theirs.undecided = team.FREE, place, ours.undecided
        theirs.want, theirs.doing, theirs.until_s = NONE, NONE, np.inf
        theirs.since_s = ours.since_s
        theirs.origin = NONE if place == NONE else theirs.rows + place
        if ours.under_way:
            theirs.mode, theirs.until_s, theirs.origin = team.MOVING, ours.reach_s, ours.origin
        elif obj != NONE:
            world.containers[place].targeted += 1
            if (state.advancing & ~state.safe) >> obj & 1:
                theirs.want = obj
            if ours.reach_s > clock_s:
                theirs.mode, theirs.until_s, theirs.origin = team.MOVING, ours.reach_s, ours.origin
            elif belief.containers[place].searched == 0 or ours.arrive_s > clock_s:
                theirs.mode, theirs.until_s = team.SEARCHING, max(ours.arrive_s, clock_s)
            elif (belief.containers[place].present & state.advancing) >> obj & 1:
                theirs.mode, theirs.doing, theirs.until_s = team.INTERACTING, obj, max(ours.done_s, clock_s)
            else:
                theirs.mode, theirs.until_s = team.MOVING, clock_s
        if theirs.origin == NONE:
            for c in range(belief.containers.size):
                world.away[r, c] = belief.away[r, c]


@inlined
def greedy_rest_s(belief: PaperBelief, rollouts: Rollouts, rng: UInt64s) -> float:
    """Return how long the greedy policy takes to finish the task in a world drawn from the belief."""
    rollouts.world.clock[0] = belief.clock[0]
    rollouts.world.state[AUTOMATON] = belief.state[AUTOMATON]
    rollouts.world.state[team.HISTORY], rollouts.world.state[team.NEWS] = 0, 0
    _reveal_rest(belief, rollouts, rng)
    _place_robots(belief, rollouts)
    outcome = rollout(rollouts.model, rollouts.world, rollouts.greedy, rng)
    rest_s = rollouts.world.clock[0] - belief.clock[0]
    return rest_s + rollouts.model.penalty_s if outcome == team.STUCK else rest_s


@inlined
def rest_s(model: PaperModel, belief: PaperBelief, bound: Bound, rollouts: Rollouts | None, rng: UInt64s) -> float:
    """Return the value of the remaining task, in seconds.

    Without ``rollouts``, their kernel is not compiled either.
    """
    if rollouts is not None:
        return greedy_rest_s(belief, rollouts, rng)
    if bound.kind == ZERO:
        return 0.0
    return bound_s(model, belief, bound)
