"""`pouct_paper` makes progress: no more than 2 R decisions in a row in which nothing is learned or done."""

from dataclasses import replace

import numpy as np
import pytest

from mrtask.planning.paper.planner import PaperPouct
from mrtask.planning.problem import PlanningProblem, RobotKind, RobotStatus
from mrtask.tasks.automaton import build_automaton
from mrtask.tasks.templates import TEMPLATES, make_formula
from tests.planning.fuzz_formulas import problem_of, random_task
from tests.planning.play import Play
from tests.planning.problems import make_problem, random_problem

TRAVEL_S = [
    [0.0, 2.6, 9.3, 9.5, 7.9, 5.0, 3.4, 7.8],
    [2.6, 0.0, 9.5, 9.6, 8.1, 5.2, 3.5, 7.9],
    [9.3, 9.5, 0.0, 1.6, 1.9, 4.7, 6.9, 4.0],
    [9.5, 9.6, 1.6, 0.0, 2.8, 4.9, 7.0, 3.6],
    [7.9, 8.1, 1.9, 2.8, 0.0, 3.3, 5.5, 3.9],
    [5.0, 5.2, 4.7, 4.9, 3.3, 0.0, 2.2, 2.9],
    [3.4, 3.5, 6.9, 7.0, 5.5, 2.2, 0.0, 5.1],
    [7.8, 7.9, 4.0, 3.6, 3.9, 2.9, 5.1, 0.0],
]
FROM_START_S = [7.4, 7.5, 3.7, 3.2, 3.5, 2.6, 4.8, 0.4]
PROB = [
    [0, 0, 0.173, 0],
    [0, 0, 0, 0],
    [0.209, 0.199, 0, 0.39],
    [0, 0, 0, 0.462],
    [0, 0, 0, 0],
    [0, 0, 0, 0],
    [0, 0.458, 0, 0],
    [0, 0.002, 0, 0.002],
]


def some_truth(problem, seed):
    """[C, O] contents drawn from the likelihoods, every object somewhere."""
    rng = np.random.default_rng(seed)
    truth = rng.random(problem.presence_prob.shape) < problem.presence_prob
    truth[rng.integers(len(truth), size=truth.shape[1]), range(truth.shape[1])] = True
    return truth


@pytest.mark.parametrize("reassign", ["free", "all"])
@pytest.mark.parametrize("template", TEMPLATES)
def test_every_episode_ends_and_none_idles(template, reassign):
    for seed in range(12):
        robots = 1 + seed % 4
        problem = random_problem(
            seed,
            template=template,
            robots=robots,
            containers=6,
            search_time_s=seed % 2 * 3.0,
            interact_time_s=(0.0, 1.0, 10.0)[seed % 3],
        )
        planner = PaperPouct(samples=(1, 20, 300)[seed % 3], reassign=reassign)
        played = Play(problem, some_truth(problem, seed)).run(planner, seed)
        assert played.accepted
        assert played.most_idle <= 2 * robots


def test_known_places_are_not_paced_between():
    # Trial small-2-035 of `make reproduce` (or_seq: Pan or Plate, then TeddyBear, then SprayBottle), to the decimetre:
    # a robot went to and fro between the two known bottles 997 times, and nobody looked for the bear.
    names = ("Pan", "Plate", "TeddyBear", "SprayBottle")
    kind = RobotKind(np.array(TRAVEL_S))
    automaton = build_automaton(make_formula("or_seq", names), names)
    start = RobotStatus(np.array(FROM_START_S))
    prob, searched = np.array(PROB, dtype=float), np.zeros(8, dtype=bool)
    problem = PlanningProblem(automaton, automaton.initial, prob, searched, (kind,), (start, start))
    truth = np.zeros((8, 4), dtype=bool)
    truth[[0, 2, 2, 3, 6], [2, 0, 3, 3, 1]] = True
    for seed in range(5):
        played = Play(problem, truth).run(PaperPouct(samples=10_000), seed)
        assert played.accepted
        assert played.decisions <= 12


@pytest.mark.parametrize("choice", ["mean", "visits"])
def test_an_interaction_that_hurts_is_not_made_where_a_harmless_one_costs_the_same(choice):
    # All lies in the one container: once b was first, c is needed too.
    problem = make_problem(
        "F a & (b -> X F c)", ["a", "b", "c"], [[3, 0]], [[0, 0]], [[1, 1, 1]], searched=[0], interact_time_s=0.0
    )
    for seed in range(10):
        plan = PaperPouct(samples=20, choice=choice).plan(problem, seed)
        assert plan.assignments[0] != (0, 1)
    # Where only the detour by b and c completes the task, it is taken.
    problem = make_problem("(!b U a) | F (b & X F c)", ["a", "b", "c"], [[3, 0]], [[0, 0]], [[0, 1, 1]], searched=[0])
    assert Play(problem, np.array([[False, True, True]])).run(PaperPouct(samples=20)).accepted


def test_interaction_times_count_at_a_leaf():
    # One robot beside three objects takes three interactions, three robots one.
    formula, names, place = "F a & F b & F c", ["a", "b", "c"], [[0, 0]]
    problem = make_problem(formula, names, place, place, [[1, 1, 1]], searched=[0], interact_time_s=10.0)
    assert PaperPouct(samples=1).plan(problem, 0).info.value_s == pytest.approx(30.0)
    crowd = replace(problem, robots=problem.robots * 3)
    assert PaperPouct(samples=1).plan(crowd, 0).info.value_s == pytest.approx(10.0)


@pytest.mark.parametrize("number", [20138, 22714, 28604])
def test_a_team_whose_detours_cost_nothing_does_not_go_round_in_circles(number):
    # From `tests.planning.fuzz_formulas`: with few samples, one detour after the other, at one instant or by turns of
    # robots that stand at objects which undo each other's letters.
    problem, truth = problem_of(number, random_task(number))
    played = Play(problem, truth).run(PaperPouct(samples=60))
    assert played.accepted
