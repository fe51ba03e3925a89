from dataclasses import replace

import numpy as np
import pytest

from mrtask.planning import pouct
from mrtask.planning.planners import PLANNERS, make_planner
from mrtask.planning.problem import ANY_SAFE, NONE_UNNAMED, WAIT, Assignment, RobotStatus
from mrtask.planning.team_kernel import history_after
from mrtask.planning.team_model import team_model
from mrtask.tasks.templates import PAPER_TEMPLATES
from tests.planning.exact_solver import ExactSolver
from tests.planning.fast_solver import FastSolver
from tests.planning.play import Play
from tests.planning.problems import make_problem, random_problem

CASES = [
    (template, robots, containers, seconds)
    for template in PAPER_TEMPLATES
    for robots, containers in ((1, 3), (2, 2), (3, 2))
    for seconds in ((0.0, 0.0), (1.0, 2.0))
]


def first_actions(plan):
    return {
        robot: a.container if a.interaction < 0 else (a.container, a.interaction)
        for robot, a in plan.assignments.items()
    }


@pytest.mark.parametrize(("template", "robots", "containers", "seconds"), CASES)
def test_pouct_finds_the_exact_optimum(template, robots, containers, seconds):
    seed = CASES.index((template, robots, containers, seconds))
    problem = random_problem(
        seed,
        template=template,
        robots=robots,
        containers=containers,
        search_time_s=seconds[0],
        interact_time_s=seconds[1],
    )
    solver = FastSolver(problem, team_model(problem).prob)
    optimum_s = solver.optimum()
    plan = make_planner("pouct", {"samples": 100_000, "exploration": 3.0, "widening_exponent": 0.8}).plan(
        problem, seed=1
    )
    assert plan.info.value_s == pytest.approx(optimum_s, rel=0.01)
    assert solver.value(first_actions(plan)) == pytest.approx(optimum_s, rel=0.01)


def test_more_samples_err_less():
    errors = {10: [], 10_000: []}
    for seed in range(12):
        problem = random_problem(seed, template="and2", robots=1, containers=4)
        solver = ExactSolver(problem, team_model(problem).prob)
        optimum_s = solver.optimum()
        for samples, seen in errors.items():
            plan = make_planner("pouct", {"samples": samples, "exploration": 2.0}).plan(problem, seed)
            seen.append(solver.value(first_actions(plan)) / optimum_s - 1)
    assert np.mean(errors[10_000]) < np.mean(errors[10])
    assert np.mean(errors[10_000]) < 0.001


def test_the_exact_solver_agrees_with_a_case_by_hand():
    # One robot between two containers 1 and 2 away, 3 apart; `a` is in one of them, 0.5 each before conditioning.
    problem = make_problem("F a", ["a"], [[-1, 0], [2, 0]], [[0, 0]], [[0.5], [0.5]])
    solver = ExactSolver(problem, problem.presence_prob)
    # a lies left with 0.5 / 0.75; if it does not, it must be right.
    assert solver.value({0: 0}) == pytest.approx(1 + (1 / 3) * 3)
    assert solver.value({0: 1}) == pytest.approx(2 + (1 / 3) * 3)
    assert solver.optimum() == pytest.approx(2.0)


@pytest.mark.parametrize("name", PLANNERS)
def test_equal_problem_options_and_seed_give_an_equal_plan(name):
    problem = random_problem(3, template="or_seq", robots=3, containers=8)
    options = {"samples": 500} if name in ("pouct", "pouct_paper", "known") else {}
    plans = [make_planner(name, options).plan(problem, seed=7) for _ in range(2)]
    assert plans[0].assignments == plans[1].assignments
    assert plans[0].info.root == plans[1].info.root


def test_plan_info_says_why():
    problem = random_problem(0, template="and2", robots=2, containers=6)
    plan = make_planner("pouct", {"samples": 2000}).plan(problem, seed=1)
    info = plan.info
    assert plan.assignments[info.root_robot] == info.root[0][0]
    assert 1000 < info.samples <= 2000
    assert 1 < info.tree_nodes <= info.samples + 1
    assert sum(visits for _, visits, _, _ in info.root) == info.samples
    assert info.root[0][1] == max(visits for _, visits, _, _ in info.root)
    assert info.value_s == pytest.approx(info.root[0][2])


@pytest.mark.parametrize("name", ["pouct", "pouct_paper"])
def test_plan_info_names_the_robot_whose_actions_it_lists(name):
    first = []
    for seed in range(10):
        problem = random_problem(seed, template="and2", robots=3, containers=6)
        busy = replace(problem.robots[0], free=False, place=0, remaining_s=1.0)
        problem = replace(problem, robots=(busy, *problem.robots[1:]))
        plan = make_planner(name, {"samples": 200}).plan(problem, seed)
        assert plan.assignments[plan.info.root_robot] in [row[0] for row in plan.info.root]
        first.append(plan.info.root_robot)
    assert 0 not in first


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_a_search_that_ends_early_takes_the_same_actions(robots, monkeypatch):
    early = []
    for seed in range(8):
        problem = random_problem(seed, template="and3", robots=robots, containers=6)
        planner = make_planner("pouct", {"samples": 4000})
        plan = planner.plan(problem, seed)
        with monkeypatch.context() as patch:
            patch.setattr(pouct, "is_settled", lambda *arguments: False)
            whole = planner.plan(problem, seed)
        assert plan.assignments == whole.assignments
        assert whole.info.samples == 4000
        early.append(plan.info.samples < 4000)
    assert any(early)


def test_a_full_tree_goes_on_with_what_it_has():
    problem = random_problem(0, template="and3", robots=2, containers=8)
    for name in ("pouct", "pouct_paper"):
        info = make_planner(name, {"samples": 3000, "max_nodes": 50}).plan(problem, seed=1).info
        assert info.samples > 1000
        assert info.tree_nodes == 50


def test_a_time_limit_ends_the_search_early():
    problem = random_problem(0, template="and3", robots=3, containers=10)
    for name in ("pouct", "pouct_paper"):
        info = (
            make_planner(name, {"samples": 50_000_000, "max_nodes": 1000, "time_limit_s": 0.05}).plan(problem, 1).info
        )
        assert 0 < info.samples < 50_000_000


def test_unreachable_containers_are_never_chosen():
    problem = random_problem(1, template="and2", robots=2, containers=5)
    travel_s = problem.kinds[0].travel_s.copy()
    travel_s[2, :] = travel_s[:, 2] = np.inf
    away_s = problem.robots[0].travel_s.copy()
    away_s[2] = np.inf
    kinds = (replace(problem.kinds[0], travel_s=travel_s),)
    cut_off = replace(problem, kinds=kinds, robots=(RobotStatus(away_s), RobotStatus(away_s)))
    for name in PLANNERS:
        options = {"samples": 300} if name in ("pouct", "pouct_paper", "known") else {}
        plan = make_planner(name, options).plan(cut_off, seed=0)
        assert 2 not in {assignment.container for assignment in plan.assignments.values()}


@pytest.mark.parametrize("extreme", [0.0, 1.0])
@pytest.mark.parametrize("name", PLANNERS)
def test_likelihoods_of_zero_and_one_still_give_a_plan(name, extreme):
    problem = random_problem(1, template="seq2", robots=2, containers=4)
    sure = replace(problem, presence_prob=np.full((4, 2), extreme))
    options = {"samples": 300} if name in ("pouct", "pouct_paper", "known") else {}
    plan = make_planner(name, options).plan(sure, seed=0)
    assert set(plan.assignments) == {0, 1}


@pytest.mark.parametrize("name", PLANNERS)
def test_more_robots_than_containers(name):
    problem = random_problem(1, template="and2", robots=3, containers=1)
    options = {"samples": 100} if name in ("pouct", "pouct_paper", "known") else {}
    plan = make_planner(name, options).plan(problem, seed=0)
    assert set(plan.assignments) == {0, 1, 2}
    assert sum(assignment.container == 0 for assignment in plan.assignments.values()) >= 1


def test_nowhere_left_to_look_means_waiting():
    problem = random_problem(1, template="and2", robots=2, containers=3)
    searched = replace(problem, searched=np.ones(3, dtype=bool), presence_prob=np.zeros((3, 2)))
    for name in PLANNERS:
        options = {"samples": 100} if name in ("pouct", "pouct_paper", "known") else {}
        plan = make_planner(name, options).plan(searched, seed=0)
        assert {assignment.container for assignment in plan.assignments.values()} == {WAIT}


def test_two_wings_split_the_team():
    points = [[-10, 0], [-11, 0], [10, 0], [11, 0]]
    problem = make_problem("F a & F b", ["a", "b"], points, [[0, 0], [0, 0]], np.full((4, 2), 0.4))
    plan = make_planner("pouct", {"samples": 3000}).plan(problem, seed=0)
    sides = sorted(np.sign(points[assignment.container][0]) for assignment in plan.assignments.values())
    assert sides == [-1, 1]


def test_a_less_likely_container_on_the_way_is_searched_first():
    problem = make_problem("F a", ["a"], [[5, 0], [10, 0]], [[0, 0]], [[0.2], [0.7]])
    plan = make_planner("pouct", {"samples": 3000}).plan(problem, seed=0)
    assert plan.assignments[0].container == 0


def test_a_robot_waits_with_a_found_object_while_the_other_finishes_the_earlier_step():
    # `b` is found where robot 1 stands; `a` is known where robot 0 goes; the only unsearched place is far away.
    points = [[0, 0], [10, 0], [100, 0]]
    prob = [[1.0, 0.0], [0.0, 1.0], [0.3, 0.3]]
    problem = make_problem("(!b U a) & F b", ["a", "b"], points, [[3, 0], [10, 0]], prob, searched=[0, 1])
    plan = make_planner("pouct", {"samples": 3000}).plan(problem, seed=0)
    assert plan.assignments == {0: Assignment(0), 1: Assignment(WAIT)}


def test_a_robot_goes_on_searching_when_waiting_costs_more():
    # `b` is found where robot 1 stands, but nobody knows where `a` is: perhaps 3 m away.
    points = [[0, 0], [-20, 0], [3, 0]]
    prob = [[0.0, 1.0], [0.5, 0.0], [0.3, 0.0]]
    problem = make_problem("(!b U a) & F b", ["a", "b"], points, [[-5, 0], [0, 0]], prob, searched=[0])
    plan = make_planner("pouct", {"samples": 3000}).plan(problem, seed=0)
    assert plan.assignments[1].container == 2
    solver = ExactSolver(problem, team_model(problem).prob)
    assert solver.value({0: 1, 1: 2}) < solver.value({0: 1, 1: WAIT})


def test_a_robot_that_waits_is_relieved_by_one_with_nothing_to_do():
    # Robot 1 waits with `b` until robot 0 has looked at -20; if `a` is not there, robot 1 looks at 20 while robot 0
    # takes its place. Both deep in the tree and out of the greedy policy's sight.
    points = [[0, 0], [-20, 0], [20, 0]]
    prob = [[0.0, 1.0], [0.3, 0.0], [0.3, 0.0]]
    problem = make_problem("(!b U a) & F b", ["a", "b"], points, [[-5, 0], [0, 0]], prob, searched=[0])
    plan = make_planner("pouct", {"samples": 3000}).plan(problem, seed=0)
    assert plan.assignments == {0: Assignment(1), 1: Assignment(WAIT)}


def test_a_robot_whose_target_was_found_by_another_is_redirected():
    # Robot 0 has just found `a` at 0 and so nothing is left to find at 1, where robot 1 goes; `b` may be at 2 only.
    points = [[0, 0], [10, 0], [-10, 0]]
    prob = [[1.0, 0.0], [0.9, 0.0], [0.0, 0.9]]
    problem = make_problem("F a & F b", ["a", "b"], points, [[0, 0], [1, 0]], prob, searched=[0])
    under_way = replace(problem.robots[1], free=False, target=1, remaining_s=9.0)
    redirected = replace(problem, state=problem.automaton.run(["a"]), robots=(problem.robots[0], under_way))
    plan = make_planner("pouct", {"samples": 3000}).plan(redirected, seed=0)
    assert 1 not in {assignment.container for assignment in plan.assignments.values()}
    assert 2 in {assignment.container for assignment in plan.assignments.values()}
    kept = make_planner("pouct", {"samples": 3000, "reassign": "free"}).plan(redirected, seed=0)
    assert set(kept.assignments) == {0}


@pytest.mark.parametrize(
    ("name", "decides"), [("pouct", True), ("known", True), ("greedy", False), ("learned_myopic", False)]
)
def test_safe_interactions_that_take_time_are_decisions_of_pouct_and_known(name, decides):
    # Robot 0 stands at `a` and `b`, robot 1 at another `a`. On their own, both would begin with `a`.
    truth = np.array([[True, True], [True, False], [False, False]])
    options = {"samples": 500} if decides else {}

    def played_with(interact_time_s):
        problem = make_problem(
            "F a & F b",
            ["a", "b"],
            [[0, 0], [5, 0], [9, 0]],
            [[0, 0], [5, 0]],
            truth.astype(float),
            searched=[0, 1, 2],
            interact_time_s=interact_time_s,
        )
        return Play(problem, truth).run(make_planner(name, options))

    assert played_with(3.0).cost_s == pytest.approx(3.0 if decides else 6.0)
    assert played_with(0.0).cost_s == pytest.approx(0.0)


@pytest.mark.parametrize("name", PLANNERS)
def test_only_where_interacting_takes_time_is_an_interaction_left_to_the_search(name):
    options = {"samples": 300} if name in ("pouct", "pouct_paper", "known") else {}
    for interact_time_s in (0.0, 1.0):
        problem = random_problem(2, template="and2", robots=2, containers=5, interact_time_s=interact_time_s)
        told = {a.interaction for a in make_planner(name, options).plan(problem, seed=0).assignments.values()}
        decides = interact_time_s > 0 and name in ("pouct", "known")
        assert told & {ANY_SAFE, NONE_UNNAMED} <= {NONE_UNNAMED if decides else ANY_SAFE}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"samples": -5}, "samples must be at least 1, not -5"),
        ({"reassign": "some"}, "reassign must be 'all' or 'free'"),
        ({"smaples": 5}, "smaples"),
        ({"time_limit_s": 0}, "time_limit_s must be > 0"),
    ],
)
def test_options_are_refused_with_what_is_allowed(options, message):
    with pytest.raises(ValueError, match=message):
        make_planner("pouct", options)


def test_unknown_planners_are_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="unknown planner 'best'; allowed: nonlearned_myopic, learned_myopic"):
        make_planner("best")
    with pytest.raises(ValueError, match=r"'no\.such\.planner' cannot be imported"):
        make_planner("no.such.planner")


def test_a_planner_of_ones_own_is_named_by_its_import_path():
    planner = make_planner("mrtask.planning.greedy.Greedy", {"later_weight": 0.5})
    assert planner.plan(random_problem(1, robots=2, containers=4), 0).assignments.keys() == {0, 1}


def test_histories_of_many_containers_do_not_meet():
    containers, held = np.arange(130), np.arange(4)[:, None]
    once = history_after(np.int64(0), held, containers, len(containers)).ravel()
    twice = history_after(once[:, None, None], held, containers, len(containers)).ravel()
    assert len({0, *once.tolist(), *twice.tolist()}) == 1 + len(once) + len(twice)


def test_a_robot_that_only_its_own_ways_lead_away_acts_where_it_stands():
    # It stands at both objects, inside a barrier that the team's ways avoid; going there once more is no action.
    problem = make_problem(
        "(!b U a) & F b",
        ["a", "b"],
        [[0, 0], [5, 0]],
        [[0, 0]],
        [[1, 1], [0.2, 0.2]],
        searched=[0],
        interact_time_s=2.0,
    )
    travel_s = problem.kinds[0].travel_s.copy()
    travel_s[0, 1] = travel_s[1, 0] = np.inf
    barred = replace(problem, kinds=(replace(problem.kinds[0], travel_s=travel_s),))
    for name in ("pouct", "pouct_paper"):
        plan = make_planner(name, {"samples": 50}).plan(barred, seed=0)
        assert plan.assignments[0] == (0, 0)
        gone = replace(barred, presence_prob=np.array([[0.0, 0.0], [0.2, 0.2]]))
        assert make_planner(name, {"samples": 50}).plan(gone, seed=0).assignments[0].container == 1
