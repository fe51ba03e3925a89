from collections import Counter
from itertools import product
from math import prod

import numpy as np
import pytest

from mrtask.planning.compiled import compiled
from mrtask.planning.paper import belief_kernel as kernel
from mrtask.planning.paper.belief_kernel import LOCATED
from mrtask.planning.paper.paper_model import blank_belief, paper_model, root_belief, sufficient_sets
from mrtask.planning.shared_kernel import AUTOMATON, NONE
from mrtask.planning.team_model import state_records
from mrtask.tasks.automaton import build_automaton
from tests.planning.algorithm1 import RobotAction, TeamBelief, advance_belief_until_robot_free
from tests.planning.problems import random_problem

copy_belief, sample_outcome = compiled(kernel.copy_belief), compiled(kernel.sample_outcome)


def random_team(seed, robots=3, containers=4):
    rng = np.random.default_rng(seed)
    automaton = build_automaton("(!b U a) & F b & F c", ["a", "b", "c"])
    likelihood = {pair: float(rng.random()) for pair in product(range(containers), range(3))}
    known = rng.permutation(list(likelihood))[:3]
    present, absent = frozenset([tuple(map(int, known[0]))]), frozenset(tuple(map(int, pair)) for pair in known[1:])
    actions = []
    for _ in range(robots):
        arrive = float(rng.integers(0, 4))
        pair = rng.integers(containers), rng.integers(3)
        waits = actions and rng.random() < 0.2
        actions.append(
            None if waits else RobotAction(int(pair[0]), int(pair[1]), arrive, arrive + float(rng.integers(0, 3)))
        )
    return TeamBelief(0.0, automaton.initial, present, absent, tuple(actions)), automaton, likelihood


def enumerate_outcomes(belief, automaton, likelihood, exists):
    """Plays every possible content of the pairs acted on to the first freed robot; no weights along the way.

    With ``exists``, every content of all containers in which some object acted on is nowhere is left out.
    """
    acted = {action.pair for action in belief.actions if action}
    pairs = sorted(pair for pair in likelihood if pair[1] in {obj for _, obj in acted}) if exists else sorted(acted)
    sure = {
        pair: 1.0 if pair in belief.present else 0.0 if pair in belief.absent else likelihood[pair] for pair in pairs
    }
    result = Counter()
    for contents in product((False, True), repeat=len(pairs)):
        there = dict(zip(pairs, contents, strict=True))
        prob = prod(sure[pair] if there[pair] else 1 - sure[pair] for pair in pairs)
        somewhere = {obj for (_, obj), here in there.items() if here}
        if prob == 0 or (exists and not {obj for _, obj in acted} <= somewhere):
            continue
        ends = []
        for robot, action in enumerate(belief.actions):
            if action:
                advances = automaton.advancing[belief.state, action.obj]
                found = there[action.pair]
                end = action.done_s if found and advances else action.arrive_s
                ends.append((end, robot, found, action))
        end, robot, found, action = min(ends, key=lambda item: item[:2])
        # What was learned by then: arrivals before that instant, and at it those of robots with a lower index.
        learned = {
            other.pair: there[other.pair]
            for index, other in enumerate(belief.actions)
            if other and (other.arrive_s, index) <= (end, robot)
        }
        present = belief.present | {pair for pair, here in learned.items() if here}
        absent = belief.absent | {pair for pair, here in learned.items() if not here}
        state = int(automaton.transitions[belief.state, action.obj])
        if not (found and automaton.advancing[belief.state, action.obj]):
            state = belief.state
        result[(robot, found, end, state, present, absent)] += prob
    total = sum(result.values())
    return {outcome: prob / total for outcome, prob in result.items()}


@pytest.mark.parametrize("exists", [False, True])
@pytest.mark.parametrize("seed", range(200))
def test_algorithm_1_equals_exhaustive_enumeration(seed, exists):
    belief, automaton, likelihood = random_team(seed)
    outcomes = advance_belief_until_robot_free(belief, automaton, likelihood, exists=exists)
    assert sum(outcome.prob for outcome in outcomes) == pytest.approx(1.0, abs=1e-12)
    walked = Counter()
    for outcome in outcomes:
        after = outcome.belief
        assert after.actions[outcome.robot] is None
        walked[(outcome.robot, outcome.found, after.time_s, after.state, after.present, after.absent)] += outcome.prob
    expected = enumerate_outcomes(belief, automaton, likelihood, exists)
    assert walked.keys() == expected.keys()
    for key, prob in expected.items():
        assert walked[key] == pytest.approx(prob, abs=1e-12)


def test_algorithm_1_by_hand():
    # Robot 0 arrives at 1 and interacts until 4; robot 1 arrives at 2 and interacts until 3.
    automaton = build_automaton("F a & F b", ["a", "b"])
    actions = (RobotAction(0, 0, 1.0, 4.0), RobotAction(1, 1, 2.0, 3.0))
    belief = TeamBelief(0.0, automaton.initial, frozenset(), frozenset(), actions)
    outcomes = advance_belief_until_robot_free(belief, automaton, {(0, 0): 0.25, (1, 1): 0.4})
    assert [(o.robot, o.found, o.belief.time_s, round(o.prob, 12)) for o in outcomes] == [
        (0, False, 1.0, 0.75),
        (1, False, 2.0, 0.15),
        (1, True, 3.0, 0.1),
    ]
    assert outcomes[2].belief.present == {(0, 0), (1, 1)}
    assert outcomes[2].belief.state == automaton.run(["b"])


def test_a_team_that_only_waits_is_refused():
    automaton = build_automaton("F a", ["a"])
    belief = TeamBelief(0.0, automaton.initial, frozenset(), frozenset(), (None, None))
    with pytest.raises(ValueError, match="every robot waits"):
        advance_belief_until_robot_free(belief, automaton, {})


@pytest.mark.parametrize("exists", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_the_kernel_draws_algorithm_1s_outcomes(seed, exists):
    team, automaton, likelihood = random_team(seed, robots=3, containers=4)
    problem = random_problem(0, template="and3", robots=3, containers=4)
    model = paper_model(problem, exists=exists)._replace(
        prob=np.array([[likelihood[c, o] for o in range(3)] for c in range(4)]),
        transitions=automaton.transitions.astype(np.int32),
        states=state_records(automaton, np.ones(3, dtype=bool)),
    )
    root, scratch = root_belief(problem, model), blank_belief(problem)
    root.state[AUTOMATON] = team.state
    for container, obj in team.present:
        root.containers[container].present |= 1 << obj
        root.state[LOCATED] |= 1 << obj
    for container, obj in team.absent:
        root.containers[container].absent |= 1 << obj
    for obj in range(3):
        open_pairs = [pair for pair in likelihood if pair[1] == obj and pair not in team.present | team.absent]
        root.nowhere[obj] = prod(1 - likelihood[pair] for pair in open_pairs)
    for robot, action in enumerate(team.actions):
        if action:
            root.robots[robot].place, root.robots[robot].obj = action.pair
            root.robots[robot].arrive_s, root.robots[robot].done_s = action.arrive_s, action.done_s
    rng, draws, seen = np.array([seed], dtype=np.uint64), 20_000, Counter()
    for _ in range(draws):
        copy_belief(model, root, scratch)
        order = sample_outcome(model, scratch, rng)
        assert order != NONE
        seen[(order // 2, bool(order % 2), float(scratch.clock[0]), int(scratch.state[0]))] += 1
    expected = Counter()
    for outcome in advance_belief_until_robot_free(team, automaton, likelihood, exists=exists):
        expected[(outcome.robot, outcome.found, outcome.belief.time_s, outcome.belief.state)] += outcome.prob
    assert seen.keys() <= expected.keys()
    for key, prob in expected.items():
        five_sigma = 5 * np.sqrt(prob * (1 - prob) / draws)
        assert seen[key] / draws == pytest.approx(prob, abs=five_sigma + 1e-9)


def test_sufficient_sets_are_minimal_and_complete():
    table = sufficient_sets(build_automaton("F a & (F b | F c)", ["a", "b", "c"]))
    assert sorted(members for members in table[0] if members != NONE) == [0b011, 0b101]
