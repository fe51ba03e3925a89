"""pyrobosim as a live team's world: its geometry against our map, robots that meet, and one trial over the pipes."""

from math import hypot

import numpy as np
import pytest

from mrtask.execution.team_spec import RobotSpec
from mrtask.execution.trials import TrialOptions, sample_trial
from mrtask.homes.generator.homes import generate_home
from mrtask.homes.home import Container, Door, Home, Room
from simulators.pyrobosim.robot import Body
from simulators.pyrobosim.ways import Way, speed_to_stop_in
from simulators.pyrobosim.world import write_world

pytest.importorskip("pyrobosim")

from pyrobosim.core import Robot
from pyrobosim.utils.pose import Pose
from pyrobosim.utils.world_collision import check_occupancy

from simulators.pyrobosim import fleet as fleets
from simulators.pyrobosim.trial import load_world, run_trial

BODY = Body()


def box(left, bottom, right, top):
    return ((left, bottom), (right, bottom), (right, top), (left, top))


def table(name, room, x, y, *objects):
    return Container(name, "DiningTable", room, box(x - 0.3, y - 0.3, x + 0.3, y + 0.3), objects)


def two_rooms():
    """Two rooms of 3 x 3 m with a door of 1 m between them."""
    rooms = (Room("left", "Kitchen", box(0, 0, 3, 3)), Room("right", "Bedroom", box(3, 0, 6, 3)))
    door = Door("door", ("left", "right"), (3.0, 1.0), (3.0, 2.0))
    containers = (table("west", "left", 0.5, 1.5, "Mug"), table("east", "right", 5.5, 1.5, "Book", "Pen"))
    return Home("by hand", rooms, (door,), containers, ())


def dead_end():
    """A room of 3 x 3 m and a corridor of 5 x 0.9 m in which no robot can pass another one."""
    rooms = (Room("room", "Kitchen", box(0, 0, 3, 3)), Room("corridor", "Bedroom", box(3, 1, 8, 1.9)))
    door = Door("door", ("room", "corridor"), (3.0, 1.0), (3.0, 1.9))
    containers = (
        table("west", "room", 0.5, 0.5),
        Container("end", "Stool", "corridor", box(7.6, 1.3, 7.9, 1.6), ("Mug",)),
    )
    return Home("by hand", rooms, (door,), containers, ())


def fleet_in(home, folder, starts):
    """The home in pyrobosim with robots at these places."""
    world = write_world(home, folder, BODY)
    assert world.left_out == ()
    simulated = load_world(world)
    robots = [
        Robot(
            name=f"r{number}",
            radius=BODY.radius_m,
            max_linear_velocity=BODY.speed_m_per_s,
            max_angular_velocity=BODY.turn_rad_per_s,
            max_linear_acceleration=BODY.acceleration_m_per_s2,
            max_angular_acceleration=BODY.turn_acceleration_rad_per_s2,
        )
        for number in range(len(starts))
    ]
    for robot, (x, y) in zip(robots, starts, strict=True):
        simulated.add_robot(robot, pose=Pose(x=x, y=y))
    containers = [container.id for container in world.home.containers]
    poses = {name: simulated.get_location_by_name(name).children[0].nav_poses[0] for name in containers}
    return fleets.Fleet(simulated, world.home_map, containers, poses, robots, BODY)


def run_until_there(fleet, names, limit_s):
    """Steps until these robots have arrived; checks at each step that nobody is too fast and no two overlap."""
    missing, before = set(names), {name: member.place for name, member in fleet.members.items()}
    while missing and fleet.time_s < limit_s:
        missing -= set(fleet.step().arrived)
        places = {name: member.place for name, member in fleet.members.items()}
        for name, place in places.items():
            assert hypot(*np.subtract(place, before[name])) <= BODY.speed_m_per_s * fleets.STEP_S + fleets.ARRIVED_M
        listed = list(places.values())
        assert all(
            hypot(*np.subtract(one, other)) >= 2 * BODY.radius_m
            for index, one in enumerate(listed)
            for other in listed[:index]
        )
        before = places
    assert not missing, f"{missing} not there after {limit_s} s"


def test_what_the_live_team_takes_for_free_is_free_in_pyrobosim(tmp_path):
    world = write_world(generate_home(3, "small"), tmp_path, BODY)
    simulated = load_world(world)
    simulated.add_robot(Robot(name="r", radius=BODY.radius_m), pose=Pose(*world.home_map.cell_center(_any_free(world))))
    robot = simulated.robots[0]
    free = np.argwhere(world.home_map.free)
    blocked = [cell for cell in free if check_occupancy(world.home_map.cell_center(tuple(cell)), simulated, robot)]
    assert len(free) > 1000
    assert blocked == []
    held = {container.id: set(container.objects) for container in world.home.containers}
    assert {(one.parent.parent.name, one.category) for one in simulated.objects} == {
        (name, kind) for name, kinds in held.items() for kind in kinds
    }
    assert "objects:" not in world.containers_file.read_text()


def _any_free(world):
    return tuple(np.argwhere(world.home_map.free)[0])


def test_a_lone_robot_takes_as_long_as_speed_and_acceleration_let_it(tmp_path):
    fleet = fleet_in(two_rooms(), tmp_path, [(1.5, 1.5)])
    fleet.drive("r0", "east", [])
    length_m = fleet.members["r0"].way.length_m
    run_until_there(fleet, ["r0"], 60)
    # from rest to rest: the way at top speed, and half of the time that it takes to get there and to stop
    ideal_s = length_m / BODY.speed_m_per_s + BODY.speed_m_per_s / BODY.acceleration_m_per_s2
    assert ideal_s <= fleet.time_s <= 1.25 * ideal_s + 2
    assert fleet.stands_at("r0", "east")
    assert fleet.tally == fleets.Tally()


def test_robots_that_meet_in_a_door_change_sides(tmp_path):
    fleet = fleet_in(two_rooms(), tmp_path, [(2.2, 1.5), (3.8, 1.5)])
    fleet.drive("r0", "east", [])
    fleet.drive("r1", "west", [])
    run_until_there(fleet, ["r0", "r1"], 90)
    assert fleet.tally.gave_way > 0
    assert fleet.tally.contacts == 0


def test_who_has_no_place_to_give_way_comes_out_first(tmp_path):
    fleet = fleet_in(dead_end(), tmp_path, [(2.5, 1.45), (6.0, 1.45)])
    fleet.drive("r1", "end", [])
    run_until_there(fleet, ["r1"], 30)
    fleet.drive("r0", "end", [])
    run_until_there(fleet, ["r0"], 120)
    assert fleet.members["r1"].place[0] < 3
    assert fleet.tally.contacts == 0


def test_a_robot_that_is_shut_out_says_so(tmp_path):
    fleet = fleet_in(dead_end(), tmp_path, [(2.0, 1.45), (5.0, 1.45)])
    fleet.members["r1"].busy = True
    fleet.drive("r0", "end", [])
    gave_up = []
    while fleet.time_s < fleets.GIVE_UP_S + 30 and not gave_up:
        gave_up = fleet.step().gave_up
    assert gave_up == ["r0"]
    assert fleet.tally.contacts == 0


def test_a_way_is_followed_forward_only():
    way = Way([(0.0, 0.0), (0.0, 0.0), (2.0, 0.0), (2.0, 1.0)])
    assert way.length_m == 3.0
    way.advance((0.3, 0.1))
    assert way.progress_m == pytest.approx(0.3)
    way.advance((0.0, 0.0))
    assert way.progress_m == pytest.approx(0.3)
    for x in (0.8, 1.3, 1.8, 2.0):
        way.advance((x, 0.05))
    assert way.ahead()[-1].tolist() == [2.0, 1.0]
    assert np.hypot(*np.diff(way.ahead(0.5), axis=0).T).max() <= 0.05 + 1e-9


def test_a_robot_can_stop_from_the_speed_it_is_allowed():
    for metres in (0.0, 0.01, 0.1, 0.5, 5.0):
        speed = speed_to_stop_in(metres, BODY, fleets.STEP_S)
        assert speed**2 / (2 * BODY.acceleration_m_per_s2) <= metres + 1e-12


def test_a_trial_over_the_pipes(tmp_path):
    world = write_world(generate_home(0, "small"), tmp_path, BODY)
    options = TrialOptions(templates=("and2",), robot=RobotSpec(BODY.speed_m_per_s, 1.0, 0.5))
    trial = sample_trial("small", 2, 0, [world.home], lambda _: world.home_map, seed=1, options=options)
    outcome = run_trial(world, load_world(world), trial, "learned_myopic", ["likelihood=uniform"], BODY)
    assert (outcome.status, outcome.error, outcome.refused) == ("accepted", None, ())
    assert outcome.contacts == 0
    assert outcome.least_gap_m >= 0
    assert outcome.legs
    for leg in outcome.legs:
        assert leg.real_s >= leg.planned_s  # nobody is faster than the top speed that planners count with
    assert outcome.cost_s >= max(leg.real_s for leg in outcome.legs)
