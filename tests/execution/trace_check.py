"""An episode's trace checked from scratch: it knows the truth, the geometry and LTL, not the simulation."""

from itertools import pairwise
from math import dist

import numpy as np
from scipy.spatial import cKDTree

from tests.tasks.naive_ltl import is_good_prefix

TOLERANCE = 1e-6
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
    access = {
        container.id: home_map.cell_center(tuple(cell))
        for container, cell in zip(home.containers, home_map.access, strict=True)
    }
    contents = {container.id: container.objects for container in home.containers}
    free_cells = cKDTree(np.transpose(home_map.cell_center(np.nonzero(home_map.free))))
    assert len(trace.robots) == trial.team.robots
    assert dist(trace.start, home_map.cell_center(trial.start_cell)) < TOLERANCE
    ends = [leg.t1_s for legs in trace.robots for leg in legs]
    for legs in trace.robots:
        _check_legs(trial, trace.start, legs, access, free_cells, home_map.resolution_m, max([0.0, *ends]))
    searches = [leg for legs in trace.robots for leg in legs if leg.kind == "search"]
    for letter in trace.letters:
        assert letter.object in contents[letter.container], "the object is not there"
        standing = [
            leg
            for leg in trace.robots[letter.robot]
            if leg.kind == "interact" and abs(leg.t1_s - letter.t_s) < TOLERANCE and leg.object == letter.object
        ]
        assert standing and standing[0].container == letter.container, "no interaction leg for the letter"
        assert abs(standing[0].t1_s - standing[0].t0_s - trial.team.spec.interact_time_s) < TOLERANCE
        if not known:
            assert any(
                leg.container == letter.container and leg.t1_s <= standing[0].t0_s + TOLERANCE for leg in searches
            ), "interaction before the container was searched"
    word = tuple(letter.object for letter in trace.letters)
    assert [letter.t_s for letter in trace.letters] == sorted(letter.t_s for letter in trace.letters)
    formula = FORMULAS[trial.template](*trial.objects)
    if result.status == "accepted":
        assert is_good_prefix(formula, word, trial.objects)
        assert not any(is_good_prefix(formula, word[:length], trial.objects) for length in range(len(word)))
        assert abs(result.cost_s - max([0.0, *ends])) < TOLERANCE
        assert abs(result.cost_s - (trace.letters[-1].t_s if word else 0.0)) < TOLERANCE
    else:
        assert result.cost_s is None and result.error
        assert not is_good_prefix(formula, word, trial.objects)


def _check_legs(trial, start, legs, access, free_cells, resolution_m, end_s):
    clock, place = 0.0, start
    for leg in legs:
        assert abs(leg.t0_s - clock) < TOLERANCE, "time not continuous"
        assert leg.t1_s >= leg.t0_s
        assert dist(leg.path[0], place) < TOLERANCE, "position not continuous"
        length_m = sum(dist(*ends) for ends in pairwise(leg.path))
        assert length_m <= trial.team.spec.speed_m_per_s * (leg.t1_s - leg.t0_s) + 1e-5, "faster than the robot"
        if leg.kind != "move":
            assert len(leg.path) == 1, "only moves have a way"
        if leg.kind in ("search", "interact"):
            assert dist(leg.path[0], access[leg.container]) < TOLERANCE, "not at the container"
        if leg.kind == "search":
            short_s = trial.team.spec.search_time_s - (leg.t1_s - leg.t0_s)
            cut_off = short_s > 0 and abs(leg.t1_s - end_s) < TOLERANCE
            assert cut_off or abs(short_s) < TOLERANCE, "a search of another length"
        points = [np.linspace(p, q, 2 + int(dist(p, q) / (resolution_m / 3))) for p, q in pairwise(leg.path)]
        if points:
            off_m, _ = free_cells.query(np.concatenate(points))
            assert off_m.max() <= resolution_m * np.sqrt(0.5) + TOLERANCE, "off the free cells"
        clock, place = leg.t1_s, leg.path[-1]
