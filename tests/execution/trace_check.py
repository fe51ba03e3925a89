"""An episode's trace checked from scratch: it knows the truth, the geometry and LTL, not the simulation."""

from itertools import combinations_with_replacement, pairwise, product
from math import ceil, dist, floor

import numpy as np
from scipy.spatial import cKDTree

from mrtask.maps.home_map import build_map
from tests.tasks.naive_ltl import is_good_prefix

TOLERANCE = 1e-6
ROUNDED_M = 1e-4
"""The map keeps its lengths in single precision."""
PLACE_DIGITS = 6
"""The digits, in cells, to which a robot stands at a cell's centre."""
FORMULAS = {
    "and2": lambda a, b: ("&", ("F", a), ("F", b)),
    "and3": lambda a, b, c: ("&", ("F", a), ("F", b), ("F", c)),
    "and_or": lambda a, b, c: ("&", ("F", a), ("|", ("F", b), ("F", c))),
    "seq2": lambda a, b: ("&", ("U", ("!", b), a), ("F", b)),
    "seq3": lambda a, b, c: ("&", ("U", ("&", ("!", c), ("!", b)), a), ("U", ("!", c), b), ("F", c)),
    "or_seq": lambda a, b, c, d: (
        "&",
        ("|", ("U", ("&", ("!", c), ("!", d)), a), ("U", ("&", ("!", c), ("!", d)), b)),
        ("U", ("!", d), c),
        ("F", d),
    ),
}


def check_trace(trial, home, home_map, result, *, known=False):
    """Raises AssertionError where the trace breaks a rule of the world."""
    trace = result.trace
    contents = {container.id: container.objects for container in home.containers}
    assert len(trace.robots) == trial.team.robots, "a robot is missing"
    ends = [leg.t1_s for legs in trace.robots for leg in legs]
    for number, (member, legs) in enumerate(zip(trial.team.members, trace.robots, strict=True)):
        own_map = map_for(member, home, home_map)
        free_cells = cKDTree(np.transpose(own_map.cell_center(np.nonzero(own_map.free))))
        wanted = home_map.cell_center(trial.start_cell) if member.start_m is None else member.start_m
        away_m, _ = free_cells.query(wanted)
        as_the_first = number == 0 or (member.start_m is None and away_m < TOLERANCE and trace.start == wanted)
        start = trace.start if as_the_first or not legs else legs[0].path[0]
        assert abs(dist(start, wanted) - away_m) < TOLERANCE, "another start"
        _check_legs(member, home, start, legs, own_map, free_cells, max([0.0, *ends]))
        _check_ways(home, own_map, legs)
    searches = [leg for legs in trace.robots for leg in legs if leg.kind == "search"]
    for letter in trace.letters:
        assert letter.object in contents[letter.container], "the object is not there"
        standing = [
            leg
            for leg in trace.robots[letter.robot]
            if leg.kind == "interact" and abs(leg.t1_s - letter.t_s) < TOLERANCE and leg.object == letter.object
        ]
        assert standing and standing[0].container == letter.container, "no interaction leg for the letter"
        member = trial.team.members[letter.robot]
        assert member.handles is None or letter.object in member.handles, "touches what it does not handle"
        short_s = member.interact_time_s - (standing[0].t1_s - standing[0].t0_s)
        assert abs(short_s) < TOLERANCE, "an interaction of another length"
        if not known:
            assert any(
                leg.container == letter.container and leg.t1_s <= standing[0].t0_s + TOLERANCE for leg in searches
            ), "interaction before the container was searched"
    word = tuple(letter.object for letter in trace.letters)
    times = [letter.t_s for letter in trace.letters]
    assert times == sorted(times), "letters out of order"
    formula = FORMULAS[trial.template](*trial.objects)
    if result.status == "accepted":
        assert is_good_prefix(formula, word, trial.objects), "the task is not done"
        early = any(is_good_prefix(formula, word[:length], trial.objects) for length in range(len(word)))
        assert not early, "the task was done before"
        assert abs(result.cost_s - max([0.0, *ends])) < TOLERANCE, "another cost"
        assert abs(result.cost_s - (trace.letters[-1].t_s if word else 0.0)) < TOLERANCE, "another cost"
    else:
        assert result.cost_s is None and result.error
        assert not is_good_prefix(formula, word, trial.objects), "the task is done"


def map_for(member, home, home_map):
    """The map for a robot of this width."""
    ways = "shortest" if home_map.steps is None else "soft"
    return home_map if member.radius_m is None else build_map(home, home_map.resolution_m, member.radius_m, ways)


def _check_legs(member, home, start, legs, own_map, free_cells, end_s):
    access = {
        container.id: own_map.cell_center(tuple(cell))
        for container, cell in zip(home.containers, own_map.access, strict=True)
    }
    types, resolution_m = {container.id: container.type for container in home.containers}, own_map.resolution_m
    clock, place, speed = 0.0, start, member.speed_m_per_s
    for leg in legs:
        assert abs(leg.t0_s - clock) < TOLERANCE, "time not continuous"
        assert leg.t1_s >= leg.t0_s, "time runs backwards"
        assert dist(leg.path[0], place) < TOLERANCE, "position not continuous"
        if leg.kind == "move":
            assert _length_m(leg) <= speed * (leg.t1_s - leg.t0_s) + ROUNDED_M, "faster than the robot"
            assert _length_m(leg) >= speed * (leg.t1_s - leg.t0_s) - ROUNDED_M, "slower than the robot"
        else:
            assert len(leg.path) == 1, "only moves have a way"
        if leg.kind in ("search", "interact"):
            assert dist(leg.path[0], access[leg.container]) < TOLERANCE, "not at the container"
            assert member.opens is None or types[leg.container] in member.opens, "opens what it cannot"
        if leg.kind == "search":
            short_s = member.search_time_s - (leg.t1_s - leg.t0_s)
            cut_off = short_s > 0 and abs(leg.t1_s - end_s) < TOLERANCE
            assert cut_off or abs(short_s) < TOLERANCE, "a search of another length"
        points = [np.linspace(p, q, 2 + int(dist(p, q) / (resolution_m / 3))) for p, q in pairwise(leg.path)]
        if points:
            off_m, _ = free_cells.query(np.concatenate(points))
            assert off_m.max() <= resolution_m * np.sqrt(0.5) + TOLERANCE, "off the free cells"
        clock, place = leg.t1_s, leg.path[-1]
    assert abs(clock - end_s) < TOLERANCE, "the legs end before the episode"


def _check_ways(home, home_map, legs):
    """Each drive leads by the shortest way to its container, or by as much of it as there was time for."""
    number = {container.id: index for index, container in enumerate(home.containers)}
    for leg in legs:
        if leg.kind == "move":
            whole_m, left_m = (_way_m(home_map, place, number[leg.container]) for place in (leg.path[0], leg.path[-1]))
            assert abs(_length_m(leg) + left_m - whole_m) < ROUNDED_M, "not the shortest way"


def _way_m(home_map, place, container):
    """The length of the way from a place, at a cell's centre or between two neighbours, to a container."""
    corner = np.array(home_map.cell_center((0, 0)))
    col, row = np.round((np.array(place) - corner) / home_map.resolution_m, PLACE_DIGITS)
    around = [*product({floor(row), ceil(row)}, {floor(col), ceil(col)})]
    away_m = {cell: dist(place, home_map.cell_center(cell)) for cell in around}
    ways_m = {cell: away_m[cell] + home_map.distances_m(cell)[container] for cell in around}
    return min(
        min(ways_m[one], ways_m[other])
        for one, other in combinations_with_replacement(around, 2)
        if away_m[one] + away_m[other] < dist(*map(home_map.cell_center, (one, other))) + TOLERANCE
    )


def _length_m(leg):
    return sum(dist(*ends) for ends in pairwise(leg.path))
