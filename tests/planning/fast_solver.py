"""`exact_solver` again, compiled: the same expectimax on arrays, for the measurements of `regret` on many problems.

A state is a row of integers and a row of floats on a stack. Branches that cannot beat the best known are left early: a
run ends no sooner than its present clock.

Legend: R robots, C containers, O objects, Z automaton states. Sets of objects are bit masks.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from mrtask.planning.compiled import KERNEL, called, inlined
from mrtask.planning.compiler import KernelCompiler
from tests.planning.exact_solver import SAME_INSTANT_S, WAIT, ExactSolver

NONE = -1
SEARCH = -2
DEPTH = 400
Z, FREED, NEWS, SEEN, DEAD, HEADER = 0, 1, 2, 3, 4, 5
"""Of a state's integers. SEEN is a mask of the automaton's states so far. A team that comes back to one by a named
interaction could have left out what lies between: its run is DEAD."""
PLACE, TARGET, WANT, BUSY, UNDECIDED, WIDTH = 0, 1, 2, 3, 4, 5
"""A robot's integers: NONE for no place, action or wish, and while not busy; BUSY may be SEARCH or an object."""
UNTIL, DEPARTED, REACH = 0, 1, 2
"""A robot's floats, before them the clock; from REACH on the times from where it stands or departed."""
DECIDE, ADVANCE = 0, 1


class Task(NamedTuple):
    travel: np.ndarray  # [C, C]
    prob: np.ndarray  # [C, O]
    delta: np.ndarray  # [Z, O]
    accepting: np.ndarray  # [Z]
    advancing: np.ndarray  # [Z] masks
    safe: np.ndarray  # [Z] masks
    needed: np.ndarray  # [Z] masks
    steps: np.ndarray  # [Z]
    robots: int
    search_s: float
    interact_s: float


@inlined
def _robot(r, containers):
    """Where a robot's integers and floats begin."""
    return HEADER + containers + r * WIDTH, 1 + r * (REACH + containers)


@inlined
def _copy(wholes, reals, d):
    """Copy the state at depth ``d`` to the next depth."""
    for i in range(wholes.shape[1]):
        wholes[d + 1, i] = wholes[d, i]
    for i in range(reals.shape[1]):
        reals[d + 1, i] = reals[d, i]


@inlined
def _moving(whole, i):
    return whole[i + TARGET] != NONE and whole[i + BUSY] == NONE


@called
def _distance(task, whole, real, r, c):
    i, f = _robot(r, len(task.travel))
    if not _moving(whole, i):
        return real[f + REACH + c]
    ahead = real[f + UNTIL] - real[0] + task.travel[whole[i + TARGET], c]
    return min(ahead, real[0] - real[f + DEPARTED] + real[f + REACH + c])


@inlined
def _stop(task, whole, real, r):
    """A robot under way stops where it is."""
    containers = len(task.travel)
    _, f = _robot(r, containers)
    for c in range(containers):
        real[f + REACH + c] = _distance(task, whole, real, r, c)


@called
def _act(task, whole, real, r, target, want):
    i, f = _robot(r, len(task.travel))
    whole[i + UNDECIDED] = 0
    moving = _moving(whole, i)
    if moving and whole[i + TARGET] == target:
        whole[i + WANT] = want
        return
    if moving:
        _stop(task, whole, real, r)
        whole[i + PLACE] = NONE
    whole[i + TARGET], whole[i + WANT], whole[i + BUSY] = target, want, NONE
    real[f + UNTIL] = np.inf
    if target != WAIT:
        real[f + DEPARTED] = real[0]
        real[f + UNTIL] = real[0] + real[f + REACH + target]


@inlined
def _found(whole, containers):
    found = 0
    for c in range(containers):
        if whole[HEADER + c] != NONE:
            found |= whole[HEADER + c]
    return found


@inlined
def _useful(task, whole, real, r, c):
    """Whether going to a container without naming an object is an option."""
    containers, z = len(task.travel), whole[Z]
    held, needed, later = whole[HEADER + c], task.needed[z], task.needed[z] & ~task.advancing[z]
    for other in range(task.robots):
        j, _ = _robot(other, containers)
        if whole[j + TARGET] == c and whole[j + UNDECIDED] == 0:
            return False
    if _distance(task, whole, real, r, c) == np.inf:
        return False
    if held == NONE:
        missing = needed & ~_found(whole, containers)
        hopes = 0
        for o in range(task.prob.shape[1]):
            hopes += (missing >> o) & 1 and task.prob[c, o] > 0
        return hopes > 0
    i, _ = _robot(r, containers)
    place = whole[i + PLACE]
    ready = not _moving(whole, i) and place != NONE and whole[HEADER + place] != NONE and whole[HEADER + place] & later
    return (held & needed & task.safe[z]) != 0 or ((held & later) != 0 and not ready)


@inlined
def _nearest(task, whole, real, r, o):
    best = NONE
    for c in range(len(task.travel)):
        held = whole[HEADER + c]
        if (
            held != NONE
            and (held >> o) & 1
            and (best == NONE or _distance(task, whole, real, r, c) < _distance(task, whole, real, r, best))
        ):
            best = c
    return best


@inlined
def _may_wait(task, whole, r):
    for other in range(task.robots):
        j, _ = _robot(other, len(task.travel))
        if other != r and (whole[j + UNDECIDED] or whole[j + TARGET] != NONE):
            return True
    return False


@inlined
def _free(task, whole, real, r):
    i, f = _robot(r, len(task.travel))
    whole[i + TARGET], whole[i + WANT], whole[i + BUSY] = NONE, NONE, NONE
    real[f + UNTIL] = np.inf


@called
def _interact(task, whole, real, r):
    """Whether the robot begins an interaction that its action allows."""
    i, f = _robot(r, len(task.travel))
    z, here, best = whole[Z], whole[HEADER + whole[i + TARGET]], NONE
    here &= task.safe[z] if whole[i + WANT] == NONE else task.advancing[z] & (1 << whole[i + WANT])
    for o in range(task.delta.shape[1]):
        if (here >> o) & 1 and (best == NONE or task.steps[task.delta[z, o]] < task.steps[task.delta[z, best]]):
            best = o
    if best == NONE:
        return False
    whole[i + BUSY] = best
    real[f + UNTIL] = real[0] + task.interact_s
    return True


@inlined
def _wake(task, whole, real):
    for r in range(task.robots):
        i, _ = _robot(r, len(task.travel))
        place = whole[i + PLACE]
        if whole[i + TARGET] == NONE and place != NONE and whole[HEADER + place] != NONE:
            whole[i + TARGET], whole[i + WANT] = place, NONE
            if not _interact(task, whole, real, r):
                _free(task, whole, real, r)


@inlined
def _begin_or_free(task, whole, real, r):
    if not _interact(task, whole, real, r):
        _free(task, whole, real, r)
        whole[FREED] = 1


@called
def _event(task, whole, real, r):
    """Handle a robot's event; whether its container's contents are to be drawn first."""
    containers = len(task.travel)
    i, f = _robot(r, containers)
    c = whole[i + TARGET]
    if whole[i + BUSY] == NONE:
        for other in range(containers):
            real[f + REACH + other] = task.travel[c, other]
        whole[i + PLACE] = c
        if whole[HEADER + c] == NONE:
            whole[i + BUSY] = SEARCH
            if task.search_s > 0:
                real[f + UNTIL] += task.search_s
                return False
    if whole[i + BUSY] == SEARCH and whole[HEADER + c] == NONE:
        return True
    if whole[i + BUSY] >= 0:
        o, z, named = whole[i + BUSY], whole[Z], whole[i + WANT] != NONE
        news = (task.advancing[z] >> o) & 1
        if news:
            whole[Z], whole[NEWS] = task.delta[z, o], 1
        if named:
            whole[DEAD] = news and (whole[SEEN] >> whole[Z]) & 1
            _free(task, whole, real, r)
            whole[FREED] = 1
        whole[SEEN] |= 1 << whole[Z]
        if news:
            _wake(task, whole, real)
        if named:
            return False
    _begin_or_free(task, whole, real, r)
    return False


@inlined
def _weight(task, whole, c, held):
    """The probability that a container about to be searched holds these of the needed objects."""
    found, needed, weight = _found(whole, len(task.travel)), task.needed[whole[Z]], 1.0
    for o in range(task.prob.shape[1]):
        if (needed >> o) & 1:
            here = task.prob[c, o]
            if not (found >> o) & 1:
                nowhere = 1.0
                for other in range(len(task.travel)):
                    if whole[HEADER + other] == NONE:
                        nowhere *= 1.0 - task.prob[other, o]
                here /= 1.0 - nowhere
            here = min(here, 1.0)
            weight *= here if (held >> o) & 1 else 1.0 - here
        elif (held >> o) & 1:
            return 0.0
    return weight


@njit(pipeline_class=KernelCompiler, **KERNEL)  # numba crashes where it loads a recursive function from its cache
def _cost(task, wholes, reals, d, phase, bound):
    """The least expected makespan from the state at depth ``d``; any figure of at least ``bound`` if it is no less."""
    whole, real, containers = wholes[d], reals[d], len(task.travel)
    if phase == DECIDE:
        decider = NONE
        for r in range(task.robots - 1, -1, -1):
            i, _ = _robot(r, containers)
            if whole[i + UNDECIDED]:
                decider = r
        if decider == NONE:
            whole[FREED] = whole[NEWS] = 0
            return _cost(task, wholes, reals, d, ADVANCE, bound)
        tried, best = 0, bound
        for action in range(containers + task.delta.shape[1] + 1):
            target, want = action, NONE
            if action == containers + task.delta.shape[1]:
                target = WAIT
                if tried and not _may_wait(task, whole, decider):
                    continue
            elif action >= containers:
                want = action - containers
                if not ((task.advancing[whole[Z]] & ~task.safe[whole[Z]]) >> want) & 1:
                    continue
                target = _nearest(task, whole, real, decider, want)
                if target == NONE:
                    continue
            elif not _useful(task, whole, real, decider, action):
                continue
            tried += 1
            _copy(wholes, reals, d)
            _act(task, wholes[d + 1], reals[d + 1], decider, target, want)
            best = min(best, _cost(task, wholes, reals, d + 1, DECIDE, best))
        return best
    while True:
        due, until = 0, np.inf
        for r in range(task.robots):
            _, f = _robot(r, containers)
            if real[f + UNTIL] < until:
                due, until = r, real[f + UNTIL]
        if until == np.inf and not whole[FREED]:
            return np.inf
        if whole[FREED] and until > real[0] + SAME_INSTANT_S:
            for r in range(task.robots):
                i, _ = _robot(r, containers)
                whole[i + UNDECIDED] = whole[i + TARGET] == NONE or (whole[NEWS] and _moving(whole, i))
            return _cost(task, wholes, reals, d, DECIDE, bound)
        real[0] = max(real[0], until)
        if real[0] >= bound:
            return bound
        if not _event(task, whole, real, due):
            if whole[DEAD]:
                return np.inf
            if task.accepting[whole[Z]]:
                return real[0]
            continue
        i, _ = _robot(due, containers)
        c, left, total = whole[i + TARGET], 1.0, 0.0
        found = _found(whole, containers)
        for held in range(1 << task.delta.shape[1]):
            weight = _weight(task, whole, c, held)
            if weight <= 1e-12:
                continue
            _copy(wholes, reals, d)
            wholes[d + 1][HEADER + c] = held
            if held & ~found:
                wholes[d + 1][NEWS] = 1
            _begin_or_free(task, wholes[d + 1], reals[d + 1], due)
            left -= weight
            allowed = (bound - total - max(left, 0.0) * real[0]) / weight
            total += weight * _cost(task, wholes, reals, d + 1, ADVANCE, allowed)
            if total + max(left, 0.0) * real[0] >= bound:
                return bound
        return total


class FastSolver:
    """``value(joint)`` and ``optimum()`` as `ExactSolver` has them."""

    def __init__(self, problem, prob, reassign_all=True):
        slow = ExactSolver(problem, prob, reassign_all)

        def masks(sets):
            return np.array([sum(1 << o for o in objects) for objects in sets], dtype=np.int64)

        self.task = Task(
            np.ascontiguousarray(problem.travel_s),
            np.ascontiguousarray(prob),
            slow.delta.astype(np.int64),
            slow.accepting.astype(np.int64),
            masks(slow.advancing),
            masks(slow.safe),
            masks(slow.needed),
            np.asarray(slow.steps, dtype=np.int64),
            len(problem.robots),
            float(problem.search_time_s),
            float(problem.interact_time_s),
        )
        containers = len(problem.searched)
        self.wholes = np.zeros((DEPTH, HEADER + containers + WIDTH * len(problem.robots)), dtype=np.int64)
        self.reals = np.zeros((DEPTH, 1 + (REACH + containers) * len(problem.robots)))
        whole, real = self.wholes[0], self.reals[0]
        whole[Z], whole[SEEN] = slow.root.z, 1 << slow.root.z
        for c, held in enumerate(slow.root.held):
            whole[HEADER + c] = NONE if held is None else sum(1 << o for o in held)
        for r, robot in enumerate(slow.root.robots):
            i, f = _robot(r, containers)
            target, want = robot.action or (NONE, None)
            whole[i : i + WIDTH] = (
                NONE if robot.place is None else robot.place,
                target,
                NONE if want is None else want,
                NONE,
                r in slow.root.undecided,
            )
            real[f], real[f + 1], real[f + REACH : f + REACH + containers] = robot.until, robot.departed, robot.reach

    def optimum(self):
        return _cost(self.task, self.wholes, self.reals, 0, DECIDE, np.inf)

    def value(self, joint):
        """Expected makespan when the first decision is ``joint`` (robot -> container, WAIT or (container, object))."""
        before = self.wholes[0].copy(), self.reals[0].copy()
        for robot, action in joint.items():
            target, want = action if isinstance(action, tuple) else (action, NONE)
            _act(self.task, self.wholes[0], self.reals[0], robot, target, want)
        value = _cost(self.task, self.wholes, self.reals, 0, DECIDE, np.inf)
        self.wholes[0], self.reals[0] = before
        return value
