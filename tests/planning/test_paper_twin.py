"""The kernels of `pouct_paper` against their twins in plain Python, value for value."""

from dataclasses import replace

import numpy as np
import pytest

from mrtask.planning import paper
from mrtask.planning import paper_kernel as kernel
from mrtask.planning.compiled import random_unit
from mrtask.planning.problem import RobotStatus
from mrtask.planning.tree import SearchOptions, edges_of, empty_tree
from tests.planning.naive_paper import WAIT, NaivePaperSearch
from tests.planning.naive_random import SplitMix64
from tests.planning.problems import random_problem, tiny_problem


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
    travel_s = problem.travel_s.copy()
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
    return replace(problem, presence_prob=prob, searched=searched, travel_s=travel_s, robots=team)


PROBLEMS = [*(pytest.param(tiny_problem(number), id=f"tiny-{number}") for number in range(20)),
            *(pytest.param(odd_problem(seed), id=f"odd-{seed}") for seed in range(8))]  # fmt: skip


def test_the_random_numbers_are_splitmix64():
    # Published first outputs for this seed (Rosetta Code, "Pseudo-random numbers/Splitmix64").
    twin = SplitMix64(1234567)
    assert [twin.next_bits() for _ in range(3)] == [6457827717110365317, 3203168211198807973, 9817491932198370423]
    for seed in (0, 7, 2**63 - 1):
        twin, state = SplitMix64(seed), np.array([seed], dtype=np.uint64)
        assert [random_unit(state) for _ in range(100)] == [twin.unit() for _ in range(100)]
        assert int(state[0]) == twin.state


def scratch_of(model):
    containers, objects = model.prob.shape
    return kernel.Scratch(np.empty(containers), np.empty(containers, dtype=np.int32), np.empty(objects))


def assert_equal(compiled, belief):
    """A kernel's belief and a twin's hold the same."""
    assert (compiled.clock[0], compiled.state[0]) == (belief.clock_s, belief.z)
    assert compiled.state[1] == sum(1 << obj for obj in belief.located())
    assert set(np.flatnonzero(compiled.searched)) == belief.searched
    for pair in np.ndindex(*compiled.known.shape):
        code = {None: kernel.UNKNOWN, True: kernel.PRESENT, False: kernel.ABSENT}[belief.known.get(pair)]
        assert compiled.known[pair] == code
    for index, robot in enumerate(belief.robots):
        assert compiled.undecided[index] == robot.undecided
        assert compiled.place[index] == (kernel.NONE if robot.place is None else robot.place)
        assert compiled.obj[index] == (kernel.NONE if robot.obj is None else robot.obj)
        if robot.obj is not None:
            assert (compiled.arrive_s[index], compiled.done_s[index]) == (robot.arrive_s, robot.done_s)


@pytest.mark.parametrize("problem", PROBLEMS)
def test_random_plays_are_equal_step_by_step(problem):
    objects = problem.presence_prob.shape[1]
    model, root, compiled = paper.paper_model(problem), paper.root_belief(problem), paper.blank_belief(problem)
    scratch = scratch_of(model)
    choice = np.random.default_rng(1)
    for seed in range(10):
        twin, rng = NaivePaperSearch(problem, seed=seed), np.array([seed], dtype=np.uint64)
        belief = twin.start
        kernel.copy_belief(root, compiled)
        assert_equal(compiled, belief)
        for _ in range(60):
            assert kernel.lower_bound_s(model, compiled, scratch) == twin.lower_bound_s(belief)
            for robot in belief.undecided():
                allowed = twin.allowed(belief, robot)
                flags = [kernel._allowed(model, compiled, robot, action) for action in range(model.prob.size)]
                assert [divmod(int(action), objects) for action in np.flatnonzero(flags)] == allowed
                assert kernel._may_wait(compiled, robot) == twin.may_wait(belief, robot)
                action = [*allowed, WAIT][choice.integers(len(allowed) + 1)]
                twin.act(belief, robot, action)
                kernel.act(model, compiled, robot, WAIT if action == WAIT else action[0] * objects + action[1])
            assert_equal(compiled, belief)
            assert not kernel._any_undecided(compiled)
            freed = twin.advance(belief)
            order = kernel.sample_outcome(model, compiled, rng)
            assert order == (kernel.NONE if freed is None else 2 * freed[0] + freed[1])
            assert_equal(compiled, belief)
            assert int(rng[0]) == twin.random.state
            if freed is None or twin.accepting[belief.z]:
                break
            kernel._mark_undecided(compiled)
            for waiting in belief.robots:
                waiting.undecided |= waiting.obj is None


def assert_equal_trees(tree, index, node, objects):
    """The kernel's tree from a node on and the twin's: visits, tries, totals, children, and what keys stand for."""
    assert (tree.robot[index], tree.visits[index]) == (node.robot, node.visits)
    edges = edges_of(tree, index)[::-1]
    assert len(edges) == len(node.edges)
    for edge, twin in zip(edges, node.edges, strict=True):
        assert tree.action[edge] == (WAIT if twin.action == WAIT else twin.action[0] * objects + twin.action[1])
        assert (tree.edge_visits[edge], tree.total_s[edge]) == (twin.tries, twin.total_s)
        child = tree.first_child[edge]
        for twin_child in twin.children:
            assert tree.key[child] == encoded(twin_child.label)
            assert_equal_trees(tree, child, twin_child, objects)
            child = tree.sibling[child]
        assert child == kernel.NONE


def encoded(label):
    if label is None:
        return kernel.NONE
    (robot, found), seen = label
    key = 2 * robot + found
    for there in seen:
        key = 3 * key + {None: kernel.UNKNOWN, True: kernel.PRESENT, False: kernel.ABSENT}[there]
    return key


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize(("samples", "limit"), [(600, 601), (400, 60)])
def test_searches_grow_the_same_tree(problem, samples, limit):
    twin = NaivePaperSearch(problem, exploration=0.7, limit=limit, seed=5)
    twin.run(samples)
    model, root, belief = paper.paper_model(problem), paper.root_belief(problem), paper.blank_belief(problem)
    tree = empty_tree(SearchOptions(samples=samples, max_nodes=limit))
    kernel.decision_node(root, tree, kernel.NONE)
    rng = np.array([5], dtype=np.uint64)
    kernel.run_samples(model, root, belief, tree, 0.7, rng, samples, scratch_of(model))
    assert list(tree.size) == [twin.nodes, twin.edges]
    assert list(tree.moments) == [twin.count, twin.mean_s, twin.squares, twin.spread_s]
    assert_equal_trees(tree, 0, twin.root, problem.presence_prob.shape[1])
