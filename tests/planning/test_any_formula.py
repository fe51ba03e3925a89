"""Whatever the formula, every planner's episode ends, and ours ends it by finishing the task."""

import numpy as np
import pytest

from mrtask.planning.planners import PLANNERS, make_planner
from mrtask.planning.pouct import Pouct
from mrtask.planning.problem import worth_interacting
from mrtask.tasks.automaton import build_automaton
from tests.planning.fuzz_formulas import MAX_DECISIONS, OPTIONS, play, problem_of, random_task
from tests.planning.naive_pouct import worth_doing
from tests.planning.play import Play
from tests.planning.problems import make_problem
from tests.planning.test_pouct_twin import compare

LEADS_BACK = ("F (mug & X (book & X laptop))", "F (laptop & X (mug & X book))")
"""After ``mug``, an interaction with ``laptop`` leads back to the start."""


@pytest.mark.parametrize("first", range(0, 60, 10))
def test_every_planner_ends_random_tasks(first):
    for number in range(first, first + 10):
        automaton, ended = play(number)
        assert ended.keys() == PLANNERS.keys()
        for name, played in ended.items():
            # The paper's planner may go round in circles where it has few samples; the episode's limit ends that.
            assert played.accepted or (name == "pouct_paper" and played.decisions == MAX_DECISIONS), automaton.formula


@pytest.mark.parametrize("first", range(0, 60, 20))
def test_roll_outs_of_random_tasks_end_by_themselves_as_the_twins(first, monkeypatch):
    """The twin raises where the bound on decisions would have to end a roll-out."""
    for number in range(first, first + 20):
        problem, _ = problem_of(number, random_task(number))
        compare(problem, number, Pouct(samples=20), monkeypatch)


@pytest.mark.parametrize("formula", LEADS_BACK)
@pytest.mark.parametrize("name", PLANNERS)
def test_planners_do_not_undo_what_they_did(formula, name):
    """All three objects lie where the robot stands and, once more, further away."""
    names, truth = ("mug", "book", "laptop"), np.array([[1, 0, 1], [0, 1, 0], [1, 1, 1]], dtype=bool)
    problem = make_problem(
        formula, names, [[0, 0], [4, 0], [9, 0]], [[0, 0]], np.where(truth, 1.0, 0.0), searched=[0, 1, 2]
    )
    played = Play(problem, truth).run(make_planner(name, OPTIONS.get(name)))
    assert played.accepted and played.decisions <= 8


@pytest.mark.parametrize("number", [678, 1122, 2030])
def test_detours_that_cost_no_time_come_to_an_end(number):
    """Where a robot stands, one interaction leads away from acceptance and another one back."""
    problem, truth = problem_of(number, random_task(number))
    for name in ("pouct", "known"):
        assert Play(problem, truth).run(make_planner(name, OPTIONS[name])).accepted


def test_interactions_that_only_lead_back_are_the_brute_force_solutions():
    found = 0
    for number in range(150):
        automaton = random_task(number)
        available = np.random.default_rng(number).random(len(automaton.propositions)) < 0.8
        held = np.where(available, 1.0, 0.0)[None]
        problem = make_problem(automaton.formula, automaton.propositions, [[0, 0]], [[1, 0]], held, searched=[0])
        nearer, worth = worth_doing(problem)
        candidates = automaton.advancing.copy()
        for z, objects in enumerate(nearer):
            candidates[z, list(objects)] = False
        result = worth_interacting(automaton, candidates, available)
        for z, objects in enumerate(worth):
            assert set(np.flatnonzero(result[z])) == objects - nearer[z], (automaton.formula, z)
        found += int((candidates & ~result).sum())
    assert found > 100


def test_a_task_that_nothing_available_can_finish_has_nothing_worth_doing():
    automaton = build_automaton("F (a & X b)", ["a", "b"])
    assert not worth_interacting(automaton, automaton.advancing, np.array([True, False])).any()
