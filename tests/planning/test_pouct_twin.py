"""The compiled search against its plain-Python twin, value for value."""

import numpy as np
import pytest

from mrtask.planning import pouct
from mrtask.planning.greedy import Greedy
from mrtask.planning.pouct import Pouct
from mrtask.planning.problem import ANY_SAFE, NONE_UNNAMED, WAIT, Assignment
from mrtask.planning.team_model import team_model
from mrtask.tasks.templates import PAPER_TEMPLATES
from tests.planning.naive_pouct import NaivePouct
from tests.planning.problems import NAMES, make_problem, random_problem

DETOURS = (
    "F (a & X (b & X c))",
    "F (a & X b) | F (c & X d)",
    "(F (a & X (b & X a))) & F c",
    "F (a & X (b | c) & X X d)",
)
"""Tasks in which an interaction can undo what others did."""
CASES = [
    (template, robots, containers, seconds)
    for template in PAPER_TEMPLATES
    for robots, containers in ((1, 7), (2, 5), (3, 6))
    for seconds in ((0.0, 0.0), (1.0, 2.0))
]


def compare(problem, seed, planner, monkeypatch):
    monkeypatch.setattr(pouct, "is_settled", lambda *arguments: False)
    plan = planner.plan(problem, seed)
    naive = NaivePouct(problem, team_model(problem).prob, seed, planner)
    tree = naive.run(planner.samples)
    unnamed = NONE_UNNAMED if problem.interact_time_s > 0 else ANY_SAFE
    seen = {assignment: (visits, mean_s) for assignment, visits, mean_s, _ in plan.info.root}
    expected = {}
    for edge in tree.edges:
        action = naive.resolve(naive.root, tree.robot, edge.action)
        expected[as_assignment(action, unnamed)] = (len(edge.costs), pytest.approx(edge.mean, rel=1e-9))
    assert seen == expected
    assert plan.info.tree_nodes == naive.nodes
    return naive


def as_assignment(action, unnamed):
    return Assignment(*action) if isinstance(action, tuple) else Assignment(action, unnamed)


@pytest.mark.parametrize(("template", "robots", "containers", "seconds"), CASES)
def test_every_sample_of_pouct_equals_the_twins(template, robots, containers, seconds, monkeypatch):
    seed = CASES.index((template, robots, containers, seconds))
    problem = random_problem(
        seed,
        template=template,
        robots=robots,
        containers=containers,
        search_time_s=seconds[0],
        interact_time_s=seconds[1],
    )
    compare(problem, seed, Pouct(samples=200), monkeypatch)


@pytest.mark.parametrize("formula", DETOURS)
@pytest.mark.parametrize("robots", [1, 2])
def test_every_sample_equals_the_twins_where_interactions_can_lead_back(formula, robots, monkeypatch):
    for seed in range(3):
        rng = np.random.default_rng([seed, robots])
        prob = np.clip(rng.beta(0.5, 1.0, (4, 4)), 0.05, 0.95)
        prob[0] = rng.random(4) < 0.7
        problem = make_problem(
            formula, NAMES, rng.random((4, 2)) * 10, rng.random((robots, 2)) * 10, prob, searched=[0]
        )
        compare(problem, seed, Pouct(samples=200), monkeypatch)


def test_a_full_tree_and_other_options_equal_the_twins(monkeypatch):
    planner = Pouct(
        samples=300, max_nodes=40, exploration=0.4, widening_factor=2.0, widening_exponent=0.5, later_weight=0.7
    )
    naive = compare(random_problem(5, template="or_seq", robots=2, containers=6), 9, planner, monkeypatch)
    assert naive.nodes == 40


@pytest.mark.parametrize(
    ("template", "robots"), [(template, robots) for template in PAPER_TEMPLATES for robots in (1, 2, 4)]
)
def test_greedy_equals_the_twins(template, robots):
    for seed in range(5):
        problem = random_problem(seed, template=template, robots=robots, containers=6)
        naive = NaivePouct(problem, team_model(problem).prob, 0, Pouct())
        state, expected = naive.root, {}
        while state.undecided:
            robot, action = naive.greedy(state)
            expected[robot] = action
            state = naive._act(state, robot, naive.resolve(state, robot, action))
        plan = Greedy().plan(problem, seed=0)
        assert {
            robot: assignment.container if assignment.interaction == ANY_SAFE else WAIT
            for robot, assignment in plan.assignments.items()
        } == expected
