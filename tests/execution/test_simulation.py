from itertools import permutations

import numpy as np
import pytest

from mrtask.execution.letters import serving_order
from mrtask.execution.simulation import Simulation
from mrtask.execution.team_spec import RobotSpec, Team
from mrtask.planning.problem import WAIT, Assignment
from mrtask.tasks.automaton import build_automaton

FRIDGE, TABLE, BED = 0, 1, 2


def simulate(home, home_map, formula="(!Pillow U Egg) & F Pillow", known=False, **times):
    automaton = build_automaton(formula, ["Egg", "Pillow"])
    truth = np.array([[name in container.objects for name in automaton.propositions] for container in home.containers])
    start = tuple(int(part) for part in home_map.access[TABLE])
    team = Team.alike(2, RobotSpec(**times))
    return Simulation(
        home, home_map, automaton, np.full(truth.shape, 0.2), truth, team=team, start_cell=start, known=known
    )


def test_a_search_reveals_all_task_objects_and_frees_the_robot(two_room_home, two_room_map):
    simulation = simulate(two_room_home, two_room_map)
    simulation.assign({0: Assignment(BED), 1: Assignment(WAIT)})
    assert simulation.advance()
    problem = simulation.problem()
    assert simulation.time_s == pytest.approx(two_room_map.travel_m[TABLE, BED])
    assert problem.searched.tolist() == [False, False, True]
    assert problem.presence_prob[BED].tolist() == [0.0, 1.0]
    assert problem.may_redirect
    assert problem.robots[0].free and problem.robots[1].free
    assert not simulation.accepted  # the pillow's turn comes after the egg's


def test_robots_under_way_turn_round_only_when_something_was_learned(two_room_home, two_room_map):
    simulation = simulate(two_room_home, two_room_map, known=True)
    simulation.assign({0: Assignment(TABLE), 1: Assignment(BED)})
    assert simulation.advance()  # robot 0 is at the table, where nothing is to be seen or done
    problem = simulation.problem()
    assert problem.robots[0].free and problem.robots[1].target == BED
    assert not problem.may_redirect
    with pytest.raises(ValueError, match=r"robot 1 is busy \(move\)"):
        simulation.assign({0: Assignment(WAIT), 1: Assignment(FRIDGE)})


def test_a_redirected_robot_goes_on_from_where_it_is(two_room_home, two_room_map):
    simulation = simulate(two_room_home, two_room_map)
    simulation.assign({0: Assignment(FRIDGE), 1: Assignment(BED)})
    assert simulation.advance()  # the egg is found and taken in the fridge
    passed_s = simulation.time_s
    left_s = simulation.problem().robots[1].travel_s
    assert left_s[BED] == pytest.approx(two_room_map.travel_m[TABLE, BED] - passed_s, abs=1e-4)
    simulation.assign({0: Assignment(WAIT), 1: Assignment(TABLE)})
    assert simulation.advance()
    assert simulation.time_s == pytest.approx(passed_s + left_s[TABLE], abs=1e-4)
    assert left_s[TABLE] <= passed_s + 1e-4


def test_a_robot_waiting_at_an_object_takes_it_when_its_turn_comes(two_room_home, two_room_map):
    simulation = simulate(two_room_home, two_room_map, search_time_s=1.0, interact_time_s=2.0)
    simulation.assign({0: Assignment(BED), 1: Assignment(WAIT)})
    assert simulation.advance()
    simulation.assign({0: Assignment(WAIT), 1: Assignment(FRIDGE)})
    while not simulation.accepted:
        assert simulation.advance()
        waiting = {index: Assignment(WAIT) for index, robot in enumerate(simulation.problem().robots) if robot.free}
        if not simulation.accepted:
            simulation.assign(waiting)
    trace = simulation.trace()
    assert [(letter.robot, letter.object) for letter in trace.letters] == [(1, "Egg"), (0, "Pillow")]
    to_bed_s, to_fridge_s = two_room_map.travel_m[TABLE, [BED, FRIDGE]]
    assert simulation.time_s == pytest.approx(to_bed_s + 1.0 + to_fridge_s + 1.0 + 2.0 + 2.0, abs=1e-4)


def test_free_robots_must_be_told_something(two_room_home, two_room_map):
    simulation = simulate(two_room_home, two_room_map)
    with pytest.raises(ValueError, match="left free robot 1 without an assignment"):
        simulation.assign({0: Assignment(BED)})


def test_a_team_that_only_waits_is_noticed(two_room_home, two_room_map):
    simulation = simulate(two_room_home, two_room_map)
    simulation.assign({0: Assignment(WAIT), 1: Assignment(WAIT)})
    assert not simulation.advance()


def test_letters_of_one_instant_come_in_the_order_that_serves_the_task():
    automaton = build_automaton("(!b U a) & F b", ["a", "b"])
    assert serving_order(automaton, automaton.initial, frozenset([0, 1])) == [0, 1]
    reverse = build_automaton("(!a U b) & F a", ["a", "b"])
    assert serving_order(reverse, reverse.initial, frozenset([0, 1])) == [1, 0]
    either = build_automaton("F a | F b", ["a", "b"])
    assert serving_order(either, either.initial, frozenset([0, 1])) == [0]


def test_letters_of_one_instant_are_dropped_only_where_they_do_not_advance():
    # By `b` the short way over `a` is given up: three letters are left instead of one.
    automaton = build_automaton("(!b U a) | F (b & X F (c & X F d))", ["a", "b", "c", "d"])
    assert serving_order(automaton, automaton.initial, frozenset([1])) == [1]
    assert serving_order(automaton, automaton.initial, frozenset([0, 1])) == [0]
    assert serving_order(automaton, automaton.initial, frozenset([1, 2, 3])) == [1, 2, 3]


@pytest.mark.parametrize("number", range(20))
def test_the_serving_order_is_the_best_of_all_orders(number):
    rng = np.random.default_rng(number)
    texts = ("(!b U a) | F (b & X F (c & X F d))", "F a & (F b | F c) & F d", "((!c & !b) U a) & (!c U b) & F c | F d")
    automaton = build_automaton(texts[number % 3], ["a", "b", "c", "d"])
    state = int(rng.integers(len(automaton.transitions)))
    objects = frozenset(np.flatnonzero(rng.random(4) < 0.6).tolist())
    outcomes = []
    for order in permutations(sorted(objects)):
        here, made = state, []
        for obj in order:
            if automaton.advancing[here, obj]:
                here = int(automaton.transitions[here, obj])
                made.append(obj)
        outcomes.append((int(automaton.steps_to_accept[here]), -len(made), made))
    assert serving_order(automaton, state, objects) == min(outcomes)[2]
