"""The live team: it decides as the simulated episode does, and takes in whatever comes in whatever order."""

import json
from itertools import count, pairwise
from math import dist

import numpy as np
import pytest
from pydantic import TypeAdapter

from mrtask.errors import InputError
from mrtask.execution.perception import Perception, Rates
from mrtask.execution.team_spec import RobotSpec
from mrtask.live.live_team import LiveTeam
from mrtask.live.messages import Event
from mrtask.live.orders import task_state
from mrtask.live.state import LiveSetup
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


def two_robots(home, home_map, planner="greedy", formula="F Egg & F Pillow", likely=(), perception=None):
    """Both in the kitchen; the egg is in the fridge, the pillow on the bed."""
    task = ReadTask(formula, ("Egg", "Pillow"))
    likelihood = np.array([[0.5 if container.id in likely else 0.2] * 2 for container in home.containers])
    spec = RobotSpec(1.0, 2.0, 2.0, perception or Perception())
    setup = LiveSetup(home, home_map, formula, task, likelihood, spec, planner)
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


def test_a_failed_search_is_tried_again_but_not_for_ever(live):
    begin(live)
    for attempt in range(40):
        acting = [i for i, robot in enumerate(live.team.robots) if not robot.free]
        if not acting:
            break
        robot = live.names[acting[0]]
        one(live, "search_ended", float(attempt), robot=robot, container=target_of(live, robot), status="FAILED")
    state = task_state(live)
    assert state.status == "stuck"
    assert "Egg" in state.reason and "Pillow" in state.reason
    answer, orders = one(live, "object_seen", 50.0, container=next(iter(live.containers)), object="Egg")
    assert answer.status == "accepted" and orders, "news gets the team going again"


def test_what_failed_is_ordered_again_although_the_order_is_the_same(two_room_home, two_room_map):
    live = two_robots(two_room_home, two_room_map, formula="F Egg")
    first = begin(live)["r1"]
    _, orders = one(live, "navigation_failed", 1.0, robot="r1", container=first.container)
    assert (orders["r1"].action, orders["r1"].container) == ("navigate", first.container)
    one(live, "arrived", 2.0, robot="r1", container=first.container)
    _, orders = one(live, "search_ended", 3.0, robot="r1", container=first.container, status="FAILED")
    assert (orders["r1"].action, orders["r1"].container) == ("search", first.container)
    _, orders = one(live, "search_ended", 4.0, robot="r1", container=first.container, objects=["Egg"])
    assert (orders["r1"].action, orders["r1"].object) == ("interact", "Egg")
    failed = {"robot": "r1", "container": first.container, "object": "Egg", "status": "FAILED"}
    _, orders = one(live, "interaction_ended", 5.0, **failed)
    assert (orders["r1"].action, orders["r1"].object) == ("interact", "Egg")


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
    before = live.team.problem().travel_s.copy()
    bed = live.containers[next(name for name in live.containers if "3|0" in name)]
    answer, _ = one(live, "route_blocked", 0.5, door="door|2|3")
    assert answer.status == "accepted"
    assert np.isinf(live.team.problem().travel_s[bed, :bed]).all()
    assert all(robot.assignment.container != bed for robot in live.team.robots)
    one(live, "route_cleared", 1.0, door="door|2|3")
    assert np.array_equal(live.team.problem().travel_s, before)


def test_a_place_that_is_blocked_makes_the_way_longer(live, two_room_map):
    begin(live)
    door_x, door_y = 4.0, 3.0
    before = live.team.problem().travel_s
    answer, _ = one(live, "route_blocked", 0.5, x_m=3.0, y_m=1.5, radius_m=0.5)
    after = live.team.problem().travel_s
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
    early, _ = one(live, "pose", 1e8, robot="r1", x_m=1.0, y_m=1.5)
    assert early.status == "rejected" and "clock" in early.reason


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


def test_planners_that_know_the_contents_are_refused(two_room_home, two_room_map):
    with pytest.raises(InputError, match="knows all contents"):
        two_robots(two_room_home, two_room_map, "known")
