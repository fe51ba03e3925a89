"""The compiled dynamic programmes of `mrtask.bounds.one_robot`.

Legend: n hidden containers, numbered first among P places; the other places are known to hold something. O objects, Z
automaton states. A set S of searched containers and sets of objects are bit masks. Each object that may have to wait
for its turn has a digit in the number L: 0 while the robot has not found the object, else 1 + the container that holds
it.
"""

from typing import NamedTuple

import numpy as np

from mrtask.arrays import Floats, Int32s, Ints, UInt8s
from mrtask.planning.compiled import compiled, inlined
from mrtask.planning.shared_kernel import NONE


class Search(NamedTuple):
    """A one-robot search and scratch space for it."""

    travel_s: Floats  # [P + 1, P] the last row starts at the robot's position
    prob: Floats  # [n, O]
    nowhere: Floats  # [2^n, O] probability that no container outside S holds an object
    known: Ints  # [P] mask of the objects that a place is known to hold, 0 for the first n
    transitions: Int32s  # [Z, O]
    accepting: UInt8s  # [Z]
    advancing: Ints  # [Z] mask
    safe: Ints  # [Z] mask
    needed: Ints  # [Z] mask
    steps: Int32s  # [Z]
    order: Int32s  # [Z] the states in order of steps, without the accepting ones and the sink
    nearer_only: bool  # whether every advancing letter leads nearer to acceptance
    known_mask: int  # mask of the objects that some place is known to hold
    waiting_mask: int  # mask of the objects that may have to wait for their turn
    stride: Ints  # [O] weight of an object's digit in L, 0 for an object without a digit
    locations: int  # number of values of L
    search_time_s: float
    interact_time_s: float
    relevant: Int32s  # [O] scratch
    costs: Floats  # [n] scratch


@inlined
def _digit(search: Search, locations: int, obj: int) -> int:
    return int((locations // search.stride[obj]) % (search.prob.shape[0] + 1))


@inlined
def _settled_state(search: Search, z: int, held: int) -> int:
    """Return the state after the harmless interactions with ``held`` that lead nearer to acceptance, nearest first."""
    objects = search.prob.shape[1]
    while True:
        best = NONE
        here = held & search.safe[z]
        for obj in range(objects):
            if (here >> obj) & 1:
                steps = search.steps[search.transitions[z, obj]]
                if steps < search.steps[z] and (best == NONE or steps < search.steps[search.transitions[z, best]]):
                    best = obj
        if best == NONE:
            return z
        z = search.transitions[z, best]


@inlined
def _value_after(search: Search, value: Floats, searched: int, z: int, settled: int, locations: int, c: int) -> float:
    """Return `value` once the robot, at c, has done what leads from state z to ``settled``.

    Each letter on that way is one step nearer to acceptance.
    """
    letters_s = float(search.interact_time_s * (search.steps[z] - search.steps[settled]))
    if search.accepting[settled]:
        return letters_s
    return letters_s + float(value[searched, settled, locations, c])


@inlined
def _list_relevant(search: Search, z: int, locations: int, every_copy: bool) -> int:
    """Fill ``search.relevant`` with the objects whose presence in a container matters, and return their number."""
    count = 0
    for obj in range(search.prob.shape[1]):
        if not (search.needed[z] >> obj) & 1:
            continue
        if (search.waiting_mask >> obj) & 1 and (
            search.stride[obj] == 0 or (not every_copy and _digit(search, locations, obj) > 0)
        ):
            continue
        search.relevant[count] = obj
        count += 1
    return count


@inlined
def _presence_prob(search: Search, searched: int, found: int, c: int, obj: int) -> float:
    """Return the probability that a container holds an object, given what was found in the searched ones."""
    if (found >> obj) & 1:
        return float(search.prob[c, obj])
    return float(min(search.prob[c, obj] / (1.0 - search.nowhere[searched, obj]), 1.0))


@inlined
def _expected_s(search: Search, value: Floats, searched: int, z: int, locations: int, c: int) -> float:
    """Return the mean of `value` after a search of c in the simplified problem."""
    count = _list_relevant(search, z, locations, False)
    total_s = 0.0
    for bits in range(1 << count):
        weight, held, after = 1.0, 0, locations
        for i in range(count):
            obj = search.relevant[i]
            prob = _presence_prob(search, searched, search.known_mask, c, obj)
            if (bits >> i) & 1:
                weight *= prob
                held |= 1 << obj
                after += search.stride[obj] * (c + 1)
            else:
                weight *= 1.0 - prob
        if weight > 0.0:
            settled = _settled_state(search, z, held)
            total_s += weight * _value_after(search, value, searched | (1 << c), z, settled, after, c)
    return total_s


@inlined
def _locations_valid(search: Search, searched: int, locations: int) -> bool:
    for obj in range(search.prob.shape[1]):
        if search.stride[obj] > 0:
            digit = _digit(search, locations, obj)
            if digit > 0 and not (searched >> (digit - 1)) & 1:
                return False
    return True


@compiled
def solve_simplified(search: Search, value: Floats) -> None:
    """Fill ``value`` [2^n, Z, L, P] with the least expected time to go in the simplified problem.

    That problem remembers one copy of each object that may have to wait. Dead ends, to which no world leads, have the
    value 0.
    """
    n, places = search.prob.shape[0], search.known.size
    for searched in range((1 << n) - 1, -1, -1):
        for locations in range(search.locations):
            if not _locations_valid(search, searched, locations):
                continue
            for i in range(search.order.size):
                z = search.order[i]
                if _list_relevant(search, z, locations, False) == 0:
                    for c in range(n):
                        search.costs[c] = np.inf
                else:
                    for c in range(n):
                        if not (searched >> c) & 1:
                            expected_s = _expected_s(search, value, searched, z, locations, c)
                            search.costs[c] = search.search_time_s + expected_s
                for place in range(places):
                    if place < n and not (searched >> place) & 1:
                        continue
                    best_s = np.inf
                    for c in range(n):
                        if not (searched >> c) & 1:
                            best_s = min(best_s, search.travel_s[place, c] + search.costs[c])
                    for obj in range(search.prob.shape[1]):
                        after = search.transitions[z, obj]
                        if not (search.advancing[z] >> obj) & 1 or search.steps[after] >= search.steps[z]:
                            continue
                        if search.stride[obj] > 0:
                            c = _digit(search, locations, obj) - 1
                            if c >= 0:
                                to_go_s = 0.0 if search.accepting[after] else value[searched, after, locations, c]
                                best_s = min(best_s, search.travel_s[place, c] + search.interact_time_s + to_go_s)
                        for c in range(n, places):
                            if (search.known[c] >> obj) & 1:
                                to_go_s = 0.0 if search.accepting[after] else value[searched, after, locations, c]
                                best_s = min(best_s, search.travel_s[place, c] + search.interact_time_s + to_go_s)
                    value[searched, z, locations, place] = best_s if best_s < np.inf else 0.0


@inlined
def _guess_s(search: Search, value: Floats, world: Ints, before: int, z: int, c: int, held: int) -> float:
    """Return the approximate time to go after the robot, in state z, has found ``held`` in c.

    The robot knows what ``world`` has in the containers searched ``before``. Of an object's known copies, the one that
    makes the time least counts as remembered, object by object. Whatever the result is, it is a function of what the
    robot knows.
    """
    n, settled = search.prob.shape[0], _settled_state(search, z, held)
    locations = 0
    for obj in range(search.prob.shape[1]):
        if search.stride[obj] > 0:
            if (held >> obj) & 1:
                locations += search.stride[obj] * (c + 1)
            else:
                for other in range(n):
                    if (before >> other) & 1 and (world[other] >> obj) & 1:
                        locations += search.stride[obj] * (other + 1)
                        break
    best_s = _value_after(search, value, before | (1 << c), z, settled, locations, c)
    for obj in range(search.prob.shape[1]):
        if search.stride[obj] > 0:
            for other in range(n):
                if (before >> other) & 1 and (world[other] >> obj) & 1:
                    tried = locations + search.stride[obj] * (other + 1 - _digit(search, locations, obj))
                    tried_s = _value_after(search, value, before | (1 << c), z, settled, tried, c)
                    if tried_s < best_s:
                        best_s, locations = tried_s, tried
    return best_s


@inlined
def _penalty_s(search: Search, value: Floats, world: Ints, searched: int, found: int, z: int, c: int) -> float:
    """Return the mean of `_guess_s` over what a search of c may find, minus its value for what ``world`` has there.

    This assumes that the robot did everything that it could do at once: a robot that knows the world gains nothing by
    leaving it undone.
    """
    z = _settled_state(search, z, found & ~search.waiting_mask)
    if search.accepting[z]:
        return 0.0
    count = _list_relevant(search, z, 0, True)
    mean_s, relevant = 0.0, 0
    for bits in range(1 << count):
        weight, held = 1.0, 0
        for i in range(count):
            obj = search.relevant[i]
            prob = _presence_prob(search, searched, found | search.known_mask, c, obj)
            relevant |= 1 << obj
            if (bits >> i) & 1:
                weight *= prob
                held |= 1 << obj
            else:
                weight *= 1.0 - prob
        if weight > 0.0:
            mean_s += weight * _guess_s(search, value, world, searched, z, c, held)
    return mean_s - _guess_s(search, value, world, searched, z, c, world[c] & relevant)


@compiled
def solve_world(search: Search, value: Floats, world: Ints, cost: Floats, penalty: Floats) -> None:
    """Solve the penalised problem of a robot that knows the world.

    ``world`` [n] holds masks of the containers' contents. Fill ``cost`` [2^n, Z, P + 1] with the least time to go
    including all later penalties, and ``penalty`` [2^n, Z, n] with the penalty for searching a container after those in
    S.
    """
    n, places = search.prob.shape[0], search.known.size
    for searched in range((1 << n) - 1, -1, -1):
        found = 0
        for c in range(n):
            if (searched >> c) & 1:
                found |= world[c]
        for i in range(search.order.size):
            z = search.order[i]
            for c in range(n):
                if not (searched >> c) & 1:
                    penalty[searched, z, c] = _penalty_s(search, value, world, searched, found, z, c)
            for place in range(places + 1):
                cost[searched, z, place] = np.inf
        improved = True
        while improved:
            improved = False
            for i in range(search.order.size):
                z = search.order[i]
                for place in range(places + 1):
                    if (place < n and not (searched >> place) & 1) or (place == places and searched > 0):
                        continue
                    best_s = cost[searched, z, place]
                    for c in range(n):
                        if not (searched >> c) & 1:
                            to_go_s = search.search_time_s + penalty[searched, z, c] + cost[searched | (1 << c), z, c]
                            best_s = min(best_s, search.travel_s[place, c] + to_go_s)
                    for obj in range(search.prob.shape[1]):
                        if not (search.advancing[z] >> obj) & 1:
                            continue
                        after = search.transitions[z, obj]
                        for c in range(places):
                            here = search.known[c]
                            if c < n:
                                here = world[c] if (searched >> c) & 1 else 0
                            if (here >> obj) & 1:
                                to_go_s = 0.0 if search.accepting[after] else cost[searched, after, c]
                                best_s = min(best_s, search.travel_s[place, c] + search.interact_time_s + to_go_s)
                    if best_s < cost[searched, z, place]:
                        cost[searched, z, place] = best_s
                        improved = not search.nearer_only
