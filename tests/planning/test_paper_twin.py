"""The kernels of `pouct_paper` against their twins in plain Python, value for value."""

from dataclasses import replace

import numpy as np
import pytest

from mrtask.planning import compiled as compiling
from mrtask.planning.compiled import compiled
from mrtask.planning.paper import action_kernel, leaf_kernel
from mrtask.planning.paper import search_kernel as kernel
from mrtask.planning.paper.paper_model import blank_belief
from mrtask.planning.paper.planner import PaperOptions, PaperSearch
from mrtask.planning.problem import RobotStatus
from mrtask.planning.shared_kernel import any_undecided
from mrtask.planning.tree import edges_of
from tests.planning.naive_paper import WAIT, NaivePaperSearch
from tests.planning.naive_random import SplitMix64
from tests.planning.problems import random_problem, tiny_problem, unlike

act, any_undecided, copy_belief = compiled(kernel.act), compiled(any_undecided), compiled(kernel.copy_belief)
decision_node, mark_undecided = compiled(kernel.decision_node), compiled(kernel.mark_undecided)
may_wait, sample_outcome = compiled(kernel.may_wait), compiled(kernel.sample_outcome)
next_action, rest_s = compiled(action_kernel.next_action), compiled(leaf_kernel.rest_s)
random_unit = compiled(compiling.random_unit)


def odd_problem(seed):
    """A larger problem with what random ones rarely have: certain likelihoods, dead ends, and busy robots."""
    rng = np.random.default_rng(seed)
    template = ("and3", "and_or", "seq3", "or_seq")[seed % 4]
    problem = random_problem(
        seed, template=template, robots=4, containers=6, search_time_s=seed % 2 * 1.5, interact_time_s=seed % 3 * 1.0
    )
    prob, searched = problem.presence_prob.copy(), problem.searched.copy()
    prob[rng.random(prob.shape) < 0.2] = 0.0
    prob[rng.random(prob.shape) < 0.1] = 1.0
    searched[[0, 1]] = True
    prob[[0, 1]] = rng.random((2, prob.shape[1])) < 0.6
    travel_s = problem.kinds[0].travel_s.copy()
    travel_s[5, :5] = travel_s[:5, 5] = np.inf
    away_s = np.append(problem.robots[0].travel_s[:5], np.inf)
    team = (
        RobotStatus(travel_s[0], place=0),
        RobotStatus(away_s),
        RobotStatus(away_s, free=False, target=2, interaction=1, remaining_s=float(away_s[2])),
        RobotStatus(travel_s[1], place=1, free=False, interacting=0, remaining_s=0.4)
        if seed % 2
        else RobotStatus(travel_s[3], place=3, free=False, remaining_s=0.6),
    )
    kinds = (replace(problem.kinds[0], travel_s=travel_s),)
    return replace(problem, presence_prob=prob, searched=searched, kinds=kinds, robots=team)


PROBLEMS = [*(pytest.param(tiny_problem(number), id=f"tiny-{number}") for number in range(20)),
            *(pytest.param(odd_problem(seed), id=f"odd-{seed}") for seed in range(8)),
            *(pytest.param(unlike(tiny_problem(number), number, abilities=False), id=f"unlike-{number}")
              for number in range(4, 12))]  # fmt: skip


def test_the_random_numbers_are_splitmix64():
    # Published first outputs for this seed (Rosetta Code, "Pseudo-random numbers/Splitmix64").
    twin = SplitMix64(1234567)
    assert [twin.next_bits() for _ in range(3)] == [6457827717110365317, 3203168211198807973, 9817491932198370423]
    for seed in (0, 7, 2**63 - 1):
        twin, state = SplitMix64(seed), np.array([seed], dtype=np.uint64)
        assert [random_unit(state) for _ in range(100)] == [twin.unit() for _ in range(100)]
        assert int(state[0]) == twin.state


def assert_equal(compiled, belief):
    """A kernel's belief and a twin's hold the same."""
    assert (compiled.clock[0], compiled.state[0]) == (belief.clock_s, belief.z)
    assert compiled.state[1] == mask(belief.located())
    assert set(np.flatnonzero(compiled.containers.searched)) == belief.searched
    for c, (present, absent) in enumerate(zip(compiled.containers.present, compiled.containers.absent, strict=True)):
        assert present == mask(o for (k, o), there in belief.known.items() if k == c and there)
        assert absent == mask(o for (k, o), there in belief.known.items() if k == c and not there)
    assert compiled.nowhere.tolist() == belief.nowhere
    for index, robot in enumerate(belief.robots):
        assert compiled.robots[index].undecided == robot.undecided
        assert compiled.robots[index].under_way == robot.under_way
        assert compiled.robots[index].place == (kernel.NONE if robot.place is None else robot.place)
        assert compiled.robots[index].obj == (kernel.NONE if robot.obj is None else robot.obj)
        if robot.obj is not None:
            times_s = (compiled.robots[index].arrive_s, compiled.robots[index].done_s, compiled.robots[index].reach_s)
            assert times_s == (robot.arrive_s, robot.done_s, robot.reach_s)


def mask(objects):
    return sum(1 << obj for obj in objects)


EVERY_SWITCH = (
    PaperOptions(exploration=0.7, exists=False, max_actions=None),
    PaperOptions(leaf="zero", exploration=2.0, exploration_unit="seconds", exists=False),
    PaperOptions(leaf="nearest", max_actions=None),
    PaperOptions(max_actions=2),
    PaperOptions(max_actions=3, round_decimals=1, avoid_targets=True, exists=False),
    PaperOptions(avoid_targets=True, advance_when_alone=True, reassign="all", exists=False),
    PaperOptions(reassign="all", max_actions=4, exploration=0.5),
    PaperOptions(leaf="zero", reassign="all", max_nodes=60, max_actions=None, exists=False),
)


def switches(options):
    default = vars(PaperOptions())
    return ",".join(f"{name}={value}" for name, value in vars(options).items() if value != default[name])


CASES = [
    pytest.param(options, problem.values[0], id=f"{problem.id}-{switches(options)}")
    for number, options in enumerate(EVERY_SWITCH)
    for problem in (PROBLEMS if number == 0 else PROBLEMS[number % 4 :: 4])
]
"""Every problem with the defaults, and a quarter of them with each other setting."""


@pytest.mark.parametrize(("options", "problem"), CASES)
def test_random_plays_are_equal_step_by_step(problem, options):
    objects = problem.presence_prob.shape[1]
    search = PaperSearch(problem, options, seed=0)
    model, compiled = search.model, blank_belief(problem)
    choice = np.random.default_rng(1)
    for seed in range(3):
        twin, rng = NaivePaperSearch(problem, options, seed=seed), np.array([seed], dtype=np.uint64)
        belief = twin.start
        copy_belief(model, search.root, compiled)
        assert_equal(compiled, belief)
        for _ in range(60):
            assert rest_s(model, compiled, search.bound, search.rollouts, rng) == twin.rest_s(belief)
            for robot in belief.undecided():
                search.tree.size[:] = 0
                node = decision_node(compiled, search.tree, kernel.NONE)
                allowed = twin.actions(belief, robot)
                assert tried(search, compiled, node) == allowed
                assert may_wait(compiled, robot) == twin.may_wait(belief, robot)
                action = [*allowed, WAIT][choice.integers(len(allowed) + 1)]
                twin.act(belief, robot, action)
                act(model, compiled, robot, WAIT if action == WAIT else action[0] * objects + action[1])
            assert_equal(compiled, belief)
            assert not any_undecided(compiled)
            freed = twin.advance(belief)
            order = sample_outcome(model, compiled, rng)
            assert order == (kernel.NONE if freed is None else 2 * freed[0] + freed[1])
            assert_equal(compiled, belief)
            assert int(rng[0]) == twin.random.state
            if freed is None or twin.accepting[belief.z]:
                break
            twin.put_up(belief)
            mark_undecided(model, compiled)
            assert_equal(compiled, belief)


def tried(search, belief, node):
    """The pairs (container, object) that a node tries, in order."""
    containers, objects = search.model.prob.shape
    pairs = []
    while (action := next_action(search.model, belief, search.rules, search.limits, search.tree, node)) < (
        containers * objects
    ):
        pairs.append(divmod(int(action), objects))
    return pairs


def assert_equal_trees(tree, index, node, objects, close=0.0):
    """The kernel's tree from a node on and the twin's: visits, tries, totals, children, and what keys stand for."""
    assert (tree.nodes[index].robot, tree.nodes[index].visits) == (node.robot, node.visits)
    edges = edges_of(tree, index)[::-1]
    assert len(edges) == len(node.edges)
    for edge, twin in zip(edges, node.edges, strict=True):
        assert tree.edges[edge].action == (WAIT if twin.action == WAIT else twin.action[0] * objects + twin.action[1])
        assert tree.edges[edge].visits == twin.tries
        assert tree.edges[edge].total_s == pytest.approx(twin.total_s, rel=close, abs=0)
        child = tree.edges[edge].first_child
        for twin_child in twin.children:
            assert tree.nodes[child].key == encoded(twin_child.label)
            assert_equal_trees(tree, child, twin_child, objects, close)
            child = tree.nodes[child].sibling
        assert child == kernel.NONE


def encoded(label):
    if label is None:
        return kernel.NONE
    (robot, found), seen = label
    key = 2 * robot + found
    for there in seen:
        key = 3 * key + {None: 0, True: 1, False: 2}[there]
    return key


@pytest.mark.parametrize(("options", "problem"), CASES)
def test_searches_grow_the_same_tree(problem, options):
    options = replace(options, samples=300)
    twin, search = NaivePaperSearch(problem, options, seed=5), PaperSearch(problem, options, seed=5)
    twin.run(options.samples)
    search.run(options.samples)
    tree = search.tree
    assert list(tree.size) == [twin.nodes, twin.edges]
    assert list(tree.moments) == [twin.count, twin.mean_s, twin.squares, twin.spread_s]
    assert_equal_trees(tree, 0, twin.root, problem.presence_prob.shape[1])


@pytest.mark.parametrize("reassign", ["free", "all"])
@pytest.mark.parametrize("problem", PROBLEMS[::3])
def test_searches_with_rollouts_grow_the_same_tree(problem, reassign):
    # The twin adds up a rollout's times and probabilities in another order: costs are equal but for rounding.
    options = PaperOptions(leaf="greedy", reassign=reassign, samples=150)
    twin, search = NaivePaperSearch(problem, options, seed=5), PaperSearch(problem, options, seed=5)
    twin.run(options.samples)
    search.run(options.samples)
    assert list(search.tree.size) == [twin.nodes, twin.edges]
    assert_equal_trees(search.tree, 0, twin.root, problem.presence_prob.shape[1], close=1e-9)
