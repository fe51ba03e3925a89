"""The live team: it decides as the simulated episode does, and takes in whatever comes in whatever order."""

import json
from dataclasses import replace
from itertools import count, pairwise
from math import dist
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import TypeAdapter

from mrtask.errors import InputError
from mrtask.execution.perception import Perception, Rates
from mrtask.execution.setbacks import NAVIGATE
from mrtask.execution.team_spec import RobotSpec
from mrtask.live.live_team import LiveTeam
from mrtask.live.messages import Event
from mrtask.live.orders import task_state, welcome
from mrtask.live.state import LiveSetup
from mrtask.live.state_file import read_state
from mrtask.live.store import StateError, restore, save
from mrtask.maps.home_map import build_map
from mrtask.tasks.words import ReadTask
from tests.live.twins import HONEST, check_twins, play, sample
from tests.live.world import World, answers_of, orders_of

EVENT = TypeAdapter(Event)

TRIALS = 12
"""100 by hand: tests/live/twins.py."""


@pytest.fixture(scope="module")
def trials(generated_homes):
    maps = {home.id: build_map(home) for home in generated_homes}
    return [sample(generated_homes, maps, number) for number in range(TRIALS)]


@pytest.mark.parametrize("planner", HONEST)
def test_live_team_and_simulated_episode_do_the_same(trials, planner):
    for trial in trials:
        check_twins(*trial, planner)


@pytest.fixture
def live(two_room_home, two_room_map):
    return two_robots(two_room_home, two_room_map)


def two_robots(
    home, home_map, planner="greedy", formula="F Egg & F Pillow", likely=(), perception=None, options=None, speed=1.0
):
    """Both in the kitchen; the egg is in the fridge, the pillow on the bed."""
    task = ReadTask(formula, ("Egg", "Pillow"))
    likelihood = np.array([[0.5 if container.id in likely else 0.2] * 2 for container in home.containers])
    spec = RobotSpec(speed, 2.0, 2.0, perception or Perception())
    setup = LiveSetup(
        home, home_map, formula, task, likelihood, spec, planner, (options or {}).get(planner, {}), lost_after_s=60.0
    )
    return LiveTeam(setup, {"r1": (1.5, 1.5), "r2": (2.5, 1.5)})


NUMBERS = count()


def event(kind, time_s, **fields):
    return EVENT.validate_json(json.dumps({"type": kind, "id": f"x{next(NUMBERS)}", "time_s": time_s, **fields}))


def one(live, kind, time_s, **fields):
    """Sends one event: its answer and the orders that follow, by robot."""
    replies = live.handle([event(kind, time_s, **fields)])
    return answers_of(replies)[0], {order.robot: order for order in orders_of(replies)}


def begin(live):
    return {order.robot: order for order in orders_of(live.begin())}


def test_orders_have_routes_from_the_robot_to_the_container(live, two_room_map):
    orders = begin(live)
    assert {order.action for order in orders.values()} == {"navigate"}
    for name, start in (("r1", (1.5, 1.5)), ("r2", (2.5, 1.5))):
        order = orders[name]
        container = list(live.containers).index(order.container)
        assert dist(order.route[0], start) < 0.05
        assert order.route[-1] == two_room_map.cell_center(tuple(two_room_map.access[container]))
        assert order.length_m == pytest.approx(sum(dist(*ends) for ends in pairwise(order.route)))
        middle = np.mean(live.setup.home.containers[container].footprint, axis=0)
        ahead = middle - order.route[-1]
        assert (np.cos(order.heading_rad), np.sin(order.heading_rad)) == pytest.approx(ahead / np.hypot(*ahead))


def test_a_robot_that_is_early_has_driven_all_of_its_way(live):
    orders = begin(live)
    one(live, "arrived", 0.1, robot="r1", container=orders["r1"].container)
    (leg,) = live.team.robots[0].legs
    assert (leg.kind, leg.t1_s) == ("move", 0.1)
    assert sum(dist(*ends) for ends in pairwise(leg.path)) == pytest.approx(orders["r1"].length_m)


def target_of(live, name):
    robot = live.team.robots[live.names.index(name)]
    return live.team.containers[robot.assignment.container]


def test_a_find_in_passing_redirects_the_team(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, "learned_myopic")
    orders = begin(live)
    bed = next(name for name in live.containers if "3|0" in name)
    assert bed not in {order.container for order in orders.values()}
    answer, _ = one(live, "object_seen", 0.5, container=bed, object="pillow")
    assert answer.status == "accepted"
    assert live.team.belief.presence_prob[live.containers[bed], 1] == 1.0
    assert bed in {target_of(live, "r1"), target_of(live, "r2")}


def test_an_object_that_is_gone_is_looked_for_elsewhere(live):
    begin(live)
    name = "r1"
    place = target_of(live, name)
    one(live, "arrived", 1.0, robot=name, container=place)
    _, orders = one(live, "search_ended", 3.0, robot=name, container=place, objects=["Egg", "Book"])
    assert (orders[name].action, orders[name].object) == ("interact", "Egg")
    _, orders = one(
        live, "interaction_ended", 5.0, robot=name, container=place, object="Egg", status="FAILED", gone=True
    )
    assert live.team.belief.presence_prob[live.containers[place], 0] == 0.0
    assert not live.team.letters
    assert orders[name].action == "navigate" and orders[name].container != place


def fail_all(live, time_s):
    """Every robot under way gives up, until nobody is; gives the time."""
    while moving := [name for name, robot in zip(live.names, live.team.robots, strict=True) if robot.moving]:
        time_s += 0.25
        one(live, "navigation_failed", time_s, robot=moving[0], container=target_of(live, moving[0]))
    return time_s


def test_goals_that_a_starting_navigation_rejects_use_nothing_up(live):
    begin(live)
    time_s = fail_all(live, 0.0)
    while time_s < 15.0:
        state = task_state(live)
        assert (state.status, state.wake_s > time_s) == ("running", True)
        assert "r1 failed 1 x at 2|0 and tries again" in state.reason or time_s > 5.0
        one(live, "clock", state.wake_s)
        time_s = fail_all(live, state.wake_s)
    assert not live.team.belief.searched.any()
    state = task_state(live)
    _, orders = one(live, "clock", state.wake_s)
    name, order = next(iter(orders.items()))
    answer, _ = one(live, "search_ended", state.wake_s, robot=name, container=order.container)
    assert answer.status == "accepted" and live.team.belief.searched.sum() == 1


def test_who_fails_again_and_again_tries_less_and_less_and_says_where(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F Egg")
    begin(live)
    one(live, "robot_lost", 0.0, robot="r2")
    time_s, waits = 0.0, []
    while task_state(live).status != "stuck":
        time_s = fail_all(live, time_s)
        waits.append(task_state(live).wake_s - time_s)
        one(live, "clock", task_state(live).wake_s)
        time_s = live.team.time_s
        fail_all(live, time_s)
    assert max(waits) > 2 * waits[0] > 0
    assert "r1 failed 3 x at 2|0" in task_state(live).reason


@pytest.mark.parametrize("how", ["try_again", "route_cleared", "robot that is there", "time"])
def test_failures_are_forgiven(two_room_home, two_room_map, how):
    live = two_robots(two_room_home, two_room_map, formula="F Egg")
    begin(live)
    one(live, "route_blocked", 0.0, x_m=7.5, y_m=3.5, radius_m=0.1)
    for _ in range(3):
        live.team.failed(live.team.robots[0], 0, NAVIGATE)
    assert np.isinf(live.team.problem().robots[0].travel_s[0])
    if how == "try_again":
        one(live, "try_again", 1.0, robot="r1", container="2|0")
    elif how == "route_cleared":
        one(live, "route_cleared", 1.0, x_m=7.5, y_m=3.5)
    elif how == "robot that is there":
        one(live, "arrived", 1.0, robot="r2", container="2|0")
    else:
        one(live, "clock", 500.0)
        one(live, "clock", 901.0)
        live.team.failed(live.team.robots[0], 0, NAVIGATE)
        assert live.team.robots[0].setbacks.by[0, NAVIGATE].count == 1
        return
    assert np.isfinite(live.team.robots[0].options_s(1.0)[0])


def test_failures_belong_to_a_robot(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F Egg")
    orders = begin(live)
    place = orders["r1"].container
    one(live, "search_ended", 1.0, robot="r2", container=orders["r2"].container)
    _, orders = one(live, "navigation_failed", 1.5, robot="r1", container=place)
    assert orders["r1"].container != place and target_of(live, "r2") == place


def test_what_failed_is_ordered_again_although_the_order_is_the_same(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F Egg")
    place = begin(live)["r1"].container
    one(live, "robot_lost", 0.5, robot="r2")
    others = [name for name in live.containers if name != place]
    for name in others:
        one(live, "object_seen", 0.5, container=name, object="Egg", present=False)
        one(live, "route_blocked", 0.5, **dict(zip(("x_m", "y_m"), spot(live, name), strict=True)), radius_m=0.1)
    for number, what in enumerate(("navigation_failed", "search_ended", "interaction_ended")):
        details = {"status": "FAILED"} if what != "navigation_failed" else {}
        details |= {"object": "Egg"} if what == "interaction_ended" else {}
        one(live, what, 100.0 * number + 1.0, robot="r1", container=place, **details)
        assert task_state(live).status == "running" and live.team.robots[0].free
        _, orders = one(live, "clock", task_state(live).wake_s)
        if what == "navigation_failed":
            assert (orders["r1"].action, orders["r1"].container) == ("navigate", place)
            one(live, "arrived", live.team.time_s + 1.0, robot="r1", container=place)
        elif what == "search_ended":
            assert (orders["r1"].action, orders["r1"].container) == ("search", place)
            one(live, "search_ended", live.team.time_s + 1.0, robot="r1", container=place, objects=["Egg"])
        else:
            assert (orders["r1"].action, orders["r1"].object) == ("interact", "Egg")


def spot(live, container):
    """Where robots stand at a container."""
    return live.setup.home_map.cell_center(tuple(live.setup.home_map.access[live.containers[container]]))


def test_a_second_search_is_ordered_where_the_first_may_have_missed_something(two_room_home, two_room_map):
    fridge = two_room_home.containers[0].id
    perception = Perception(Rates(0.6, 0.0))
    live = two_robots(two_room_home, two_room_map, formula="F Egg", likely=[fridge], perception=perception)
    orders = begin(live)
    name = next(name for name, order in orders.items() if order.container == fridge)
    one(live, "arrived", 2.0, robot=name, container=fridge)
    _, orders = one(live, "search_ended", 3.0, robot=name, container=fridge, objects=[])
    assert live.team.belief.posterior[0, 0] == pytest.approx(0.2 / 0.7)
    assert (orders[name].action, orders[name].container) == ("search", fridge), "0.29 there, 0.2 elsewhere"
    seen = [{"object": "egg", "confidence": 0.9}]
    _, orders = one(live, "search_ended", 4.0, robot=name, container=fridge, objects=seen)
    assert (orders[name].action, orders[name].object) == ("interact", "Egg")


def test_a_lost_robots_target_is_taken_over_and_it_can_come_back(live):
    begin(live)
    one(live, "robot_lost", 1.0, robot="r1")
    answer, _ = one(live, "arrived", 2.0, robot="r1", container=next(iter(live.containers)))
    assert (answer.status, "is lost" in answer.reason) == ("rejected", True)
    world = World({name: ("Egg", "Pillow") for name in live.containers}, 1.0, 2.0, 2.0, time_s=2.0)
    world.obey(live.present_orders())
    while not live.team.accepted:
        assert world.settle(live)
    assert {letter.robot for letter in live.team.letters} == {1}
    answer, _ = one(live, "robot_joined", world.time_s, robot="r1", x_m=1.0, y_m=1.5)
    assert answer.status == "accepted"


def test_a_silent_robot_is_missed_and_welcome_back(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F Egg")
    place = begin(live)["r1"].container
    other = target_of(live, "r2")
    one(live, "search_ended", 2.0, robot="r2", container=other)
    due_s = live.overdue_s(0)
    assert due_s > 60.0
    one(live, "pose", due_s - 0.1, robot="r2", x_m=2.5, y_m=1.5)
    assert place == target_of(live, "r1"), "not yet"
    _, orders = one(live, "pose", due_s, robot="r2", x_m=2.5, y_m=1.5)
    assert task_state(live).silent == ("r1",) and orders["r2"].container == place
    answer, _ = one(live, "try_again", due_s + 0.5, robot="r1")
    assert answer.status == "rejected", "an operator's word is none of the robot"
    answer, orders = one(live, "pose", due_s + 1.0, robot="r1", x_m=1.5, y_m=1.5)
    assert (answer.status, "r1 is back" in answer.reason) == ("accepted", True)
    assert not task_state(live).silent and orders["r1"].action == "navigate"
    one(live, "clock", due_s + 300.0)
    one(live, "robot_lost", due_s + 301.0, robot="r1")
    assert task_state(live).silent == ("r2",)
    answer, _ = one(live, "pose", due_s + 302.0, robot="r1", x_m=1.5, y_m=1.5)
    assert answer.status == "rejected" and "robot_joined brings it back" in answer.reason


def test_what_a_silent_robot_did_counts_when_it_speaks(live):
    place = begin(live)["r1"].container
    one(live, "search_ended", 3.0, robot="r1", container=place, objects=["Egg"])
    one(live, "clock", 500.0)
    assert set(task_state(live).silent) == {"r1", "r2"}
    assert "a word from r1, r2 helps" in task_state(live).reason
    answer, orders = one(live, "interaction_ended", 501.0, robot="r1", container=place, object="Egg")
    assert answer.status == "accepted" and "r1 is back" in answer.reason
    assert [letter.object for letter in live.team.letters] == ["Egg"]
    assert orders["r1"].action == "navigate"


def test_who_sends_heartbeats_is_missed_on_its_way(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F Egg", speed=0.01)
    begin(live)
    assert live.overdue_s(0) > 120.0, "slow robots have much time"
    one(live, "heartbeat", 1.0, robot="r1")
    assert live.overdue_s(0) == 61.0
    one(live, "clock", 62.0)
    assert task_state(live).silent == ("r1",)
    answer, _ = one(live, "heartbeat", 63.0, robot="r1")
    assert "back" in answer.reason and not task_state(live).silent


def test_a_finish_that_comes_after_the_loss_still_counts(live):
    begin(live)
    place = target_of(live, "r1")
    one(live, "search_ended", 3.0, robot="r1", container=place, objects=["Egg"])
    one(live, "robot_lost", 4.0, robot="r1")
    answer, _ = one(live, "interaction_ended", 3.9, robot="r1", container=place, object="Egg")
    assert answer.status == "accepted"
    assert [letter.object for letter in live.team.letters] == ["Egg"]


def test_a_blocked_door_changes_travel_times_and_a_cleared_one_restores_them(live, two_room_map):
    begin(live)
    before = live.team.problem().kinds[0].travel_s.copy()
    bed = live.containers[next(name for name in live.containers if "3|0" in name)]
    answer, _ = one(live, "route_blocked", 0.5, door="door|2|3")
    assert answer.status == "accepted"
    assert np.isinf(live.team.problem().kinds[0].travel_s[bed, :bed]).all()
    assert all(robot.assignment.container != bed for robot in live.team.robots)
    one(live, "route_cleared", 1.0, door="door|2|3")
    assert np.array_equal(live.team.problem().kinds[0].travel_s, before)


BEYOND = {"x_m": 5.0, "y_m": 2.0}
"""In the bedroom."""


def shut(live, time_s=0.5):
    return one(live, "route_blocked", time_s, door="door|2|3")


def test_a_robot_that_got_through_a_door_before_it_was_shut_is_there(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F Pillow")
    begin(live)
    shut(live)
    answer, orders = one(live, "pose", 1.0, robot="r1", **BEYOND)
    assert answer.status == "accepted" and "no way" in answer.reason
    assert orders["r1"].container == "3|0", "what it can get to from there"
    answer, orders = one(live, "arrived", 2.0, robot="r2", container="3|0")
    assert answer.status == "accepted" and live.team.robots[1].place in (live.containers["3|0"], -1)
    assert np.isfinite(live.team.problem().robots[1].travel_s[2])


def test_who_stands_in_a_blocked_place_can_leave_it(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map)
    begin(live)
    before = live.team.robots[0].position_at(0.5).point(two_room_map)
    x_m, y_m = before
    one(live, "route_blocked", 0.5, x_m=x_m, y_m=y_m, radius_m=1.2)
    robot = live.team.robots[0]
    assert dist(robot.position.point(two_room_map), before) < 0.05, "a barrier moves nobody"
    assert robot.moving and not live.team.home_map.free[robot.position.back]
    assert restore(live.setup, save(live)).team.robots[0].route.cells == robot.route.cells
    one(live, "pose", 1.0, robot="r1", x_m=3.5, y_m=3.0)
    assert robot.home_map is live.team.home_map, "once outside, it is held like the others"


def test_who_stands_at_a_container_in_a_blocked_place_goes_on_to_the_next(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F Egg")
    begin(live)
    one(live, "robot_lost", 0.5, robot="r2")
    place = target_of(live, "r1")
    one(live, "arrived", 1.0, robot="r1", container=place)
    x_m, y_m = spot(live, place)
    one(live, "route_blocked", 1.5, x_m=x_m, y_m=y_m, radius_m=0.2)
    _, orders = one(live, "search_ended", 2.0, robot="r1", container=place)
    assert orders["r1"].action == "navigate" and orders["r1"].container != place


@pytest.mark.parametrize("planner", ["greedy", "learned_myopic", "nonlearned_myopic"])
def test_what_lies_behind_a_shut_door_is_looked_for_elsewhere(two_room_home, two_room_map, planner):
    live = two_robots(two_room_home, two_room_map, planner, formula="F Pillow")
    begin(live)
    shut(live)
    live.team.learned(2, np.array([0.0, 1.0]))
    _, orders = one(live, "object_seen", 1.0, container="3|0", object="Pillow")
    assert {target_of(live, name) for name in live.names} == {"2|0", "2|1"}
    for name in live.names:
        one(live, "search_ended", 2.0, robot=name, container=target_of(live, name))
    state = task_state(live)
    assert state.status == "stuck" and "Pillow; no way leads to 3|0" in state.reason
    _, orders = one(live, "pose", 3.0, robot="r1", **BEYOND)
    assert orders["r1"].container == "3|0", "all wait, so any event may help"


def test_a_waiting_robot_that_turns_up_elsewhere_gets_work(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F Pillow")
    begin(live)
    shut(live)
    place = target_of(live, "r1")
    one(live, "search_ended", 1.0, robot="r1", container=place)
    assert live.team.robots[0].free and not live.team.robots[1].free
    _, orders = one(live, "pose", 2.0, robot="r1", **BEYOND)
    assert orders["r1"].container == "3|0"


@pytest.mark.parametrize("planner", ["learned_myopic", "nonlearned_myopic"])
def test_a_barrier_between_two_robots_stops_no_baseline(two_room_home, two_room_map, planner):
    live = two_robots(two_room_home, two_room_map, planner)
    one(live, "pose", 0.0, robot="r2", **BEYOND)
    shut(live)
    assert target_of(live, "r2") == "3|0" and target_of(live, "r1") in ("2|0", "2|1")


def test_of_two_barriers_at_one_place_the_larger_counts(live):
    begin(live)
    place = {"x_m": 3.0, "y_m": 1.5}
    one(live, "route_blocked", 0.5, **place, radius_m=0.1)
    free = live.team.home_map.free.sum()
    answer, _ = one(live, "route_blocked", 0.6, **place, radius_m=0.5)
    assert answer.reason == "" and live.team.home_map.free.sum() < free
    answer, _ = one(live, "route_blocked", 0.7, **place, radius_m=0.3)
    assert answer.reason == "known already" and len(live.barriers) == 1
    (blocked,) = welcome(live).blocked
    assert (blocked.x_m, blocked.y_m, blocked.radius_m) == (3.0, 1.5, 0.5)


def test_a_doorway_of_many_stretches_is_one_door(two_room_home, two_room_map):
    (door,) = two_room_home.doors
    ends = np.linspace(door.start, door.end, 11)
    steps = tuple(replace(door, id=f"s{n}", start=tuple(ends[n]), end=tuple(ends[n + 1])) for n in range(10))
    away = replace(door, id="away", start=(4.0, 0.5), end=(4.0, 1.0))
    home = replace(two_room_home, doors=(*steps, away))
    live = two_robots(home, two_room_map)
    assert welcome(live).doors == ("room|2|room|3", "away")
    begin(live)
    for name in ("room|2|room|3", "s7"):
        one(live, "route_blocked", 0.5, door=name)
        assert np.isinf(live.team.problem().kinds[0].travel_s[2, :2]).all(), "all of it is shut"
        answer, _ = one(live, "route_cleared", 1.0, door="room|2|room|3")
        assert answer.status == "accepted" and not live.barriers


def test_two_robots_never_interact_for_one_letter(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F Egg")
    orders = begin(live)
    places = {name: order.container for name, order in orders.items()}
    found = [event("search_ended", 3.0, robot=name, container=place, objects=["Egg"]) for name, place in places.items()]
    told = [(order.robot, order.action) for order in orders_of(live.handle(found))]
    assert sorted(action for _, action in told) == ["interact", "wait"]
    first = dict(map(reversed, told))["interact"]
    _, orders = one(live, "interaction_ended", 4.0, robot=first, container=places[first], object="Egg", status="FAILED")
    assert {name: order.action for name, order in orders.items()}["r2" if first == "r1" else "r1"] == "interact"


def test_an_order_whose_letter_is_done_is_withdrawn(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F (Egg & X F Pillow)")
    orders = begin(live)
    place = orders["r1"].container
    one(live, "search_ended", 3.0, robot="r1", container=place, objects=["Egg"])
    assert live.team.robots[0].act.kind == "interact"
    live.team.state = live.team.automaton.run(["Egg"])
    _, orders = one(live, "clock", 3.5)
    assert orders["r1"].action != "interact"


def test_nobody_is_stuck_before_the_instant_is_known(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F Egg")
    orders = begin(live)
    seen = [event("search_ended", 3.0, robot=name, container=one.container) for name, one in orders.items()]
    assert live.handle(seen, more=True)[-1].status == "running"
    assert task_state(live).status == "running", "nor for one who says hello now"
    assert orders_of(live.handle([]))


def test_kernels_are_compiled_before_anything_is_decided(live):
    calls = []
    planner = live.planner
    live.planner = SimpleNamespace(
        warm_up=lambda problem: calls.append("warm_up"),
        plan=lambda *given: calls.append("plan") or planner.plan(*given),
    )
    begin(live)
    assert calls == ["warm_up", "plan"]


def test_a_place_that_is_blocked_makes_the_way_longer(live, two_room_map):
    begin(live)
    door_x, door_y = 4.0, 3.0
    before = live.team.problem().kinds[0].travel_s
    answer, _ = one(live, "route_blocked", 0.5, x_m=3.0, y_m=1.5, radius_m=0.5)
    after = live.team.problem().kinds[0].travel_s
    assert answer.status == "accepted"
    assert (after >= before - 1e-9).all() and np.isfinite(after).all()
    grid = live.team.home_map
    assert not grid.free[grid.cell_of((3.0, 1.5))] and grid.free[grid.cell_of((door_x, door_y))]


def test_late_repeated_and_reordered_events(live):
    begin(live)
    place = target_of(live, "r1")
    searched = event("search_ended", 3.0, robot="r1", container=place, objects=["Egg"])
    assert answers_of(live.handle([searched]))[0].status == "accepted", "a search implies the arrival"
    late, _ = one(live, "arrived", 1.0, robot="r1", container=place)
    assert (late.status, late.reason) == ("accepted", "known already")
    assert answers_of(live.handle([searched]))[0].status == "duplicate"
    older, _ = one(live, "search_ended", 1.5, robot="r2", container=place, objects=[])
    assert older.status == "rejected" and "seen later" in older.reason
    assert live.team.belief.presence_prob[live.containers[place], 0] == 1.0
    newer, _ = one(live, "object_seen", 4.0, container=place, object="Egg", present=False)
    assert newer.status == "accepted"
    assert live.team.belief.presence_prob[live.containers[place], 0] == 0.0
    other, _ = one(live, "arrived", 4.0, robot="r1", container="nowhere")
    assert other.status == "rejected" and place in other.reason


UNIX_S = 1.76e9


@pytest.mark.parametrize("now_s", [2 * 86_400.0, UNIX_S], ids=["uptime of two days", "Unix"])
def test_senders_may_count_on_any_clock(two_room_home, two_room_map, now_s):
    live = two_robots(two_room_home, two_room_map)
    begin(live)
    place = target_of(live, "r1")
    for time_s, kind, fields in ((1.0, "arrived", {}), (3.0, "search_ended", {"objects": ["Egg"]})):
        answer, _ = one(live, kind, now_s + time_s, robot="r1", container=place, **fields)
        assert (answer.status, answer.reason) == ("accepted", "")
    assert live.team.time_s == 2.0, "the team's time begins with the first event"
    assert task_state(live).time_s == now_s + 3.0, "what it says is on the senders' clock"
    older, _ = one(live, "object_seen", now_s + 2.0, container=place, object="Egg", present=False)
    assert older.status == "rejected" and f"at {now_s + 3:.0f} s" in older.reason
    again = restore(live.setup, save(live))
    assert one(again, "pose", now_s + 4.0, robot="r2", x_m=1.0, y_m=1.5)[0].reason == ""
    assert again.team.time_s == 3.0


@pytest.mark.parametrize("wrong_s", [70_000.0, -UNIX_S + 5.0])
def test_a_wrong_stamp_shuts_nobody_out(live, wrong_s):
    begin(live)
    wheres = [{"robot": name, "x_m": 1.0, "y_m": 1.5} for name in ("r1", "r2")]
    assert one(live, "pose", UNIX_S, **wheres[1])[0].reason == ""
    for time_s in (UNIX_S + 1.0, UNIX_S + wrong_s, UNIX_S + wrong_s, UNIX_S + 2.0):
        answer, _ = one(live, "pose", time_s, **wheres[0])
        assert answer.status == "accepted" and ("is its clock right?" in answer.reason) == (time_s == UNIX_S + wrong_s)
    assert live.team.time_s == 2.0


def test_when_others_confirm_it_a_long_silence_was_one(live):
    begin(live)
    one(live, "pose", 1.0, robot="r1", x_m=1.0, y_m=1.5)
    first, _ = one(live, "pose", 7200.0, robot="r1", x_m=1.0, y_m=1.5)
    assert "7199 s ahead" in first.reason and live.team.time_s == 1.0
    second, _ = one(live, "pose", 7201.0, robot="r2", x_m=1.0, y_m=1.5)
    assert second.reason == "" and live.team.time_s == 7201.0
    one(live, "robot_lost", 7202.0, robot="r2")
    one(live, "pose", 90_000.0, robot="r1", x_m=1.0, y_m=1.5)
    one(live, "pose", 90_001.0, robot="r1", x_m=1.0, y_m=1.5)
    assert live.team.time_s == 90_001.0, "a robot that is alone confirms itself"


def test_ids_belong_to_their_sender(live):
    begin(live)
    bed, fridge = list(live.containers)[-1], next(iter(live.containers))
    finds = [event("object_seen", 1.0, container=place, object="Egg") for place in (bed, fridge)]
    first, second = [one.model_copy(update={"id": "1"}) for one in finds]
    said = lambda message, client="": answers_of(live.handle([message], client=client))[0].status  # noqa: E731
    assert [said(first), said(second)] == ["accepted", "accepted"], "two clients that count from 1"
    assert [said(first), said(second)] == ["duplicate", "duplicate"]
    assert [said(first, "a"), said(second, "b")] == ["accepted", "accepted"]
    assert [said(second, "a"), said(first, "b")] == ["duplicate", "duplicate"], "a client's name settles it"
    again = restore(live.setup, save(live))
    assert answers_of(again.handle([first, second]))[1].status == "duplicate"
    raw = json.loads(save(live))
    older = restore(live.setup, json.dumps({**raw, "ids": ["1"]}))
    assert answers_of(older.handle([first]))[0].status == "duplicate", "older states know ids alone"


def test_what_was_seen_is_kept_whoever_saw_it(live):
    orders = begin(live)
    unasked = next(name for name in live.containers if name not in {order.container for order in orders.values()})
    answer, _ = one(live, "search_ended", 1.0, robot="r1", container=unasked, objects=["pillow"])
    assert answer.status == "accepted" and "kept" in answer.reason
    assert live.team.belief.searched[live.containers[unasked]]
    assert live.team.belief.presence_prob[live.containers[unasked]].tolist() == [0.0, 1.0]


def test_poses_move_the_robot_and_its_time_of_arrival(live):
    begin(live)
    robot = live.team.robots[0]
    before_s = robot.act.until_s
    cell = robot.route.cells[len(robot.route.cells) // 2]
    x_m, y_m = live.team.home_map.cell_center(cell)
    answer, orders = one(live, "pose", 10.0, robot="r1", x_m=x_m, y_m=y_m)
    assert answer.status == "accepted" and not orders, "the order stays"
    left_m = live.team.home_map.distances_m(cell)[robot.assignment.container]
    assert robot.act.until_s == pytest.approx(10.0 + left_m, abs=1e-4) and robot.act.until_s != before_s
    off, _ = one(live, "pose", 11.0, robot="r1", x_m=-50.0, y_m=0.0)
    assert off.status == "rejected" and "nearest such place" in off.reason


def test_a_state_saved_at_any_moment_goes_on_the_same(two_room_home, two_room_map):
    world = lambda: World(  # noqa: E731
        {container.id: container.objects for container in two_room_home.containers}, 1.0, 2.0, 2.0
    )
    straight = play(two_robots(two_room_home, two_room_map, "pouct"), world())
    broken, robots = two_robots(two_room_home, two_room_map, "pouct"), world()
    robots.obey(broken.begin())
    while not broken.team.accepted:
        broken = restore(broken.setup, save(broken))
        assert robots.settle(broken)
    assert broken.team.trace() == straight.team.trace()
    assert save(restore(broken.setup, save(broken))) == save(broken)


def test_states_of_version_1_and_of_later_programs_are_read(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map)
    begin(live)
    for name, found in (("r1", ["Egg"]), ("r2", [])):
        one(live, "search_ended", 3.0, robot=name, container=target_of(live, name), objects=found)
    raw = json.loads(save(live))
    later = {**raw, "weather": "fine", "robots": [{**robot, "battery": 1} for robot in raw["robots"]]}
    first = {**raw, "version": 1}
    for field in ("posterior", "detected", "searches"):
        del first[field]
    for text in (json.dumps(later), json.dumps(first)):
        assert save(restore(live.setup, text)) == save(live)


def test_states_of_another_task_or_version_are_refused(live, two_room_home, two_room_map):
    text = save(live)
    other = two_robots(two_room_home, two_room_map, formula="F Egg | F Pillow")
    with pytest.raises(StateError, match="another home, map or task"):
        restore(other.setup, text)
    with pytest.raises(StateError, match="of version 99, this program reads 1 and 2"):
        restore(live.setup, text.replace('"version":2', '"version":99', 1))
    with pytest.raises(StateError, match="damaged"):
        restore(live.setup, text[: len(text) // 2])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"robots": []}, "robots"),
        ({"searched": [True]}, "searched or searches is not of"),
        ({"presence_prob": [[0.5]]}, "presence_prob is not of"),
        ({"posterior": [[2.0, 0.5]]}, "less than or equal to 1"),
        ({"seen_s": 3}, "seen_s"),
        ({"time_s": float("nan")}, "finite number"),
        ({"robot": {"setbacks": [[99, -1, 1, 0.0]]}}, "setbacks is 99, and there are"),
        ({"busy": [7]}, "busy, ended or letters"),
        ({"state": 99}, "state is 99"),
        ({"robot": {"container": 99}}, "container is 99, and there are"),
        ({"robot": {"place": -2}}, "place is -2"),
        ({"robot": {"obj": 5}}, "obj is 5"),
        ({"robot": {"mode": "fly"}}, "mode"),
        ({"robot": {"container": -1}}, "under way to nowhere"),
        ({"robot": {"position": {"back": [0, 0], "ahead": [0, 0]}}}, "off the free floor"),
        ({"robot": {"position": {"back": [9999, 0], "ahead": [0, 0]}}}, "off the free floor"),
        ({"robot": {"name": "r2"}}, "two robots"),
    ],
)
def test_states_that_cannot_be_are_refused_in_one_line(live, change, said):
    begin(live)
    raw = json.loads(save(live))
    raw["robots"][0] |= change.pop("robot", {})
    with pytest.raises(StateError, match=said) as refusal:
        restore(live.setup, json.dumps(raw | change))
    assert "\n" not in str(refusal.value) and "damaged" in str(refusal.value)


@pytest.mark.parametrize("text", ["", "[]", "3", "null", "{}\n{}\n", "[" * 10_000, '{"version": 2}', "{}\n[]\n"])
def test_what_is_no_state_is_refused(live, text):
    with pytest.raises(StateError):
        restore(live.setup, text)


def test_a_state_file_that_cannot_be_read_is_named(live, tmp_path):
    path = tmp_path / "state.json"
    path.write_bytes(b"\xff\xfe")
    for where in (path, tmp_path):
        with pytest.raises(StateError, match=f"{where.name}.*cannot be read"):
            read_state(live.setup, where)
    path.write_text("{}")
    with pytest.raises(StateError, match=r"state\.json: the state is of version None"):
        read_state(live.setup, path)


def test_planners_that_know_the_contents_are_refused(two_room_home, two_room_map):
    with pytest.raises(InputError, match="knows all contents"):
        two_robots(two_room_home, two_room_map, "known")


def test_a_robot_without_the_ability_is_never_ordered_to_interact(two_room_home, two_room_map):
    alike = two_robots(two_room_home, two_room_map)
    setup = replace(alike.setup, specs={"r1": replace(alike.setup.spec, speed_m_per_s=2.0, handles=(), name="r1")})
    team = LiveTeam(setup, {"r1": (1.5, 1.5), "r2": (2.5, 1.5)})
    world = World({one.id: one.objects for one in two_room_home.containers}, search_time_s=2.0, interact_time_s=2.0)
    ordered = orders_of(team.begin())
    world.obey(ordered)
    while not team.team.accepted and (events := world.step()):
        replies = team.handle(events)
        ordered += orders_of(replies)
        world.obey(replies)
    assert team.team.accepted
    assert {order.robot for order in ordered if order.action == "interact"} == {"r2"}
    assert any(order.robot == "r1" and order.action == "search" for order in ordered)
    with pytest.raises(StateError):
        restore(setup, save(alike))
