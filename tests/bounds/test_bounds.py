"""Bounds against the exact solver, brute force, and the theory that they rest on."""

from dataclasses import replace
from itertools import pairwise, permutations, product

import numpy as np
import pytest

from mrtask.bounds.lower_bound import BoundKind, lower_bound
from mrtask.bounds.one_robot import SearchMade, Table, one_robot_bound
from mrtask.bounds.team_bound import team_bound
from mrtask.planning.clairvoyant import clairvoyant_s
from mrtask.planning.solver_belief import belief_of, draw_worlds
from tests.bounds.enumeration import all_worlds
from tests.bounds.tightness import ROUNDING, gaps
from tests.planning.fast_solver import FastSolver
from tests.planning.problems import make_problem, random_problem, tiny_problem


def is_cheap(problem):
    """Whether plain Python finds the exact optimum in a fraction of a second."""
    containers, objects = problem.presence_prob.shape
    return containers * len(problem.robots) <= (3 if objects > 2 else 4)


CHEAP = [number for number in range(150) if is_cheap(tiny_problem(number))][:40]


@pytest.mark.parametrize("number", CHEAP)
def test_no_bound_is_above_the_optimum_and_the_bound_is_above_clairvoyance_where_it_says_so(number):
    bound, clairvoyant, exact = gaps(tiny_problem(number))
    assert bound <= 1 + ROUNDING
    assert clairvoyant <= 1 + ROUNDING
    if exact:
        assert bound == pytest.approx(1)


def test_penalties_make_up_for_most_of_what_clairvoyance_misses():
    found = np.array([gaps(tiny_problem(number))[:2] for number in (2, 9, 10, 20)])
    assert (found[:, 0] > found[:, 1]).all()
    assert (1 - found[:, 0]).mean() < 0.2 * (1 - found[:, 1]).mean()


def test_waiting_for_two_hidden_objects_lifts_a_teams_bound_above_clairvoyance():
    found = np.array([gaps(random_problem(seed, robots=2, containers=3))[:2] for seed in range(6)])
    assert (1 - found[:, 0]).mean() < 0.8 * (1 - found[:, 1]).mean()


@pytest.mark.parametrize("interact_time_s", [0.0, 1.5])
@pytest.mark.parametrize(
    ("template", "robots"),
    # Not three robots and four objects: that takes the exact solver a minute.
    [*product(["and3", "and_or", "seq3"], [1, 2, 3]), ("or_seq", 1), ("or_seq", 2)],
)
def test_the_clairvoyant_makespan_is_the_optimum_of_the_problem_with_everything_searched(
    template, robots, interact_time_s
):
    rng = np.random.default_rng([robots, int(interact_time_s)])
    for seed in range(2):
        problem = random_problem(seed, template=template, robots=robots, containers=4, interact_time_s=interact_time_s)
        starts = rng.random((robots, 4)) * 10
        problem = replace(
            problem,
            robots=tuple(replace(robot, travel_s=row) for robot, row in zip(problem.robots, starts, strict=True)),
        )
        world = np.zeros(problem.presence_prob.shape, dtype=bool)
        # Each object elsewhere: the solver sends no two robots to one container, which the bound must allow.
        world[rng.permutation(4)[: world.shape[1]], range(world.shape[1])] = True
        known = replace(problem, presence_prob=world.astype(float), searched=np.ones(4, dtype=bool))
        closed = replace(
            known,
            robots=tuple(
                replace(robot, travel_s=row) for robot, row in zip(known.robots, belief_of(known).start_s, strict=True)
            ),
        )
        expected = FastSolver(closed, closed.presence_prob).optimum()
        assert clairvoyant_s(belief_of(closed), world) == pytest.approx(expected)


def test_one_robot_that_knows_everything_still_searches_each_container_it_uses():
    for seed in range(10):
        problem = random_problem(seed, template="and3", containers=4, search_time_s=3.0, interact_time_s=0.5)
        belief = belief_of(problem)
        for world in draw_worlds(belief, 5, np.random.default_rng(seed)):
            best = np.inf
            for order in permutations(range(3)):
                for places in product(*(np.flatnonzero(world[:, obj]) for obj in order)):
                    visits = [c for i, c in enumerate(places) if i == 0 or c != places[i - 1]]
                    way_s = problem.robots[0].travel_s[visits[0]]
                    way_s += sum(problem.travel_s[a, b] for a, b in pairwise(visits))
                    best = min(best, way_s + 3.0 * len(set(visits)) + 0.5 * 3)
            assert clairvoyant_s(belief, world) == pytest.approx(best)


def nearest_first(problem, place, searched, found):
    return min(searched, key=lambda c: problem.travel_s[place, c])


def likeliest_first(problem, place, searched, found):
    return max(searched, key=lambda c: problem.presence_prob[c, [o for o in range(3) if o not in found]].sum())


def turns_round_after_a_find(problem, place, searched, found):
    return max(searched) if found else min(searched)


@pytest.mark.parametrize("policy", [nearest_first, likeliest_first, turns_round_after_a_find])
@pytest.mark.parametrize("template", ["and3", "seq3"])
def test_penalties_have_mean_zero_under_policies_that_do_not_know_the_world(template, policy):
    problem = random_problem(3, template=template, containers=4)
    belief = belief_of(problem)
    worlds, weights = all_worlds(belief)
    table = Table(belief, np.arange(4), belief.known)
    totals = []
    for world in worlds:
        state, run, found, place = belief.state, [], set(), 0
        while not belief.automaton.accepting[state] and len(run) < 4:
            left = [c for c in range(4) if c not in [search.container for search in run]]
            place = policy(problem, place, left, found)
            run.append(SearchMade(place, state))
            found |= set(np.flatnonzero(world[place]).tolist())
            for _ in range(3):
                for obj in sorted(found):
                    if belief.automaton.advancing[state, obj]:
                        state = int(belief.automaton.transitions[state, obj])
        table.solve(world)
        totals.append(table.paid_s(run))
    assert np.std(totals) > 0.1
    assert weights @ totals == pytest.approx(0, abs=1e-9)


def test_revealing_containers_weakens_the_bound_but_keeps_it_below_the_optimum(monkeypatch):
    monkeypatch.setattr("mrtask.bounds.one_robot.MAX_ENTRIES", 30)
    for number in (0, 9, 20, 45):
        problem = tiny_problem(number)
        bound, clairvoyant, exact = gaps(problem)
        assert not exact
        assert clairvoyant - ROUNDING < bound < 1


def test_worlds_are_drawn_as_often_as_enumeration_says():
    belief = belief_of(tiny_problem(2))
    worlds, weights = all_worlds(belief)
    drawn = draw_worlds(belief, 20_000, np.random.default_rng(0))
    keys = [world.tobytes() for world in worlds]
    share = np.bincount([keys.index(world.tobytes()) for world in drawn], minlength=len(keys)) / len(drawn)
    assert np.abs(share - weights).max() < 5 * np.sqrt(weights.max() / len(drawn))


def test_a_bound_says_how_it_came_about():
    rng = np.random.default_rng(0)
    for problem, kind in (
        (random_problem(0, template="and2"), BoundKind.EXACT),
        (random_problem(0, template="seq2"), BoundKind.PENALISED),
        (random_problem(0, robots=2), BoundKind.TEAM),
    ):
        found = lower_bound(problem, draw_worlds(belief_of(problem), 8, rng), rng)
        assert found.kind == kind
        assert (found.values_s.mean() >= found.clairvoyant_s.mean()) or kind != BoundKind.EXACT


def test_a_finished_task_costs_nothing():
    problem = random_problem(0)
    done = replace(problem, state=int(np.flatnonzero(problem.automaton.accepting)[0]))
    belief = belief_of(done)
    worlds = draw_worlds(belief, 3, np.random.default_rng(0))
    assert one_robot_bound(belief, worlds).values_s.tolist() == [0, 0, 0]
    assert team_bound(belief, worlds, worlds).tolist() == pytest.approx([0, 0, 0], abs=1e-6)


def test_what_no_bound_is_for_is_refused():
    problem = random_problem(0, robots=2)
    belief = belief_of(problem)
    with pytest.raises(ValueError, match="for one robot, not for 2"):
        one_robot_bound(belief, draw_worlds(belief, 1, np.random.default_rng(0)))
    busy = replace(problem, robots=(replace(problem.robots[0], free=False, place=0, remaining_s=1.0),) * 2)
    with pytest.raises(ValueError, match="a robot is busy"):
        belief_of(busy)
    nothing_left = make_problem("F a", ("a",), [(0, 0)], [(1, 0)], [[0.0]], searched=[0])
    with pytest.raises(ValueError, match="no unsearched container can hold a"):
        draw_worlds(belief_of(nothing_left), 1, np.random.default_rng(0))
