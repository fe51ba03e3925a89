"""The compiled loops of `mrtask.bounds.team_bound`; sets of n containers are bit masks."""

import numpy as np

from mrtask.arrays import Floats
from mrtask.planning.compiled import compiled


@compiled
def shortest_ways(travel_s: Floats, start_s: Floats, ending: Floats, result: Floats) -> None:
    """Find the shortest way through each set (Held and Karp 1962).

    ``result`` [2^n] holds the lengths, and ``ending`` [2^n, n] those by last container. ``travel_s`` [n, n] and
    ``start_s`` [n] include the time spent on arrival.
    """
    n = start_s.size
    for visited in range(1, 1 << n):
        result[visited] = np.inf
        for last in range(n):
            ending[visited, last] = np.inf
            if not (visited >> last) & 1:
                continue
            before = visited & ~(1 << last)
            if before == 0:
                ending[visited, last] = start_s[last]
            for previous in range(n):
                if (before >> previous) & 1:
                    way_s = ending[before, previous] + travel_s[previous, last]
                    ending[visited, last] = min(ending[visited, last], way_s)
            result[visited] = min(result[visited], ending[visited, last])


@compiled
def divide(team_s: Floats, one_s: Floats, result: Floats) -> None:
    """Find, for each set, the least time in which a team and one more robot can visit it together.

    ``result`` is [2^n].
    """
    for visited in range(result.size):
        best_s = team_s[visited]
        share = visited
        while share > 0:
            best_s = min(best_s, max(one_s[share], team_s[visited & ~share]))
            share = (share - 1) & visited
        result[visited] = best_s
