import numpy as np
import pytest
import shapely
from PIL import Image
from shapely.geometry import Polygon

from mrtask.maps.home_map import build_map
from mrtask.maps.ros_map import MapError, read_map_worlds, read_ros_map

MAP = """image: floor.pgm
resolution: 0.05
origin: [-1.0, -2.0, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""
CONTAINERS = """rooms: {kitchen: Kitchen, hall: LivingRoom}
containers:
  - {name: fridge, type: Fridge, room: kitchen, position: [-0.5, -1.5], size: [0.6, 0.6], objects: [Egg, Apple, Egg]}
  - {name: sofa, type: Sofa, room: hall, position: [4.0, 1.2], size: [1.6, 0.8]}
  - name: shelf
    type: Rack
    room: hall
    position: [2.6, -1.7]
    yaw_deg: 90
"""
WHITE, GRAY, BLACK = 254, 205, 0


def floor_image():
    """6 x 4 m (120 x 80 cells): a wall at x = 1 m with a gap at y 0.5 to 1.5 m, a pillar, unknown space around."""
    cells = np.full((84, 124), GRAY, np.uint8)
    cells[2:82, 2:122] = WHITE
    cells[:, [1, 122]], cells[[1, 82], :] = BLACK, BLACK
    cells[2:82, 40:43] = BLACK
    cells[50:70, 40:43] = WHITE
    cells[30:36, 80:86] = BLACK
    return cells


def write(folder, cells=None, map_text=MAP, containers=CONTAINERS, name="floor.pgm"):
    image = np.flipud(floor_image() if cells is None else cells)  # images start at the top
    Image.fromarray(image).save(folder / name)
    (folder / "map.yaml").write_text(map_text)
    (folder / "containers.yaml").write_text(containers)
    return folder / "map.yaml", folder / "containers.yaml"


@pytest.fixture
def home(tmp_path):
    return read_ros_map(*write(tmp_path))


def test_containers_and_rooms(home):
    assert home.source == "map.yaml"
    assert home.container_kinds() == [("Fridge", "Kitchen"), ("Sofa", "LivingRoom"), ("Rack", "LivingRoom")]
    assert home.containers[0].objects == ("Apple", "Egg")
    assert Polygon(home.containers[0].footprint).bounds == pytest.approx((-0.8, -1.8, -0.2, -1.2))
    kitchen = shapely.union_all([Polygon(room.polygon) for room in home.rooms if room.type == "Kitchen"])
    assert kitchen.covers(shapely.Point(-0.5, -1.5))
    assert not kitchen.covers(shapely.Point(4.0, 1.2))
    for first in home.rooms:
        for second in home.rooms:
            overlap = Polygon(first.polygon).intersection(Polygon(second.polygon)).area
            assert first is second or overlap < 1e-6


def test_floor_area_is_that_of_the_free_cells(home):
    pillar = sum(Polygon(obstacle.footprint).area for obstacle in home.obstacles)
    assert home.area_m2 - pillar == pytest.approx((floor_image() == WHITE).sum() * 0.05**2, abs=1e-6)
    assert pillar == pytest.approx(36 * 0.05**2)


def test_the_map_is_that_of_the_scan_and_rooms_are_no_walls(home):
    radius_m = 0.2
    home_map = build_map(home, 0.05, radius_m)
    assert home_map.reachable.all()
    blocked = floor_image() != WHITE
    rows, cols = np.nonzero(blocked)
    solid = shapely.union_all(shapely.box(cols, rows, cols + 1, rows + 1))
    footprints = [Polygon(container.footprint) for container in home.containers]
    origin = (-1.0, -2.0)
    corners = shapely.transform(solid, lambda points: points * 0.05 + origin)
    solid = shapely.union_all([corners, *footprints])
    rows, cols = np.indices(home_map.free.shape)
    xs, ys = home_map.cell_center((rows, cols))
    inside = (xs > -0.9) & (xs < 5.1) & (ys > -1.9) & (ys < 2.1)
    clear = shapely.distance(solid, shapely.points(xs, ys))
    assert home_map.free[inside & (clear > radius_m + 0.01)].mean() > 0.999
    assert not home_map.free[inside & (clear < radius_m - 0.01)].any()
    cells = home_map.path(tuple(home_map.access[0]), 1)
    crossing = [y for x, y in map(home_map.cell_center, cells) if abs(x - 1.07) < 0.05]
    assert crossing
    assert all(0.5 < y < 1.5 for y in crossing)


def test_negate_png_and_scale(tmp_path, home):
    folder = tmp_path / "png"
    folder.mkdir()
    text = MAP.replace("negate: 0", "negate: 1\nmode: scale").replace(".pgm", ".png")
    assert read_ros_map(*write(folder, 255 - floor_image(), text, name="floor.png")).id == home.id


def test_a_room_around_another_is_cut_so_that_they_do_not_overlap(tmp_path):
    cells = np.full((100, 100), WHITE, np.uint8)
    cells[[0, -1]], cells[:, [0, -1]] = BLACK, BLACK
    around = "".join(
        f"  - {{name: c{n}, type: Chair, room: ring, position: [{x}, {y}]}}\n"
        for n, (x, y) in enumerate(
            [(0.5, 0.5), (2.5, 0.5), (4.5, 0.5), (4.5, 2.5), (4.5, 4.5), (2.5, 4.5), (0.5, 4.5), (0.5, 2.5)]
        )
    )
    text = "containers:\n  - {name: middle, type: Bed, room: core, position: [2.5, 2.5], size: [0.5, 0.5]}\n" + around
    home = read_ros_map(*write(tmp_path, cells, MAP.replace("-1.0, -2.0", "0, 0"), text))
    assert home.area_m2 == pytest.approx(98 * 98 * 0.05**2)
    assert {room.type for room in home.rooms} == {"ring", "core"}
    assert len({room.id for room in home.rooms}) == len(home.rooms) >= 3
    home_map = build_map(home)
    assert home_map.reachable.all()
    straight = np.hypot(*(home_map.access[0] - home_map.access[1])) * 0.05
    assert home_map.travel_m[0, 1] < straight * 1.1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            MAP.replace("resolution: 0.05", "resolution: 0"),
            r"map\.yaml, line 2: resolution: input should be greater than 0",
        ),
        (MAP.replace("resolution: 0.05\n", ""), r"map\.yaml, line 1: resolution: field required"),
        (MAP.replace("0.05", "fine"), r"line 2: resolution: input should be a valid number"),
        (MAP.replace("-1.0, -2.0, 0.0", "-1.0"), r"line 3: origin: list should have at least 2"),
        (
            MAP.replace("-2.0, 0.0", "-2.0, 0.7"),
            r"line 3: origin\[2\]: a turn of 0.7 rad is not supported; turn the image",
        ),
        (MAP.replace("-2.0, 0.0", ".nan, 0.0"), r"line 3: origin\[1\]: input should be a finite number"),
        (MAP.replace("0.196", "0.8"), r"line 6: free_thresh: 0.8 is not below occupied_thresh 0.65"),
        (MAP + "mode: raw\n", r"line 7: mode: 'raw' is not supported; allowed: trinary, scale"),
        (MAP.replace("floor.pgm", "other.pgm"), r"line 1: image: '.*other\.pgm' cannot be read as an image"),
        (MAP.replace("floor.pgm", "containers.yaml"), r"line 1: image: .* cannot be read as an image"),
        (MAP.replace("0.196", "0.001"), r"line 1: image: no cell is free; are negate and free_thresh right"),
        (MAP + "image: twice.pgm\n", r"line 7: image: is given twice"),
        (MAP + "mode: [scale", r"map\.yaml, line \d+: is not YAML"),
        ("", r"map\.yaml: input should be"),
    ],
)
def test_bad_maps(tmp_path, text, message):
    with pytest.raises(MapError, match=message):
        read_ros_map(*write(tmp_path, map_text=text))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "position: [-0.5, -1.5]",
            "position: [-0.5]",
            r"containers\.yaml, line 3: containers\[0\]\.position: list should",
        ),
        (
            "position: [2.6, -1.7]",
            "position: [x, -1.7]",
            r"line 8: containers\[2\]\.position\[0\]: input should be a valid",
        ),
        (
            "position: [4.0, 1.2]",
            "position: [40.0, 1.2]",
            r"line 4: containers\[1\]\.position: \[40.0, 1.2\] is not within 1",
        ),
        ("name: sofa", "name: fridge", r"line 4: containers\[1\]\.name: 'fridge' is used twice"),
        ("    type: Rack\n", "", r"line 5: containers\[2\]\.type: field required"),
        ("    yaw_deg: 90", "    angle: 90", r"line 9: containers\[2\]\.angle: extra inputs are not permitted"),
        (
            "kitchen: Kitchen",
            "kitten: Kitchen",
            r"line 1: rooms\.kitten: no container is in this room; the rooms are kitchen",
        ),
        ("size: [0.6, 0.6]", "size: [0.6, -1]", r"line 3: containers\[0\]\.size\[1\]: input should be greater than 0"),
    ],
)
def test_bad_containers(tmp_path, old, new, message):
    assert old in CONTAINERS
    with pytest.raises(MapError, match=message):
        read_ros_map(*write(tmp_path, containers=CONTAINERS.replace(old, new)))


def test_missing_and_empty_files(tmp_path):
    map_path, containers = write(tmp_path, containers="containers: []\n")
    with pytest.raises(MapError, match=r"line 1: containers: list should have at least 1 item"):
        read_ros_map(map_path, containers)
    with pytest.raises(MapError, match=r"none\.yaml: cannot be read"):
        read_ros_map(map_path, tmp_path / "none.yaml")


UNLISTED = CONTAINERS.replace(", objects: [Egg, Apple, Egg]", "").replace("type: Rack", "type: ShelvingUnit")


def test_listed_contents_are_the_only_world(tmp_path):
    paths = write(tmp_path)
    assert read_map_worlds(*paths, worlds=5, seed=0) == (read_ros_map(*paths),)
    emptied = write(tmp_path, containers=UNLISTED.replace("[0.6, 0.6]", "[0.6, 0.6], objects: []"))
    assert read_map_worlds(*emptied, worlds=5, seed=0) == (read_ros_map(*emptied),)


def test_unlisted_contents_are_drawn_for_each_world(tmp_path):
    paths = write(tmp_path, containers=UNLISTED)
    worlds = read_map_worlds(*paths, worlds=6, seed=1)
    assert len({world.id for world in worlds}) == len(worlds) == 6
    assert {world.layout_id for world in worlds} == {read_ros_map(*paths).layout_id}
    assert read_map_worlds(*paths, worlds=2, seed=1) == worlds[:2]
    assert read_map_worlds(*paths, worlds=6, seed=2) != worlds


def test_contents_of_an_unknown_type_cannot_be_drawn(tmp_path):
    paths = write(tmp_path, containers=CONTAINERS.replace(", objects: [Egg, Apple, Egg]", ""))
    message = r"containers\.yaml, line 6: containers\[2\]\.type: what a Rack holds is not known; choose one of Arm"
    with pytest.raises(MapError, match=message):
        read_map_worlds(*paths, worlds=2, seed=0)
