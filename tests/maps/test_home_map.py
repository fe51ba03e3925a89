from itertools import permutations

import numpy as np
import pytest
import shapely
from scipy import ndimage
from shapely.geometry import LineString, Polygon, box

from mrtask.homes.home import Container, Door, Home, Obstacle, Room
from mrtask.homes.procthor import read_houses
from mrtask.maps.home_map import REACH_M, build_map, main_region, map_bytes


def rectangle(x0, y0, x1, y1):
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))


def open_space(home, radius_m):
    """Where the robot's centre may be, by geometry alone."""
    floor = shapely.union_all([Polygon(room.polygon) for room in home.rooms])
    walls = shapely.union_all([Polygon(room.polygon).exterior for room in home.rooms])
    doors = [LineString([door.start, door.end]).buffer(0.05, cap_style="flat") for door in home.doors]
    furniture = [Polygon(thing.footprint) for thing in (*home.containers, *home.obstacles)]
    solid = shapely.union_all([walls.difference(shapely.union_all(doors)), *furniture])
    return floor.difference(solid.buffer(radius_m, quad_segs=32))


def test_grid_against_geometry(two_room_home, two_room_map):
    space = open_space(two_room_home, 0.2)
    rows, cols = np.indices(two_room_map.free.shape)
    xs, ys = two_room_map.cell_center((rows, cols))
    sure_free = shapely.contains_xy(space.buffer(-0.01), xs, ys)
    sure_blocked = ~shapely.contains_xy(space.buffer(0.01), xs, ys)
    assert two_room_map.free[sure_free].all()
    assert not two_room_map.free[sure_blocked].any()
    assert sure_free.sum() > 5000
    assert (sure_free | sure_blocked).mean() > 0.97


def test_generated_grids_against_geometry(generated_homes):
    for home in generated_homes[::4]:
        home_map = build_map(home, 0.1)
        space = open_space(home, 0.2)
        rows, cols = np.nonzero(home_map.free)
        assert shapely.contains_xy(space.buffer(0.01), *home_map.cell_center((rows, cols))).all()
        assert home_map.free.sum() * 0.1**2 == pytest.approx(space.area, rel=0.05)


def test_cells_and_points(two_room_map):
    for cell in [(0, 0), (17, 42), (70, 160)]:
        assert two_room_map.cell_of(two_room_map.cell_center(cell)) == cell
    assert two_room_map.cell_center(two_room_map.cell_of((3.11, 1.99))) == pytest.approx((3.11, 1.99), abs=0.025)


def test_access_cells_are_the_nearest_free_ones_in_the_own_room(two_room_home, two_room_map):
    rooms = {room.id: Polygon(room.polygon) for room in two_room_home.rooms}
    rows, cols = np.nonzero(two_room_map.free)
    points = shapely.points(*two_room_map.cell_center((rows, cols)))
    for container, access in zip(two_room_home.containers, two_room_map.access, strict=True):
        footprint = Polygon(container.footprint)
        near = shapely.distance(points[shapely.covers(rooms[container.room_id], points)], footprint).min()
        chosen = shapely.Point(two_room_map.cell_center(tuple(access)))
        assert chosen.distance(footprint) == pytest.approx(near)
        assert rooms[container.room_id].covers(chosen)


def test_access_stays_on_this_side_of_the_wall():
    """The shelf's back is nearer to the hall's floor than its front is to the store's, but it stands in the store."""
    rooms = (Room("a", "Hall", rectangle(0, 0, 3, 3)), Room("b", "Store", rectangle(3, 0, 6, 3)))
    clutter = Obstacle("o", "Box", rectangle(3.4, 0, 3.8, 3))
    shelf = Container("s", "ShelvingUnit", "b", rectangle(3.0, 1, 3.4, 2), ())
    door = Door("d", ("a", "b"), (3.0, 2.0), (3.0, 3.0))
    home_map = build_map(Home("t", rooms, (door,), (shelf,), (clutter,)), 0.05, 0.0)
    assert home_map.cell_center(tuple(home_map.access[0]))[0] > 3.0
    sealed = build_map(Home("t", rooms, (), (shelf,), (clutter,)), 0.05, 0.2)
    assert sealed.cell_center(tuple(sealed.access[0]))[0] < 3.0


def test_a_container_nobody_can_get_near_is_unreachable():
    rooms = (Room("a", "Hall", rectangle(0, 0, 3, 3)), Room("b", "Store", rectangle(6, 0, 8, 2)))
    near = Container("n", "Bed", "a", rectangle(0, 0, 1, 1), ())
    far = Container("f", "Bed", "b", rectangle(7, 1, 8, 2), ())
    home_map = build_map(Home("t", rooms, (), (near, far), ()))
    assert home_map.reachable.tolist() == [True, False]
    assert home_map.access[1].tolist() == [-1, -1]
    assert home_map.travel_m.tolist() == [[0.0, np.inf], [np.inf, 0.0]]
    with pytest.raises(ValueError, match="no way from cell"):
        home_map.path(tuple(home_map.access[0]), 1)
    assert REACH_M == 1.0


def test_doors_between_rooms_are_the_only_way_and_outside_doors_stay_shut(two_room_home, two_room_map):
    shut = Home("t", two_room_home.rooms, (), two_room_home.containers, two_room_home.obstacles)
    assert np.isinf(build_map(shut).travel_m[0, 2]) or not build_map(shut).reachable.all()
    cells = two_room_map.path(tuple(two_room_map.access[0]), 2)
    crossing = [y for x, y in map(two_room_map.cell_center, cells) if abs(x - 4.0) < 0.03]
    assert crossing
    assert all(2.7 <= y <= 3.3 for y in crossing)
    rows, cols = np.nonzero(two_room_map.free)
    xs, ys = two_room_map.cell_center((rows, cols))
    assert box(0.19, 0.19, 7.81, 3.81).contains(shapely.MultiPoint(np.stack([xs, ys], axis=1)))


def test_travel_times_are_a_metric_and_no_shorter_than_the_straight_line(generated_homes):
    for home in generated_homes:
        home_map = build_map(home)
        travel_m = home_map.travel_m
        assert home_map.reachable.all()
        assert np.array_equal(travel_m, travel_m.T)
        assert (np.diag(travel_m) == 0).all()
        points = np.array([home_map.cell_center(tuple(cell)) for cell in home_map.access])
        straight_m = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
        assert (travel_m >= straight_m - 1e-4).all()
        through = (travel_m[:, :, None] + travel_m[None]).min(axis=1)
        assert (travel_m <= through + 1e-4).all()


def test_paths_have_the_length_of_the_distances(two_room_map):
    for start, end in permutations(range(3), 2):
        cells = two_room_map.path(tuple(two_room_map.access[start]), end)
        length_m = np.hypot(*np.diff(cells, axis=0).T).sum() * two_room_map.resolution_m
        assert length_m == pytest.approx(two_room_map.travel_m[start, end], abs=1e-4)
        assert two_room_map.distances_m(tuple(cells[0]))[end] == pytest.approx(length_m, abs=1e-4)
        assert two_room_map.free[tuple(cells.T)].all()


def test_main_region_is_the_largest():
    grid = np.array([[1, 0, 0, 1], [1, 0, 1, 0], [0, 0, 0, 1]], bool)
    assert main_region(grid).sum() == 3
    assert not main_region(np.zeros((2, 2), bool)).any()


def test_a_home_without_free_floor_has_no_reachable_container():
    home = Home(
        "t",
        (Room("a", "Hall", rectangle(0, 0, 1, 1)),),
        (),
        (Container("c", "Bed", "a", rectangle(0, 0, 1, 1), ()),),
        (),
    )
    home_map = build_map(home)
    assert not home_map.free.any()
    assert not home_map.reachable.any()


@pytest.mark.parametrize(("resolution_m", "radius_m"), [(0.0, 0.2), (-1.0, 0.2), (float("nan"), 0.2), (0.05, -0.1)])
def test_bad_parameters(two_room_home, resolution_m, radius_m):
    with pytest.raises(ValueError, match="resolution_m > 0 and robot_radius_m >= 0"):
        build_map(two_room_home, resolution_m, radius_m)


def test_grids_are_bounded(two_room_home):
    with pytest.raises(ValueError, match="choose a coarser resolution_m"):
        build_map(two_room_home, 0.001)


def test_real_homes_are_reachable(shared_homes):
    files = [shared_homes / "procthor-4to10room.jsonl.gz"]
    homes = list(read_houses(files, shared_homes / "asset-database.json"))[::3]
    reachable = np.concatenate([build_map(home).reachable for home in homes])
    assert reachable.mean() >= 0.985
    travel_m = [build_map(home, 0.1).travel_m for home in homes[:8]]
    means_m = [t[np.isfinite(t) & (t > 0)].mean() for t in travel_m]
    assert 8 < np.mean(means_m) < 16


def test_soft_ways_are_longer_and_keep_away_from_walls(two_room_home, two_room_map):
    soft = build_map(two_room_home, ways="soft")
    np.testing.assert_array_equal(soft.access, two_room_map.access)
    assert (soft.travel_m >= two_room_map.travel_m - 1e-5).all()
    assert soft.travel_m[0, 2] > two_room_map.travel_m[0, 2]
    clearance = ndimage.distance_transform_edt(soft.free)
    start = tuple(int(part) for part in soft.access[0])
    near, far = (clearance[tuple(home_map.path(start, 2).T)].mean() for home_map in (two_room_map, soft))
    assert far > near


def test_other_ways_are_refused(two_room_home):
    with pytest.raises(ValueError, match="ways must be one of shortest, soft, not 'scenic'"):
        build_map(two_room_home, ways="scenic")


def test_the_memory_of_a_map_is_known_before_it_is_built(two_room_home, two_room_map):
    assert map_bytes(two_room_home, two_room_map.resolution_m) == two_room_map.fields_m.nbytes
