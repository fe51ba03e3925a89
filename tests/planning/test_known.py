"""`known` against optima that it does not compute itself."""

from dataclasses import replace

import numpy as np
import pytest

from mrtask.planning.planners import make_planner
from mrtask.tasks.templates import PAPER_TEMPLATES
from tests.planning.exact_solver import ExactSolver
from tests.planning.play import Play
from tests.planning.problems import make_problem, random_problem


class KnowsAll:
    """`known` with the truth at every decision of a `Play`."""

    def __init__(self, truth):
        self.truth, self.samples = truth.astype(float), 0

    def plan(self, problem, seed):
        plan = make_planner("known", {"samples": 500}).plan(replace(problem, presence_prob=self.truth), seed)
        self.samples += plan.info.samples
        return plan


def random_truth(seed, shape):
    """Each object in some containers, in one at least."""
    rng = np.random.default_rng(seed)
    truth = rng.random(shape) < 0.3
    truth[rng.integers(shape[0], size=shape[1]), np.arange(shape[1])] = True
    return truth


@pytest.mark.parametrize("template", PAPER_TEMPLATES)
@pytest.mark.parametrize("robots", [1, 2])
def test_an_episode_takes_exactly_the_least_time(template, robots):
    for seed in range(3):
        search_time_s = 1.5 if robots == 1 and seed % 2 else 0.0
        problem = random_problem(seed, template=template, robots=robots, containers=3, search_time_s=search_time_s)
        truth = random_truth(seed, problem.presence_prob.shape)
        planner = KnowsAll(truth)
        played = Play(problem, truth).run(planner)
        told = replace(problem, presence_prob=truth.astype(float))
        assert played.cost_s == pytest.approx(ExactSolver(told, told.presence_prob).optimum())
        assert played.cost_s == pytest.approx(make_planner("known").plan(told, 0).info.value_s)
        assert planner.samples == 0


def test_an_interaction_whose_turn_has_not_come_waits():
    # `b` and `c` both lead on from `a`, but only `b` then `c` finishes the task.
    names, truth = ["a", "b", "c"], np.eye(3, dtype=bool)
    problem = make_problem("F (a & X (b & X c))", names, [[0, 0], [9, 0], [20, 0]], [[1, 0], [19, 0]], np.eye(3))
    played = Play(problem, truth).run(KnowsAll(truth))
    assert played.accepted and played.cost_s == pytest.approx(10.0)


def test_a_team_whose_searches_take_time_is_searched_for():
    problem = random_problem(1, template="and2", robots=2, containers=4, search_time_s=1.0)
    truth = random_truth(1, problem.presence_prob.shape)
    planner = KnowsAll(truth)
    assert Play(problem, truth).run(planner).accepted
    assert planner.samples > 0
