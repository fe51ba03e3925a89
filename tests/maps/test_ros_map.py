import numpy as np
import pytest
import shapely
from PIL import Image
from shapely.geometry import Polygon

from mrtask.maps.home_map import build_map
from mrtask.maps.ros_map import CellKind, MapError, MapWarning, read_map_worlds, read_ros_map, scan_floor

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
        ("", r"map\.yaml: should hold keys and values"),
        (MAP.replace("floor.pgm", ""), r"line 1: image: field required"),
        (MAP.replace("[-1.0, -2.0, 0.0]", "[-1.0, ]"), r"line 3: origin: list should have at least 2"),
        (MAP.replace("-1.0, -2.0", "~, -2.0"), r"line 3: origin\[0\]: has no value"),
        (MAP + "date: 2026-13-45\n", r"line 7: date: '2026-13-45' cannot be read \(month must be"),
        (MAP + "made: !ros/map x\n", r"line 7: made: could not determine a constructor for the tag '!ros/map'"),
        (MAP + "note: a\x07b\n", r"line 7: is not YAML \(character 7: special characters"),
        ("3", r"^map\.yaml, line 1: should hold keys and values"),
        (
            MAP.replace("negate: 0", "negate: 0.5"),
            r"line 4: negate: input should be a valid boolean or a valid integer",
        ),
        (MAP.replace("negate: 0", "negate: x"), r"line 4: negate: input should be a valid boolean or a valid integer"),
        (MAP + "note: &a [*a]\n", r"map\.yaml: is nested too deeply, or refers to itself"),
        (MAP + "note: " + "[" * 3000 + "]" * 3000, r"map\.yaml: is nested too deeply, or refers to itself"),
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
        ("    yaw_deg: 90", "    angle: 90", r"line 9: containers\[2\]\.angle: no such key"),
        (
            "kitchen: Kitchen",
            "kitten: Kitchen",
            r"line 1: rooms\.kitten: no container is in this room; the rooms are kitchen",
        ),
        (CONTAINERS, "containers: [3]", r"line 1: containers\[0\]: should hold keys and values$"),
        (
            "objects: [Egg, Apple, Egg]",
            "objects: ['a\"b']",
            r"line 3: containers\[0\]\.objects\[0\]: the name 'a\"b' holds '\"'",
        ),
        ("name: sofa", "name: ' '", r"line 4: containers\[1\]\.name: a name cannot be empty"),
        ("size: [0.6, 0.6]", "size: [0.6, -1]", r"line 3: containers\[0\]\.size\[1\]: input should be greater than 0"),
    ],
)
def test_bad_containers(tmp_path, old, new, message):
    assert old in CONTAINERS
    with pytest.raises(MapError, match=message):
        read_ros_map(*write(tmp_path, containers=CONTAINERS.replace(old, new)))


def test_keys_without_a_value_count_as_left_out(tmp_path, home):
    text = MAP.replace("0.65", "") + "mode:\ndescription:\n"
    listed = CONTAINERS.replace("size: [1.6, 0.8]", "size:, objects:").replace(
        "yaw_deg: 90", "yaw_deg: 90\n    objects:"
    )
    written = read_ros_map(*write(tmp_path, map_text=text, containers=listed))
    assert [container.objects for container in written.containers] == [("Apple", "Egg"), (), ()]
    bare = CONTAINERS.partition("\n")[2]
    assert read_ros_map(*write(tmp_path, map_text=text, containers="rooms:\n" + bare)).rooms


def test_numbers_as_cpp_programs_write_them(tmp_path, home):
    text = MAP.replace("-1.0, -2.0, 0.0", "-1e0, -2, 1e-17").replace("0.05", "5e-2")
    assert read_ros_map(*write(tmp_path, map_text=text)).id == home.id
    with pytest.raises(MapError, match=r"line 2: resolution: should be a number, not the text '0.05'"):
        read_ros_map(*write(tmp_path, map_text=MAP.replace("0.05", "'0.05'")))


def test_a_yaw_that_is_no_number_is_read_as_zero_and_said(tmp_path, home):
    for yaw in ("-nan", "nan", ".nan", "inf"):
        paths = write(tmp_path, map_text=MAP.replace("-2.0, 0.0", f"-2.0, {yaw}"))
        with pytest.warns(MapWarning, match=r"map\.yaml: the yaw of origin is .*; read as 0"):
            assert read_ros_map(*paths).id == home.id


@pytest.mark.parametrize(
    "kind", ["16-bit png", "16-bit pgm", "16-bit tiff", "rgb", "palette", "alpha", "gray and alpha"]
)
def test_every_kind_of_image_gives_the_same_floor(tmp_path, home, kind):
    gray = floor_image()
    image = Image.fromarray(np.flipud(gray))
    wide = np.flipud(gray).astype(np.uint16) * 257
    name = "floor.tiff" if "tiff" in kind else "floor.png"
    map_path, containers = write(tmp_path, map_text=MAP.replace("floor.pgm", name))
    if kind == "16-bit pgm":
        map_path.write_text(MAP)
        header = f"P5 {gray.shape[1]} {gray.shape[0]} 65535\n".encode()
        (tmp_path / "floor.pgm").write_bytes(header + wide.astype(">u2").tobytes())
    elif kind.startswith("16-bit"):
        Image.fromarray(wide).save(tmp_path / name)
    elif kind == "rgb":
        image.convert("RGB").save(tmp_path / name)
    elif kind == "palette":
        image.convert("P").save(tmp_path / name)
    else:  # unknown cells are white, but not opaque
        opaque = Image.fromarray(np.where(np.flipud(gray) == GRAY, 0, 255).astype(np.uint8))
        seen = Image.fromarray(np.where(np.flipud(gray) == GRAY, WHITE, np.flipud(gray)).astype(np.uint8))
        Image.merge("LA", (seen, opaque)).convert("LA" if "gray" in kind else "RGBA").save(tmp_path / name)
    assert read_ros_map(map_path, containers).id == home.id


def test_colours_count_by_their_mean(tmp_path):
    """Green of 180 is light by its weight in luma, and three quarters dark by the mean of the channels."""
    cells = np.stack([np.flipud(floor_image())] * 3, axis=2)
    cells[40:50, 60:70] = (0, 180, 0)
    map_path, containers = write(tmp_path, map_text=MAP.replace("floor.pgm", "floor.png").replace("0.196", "0.6"))
    Image.fromarray(cells).save(tmp_path / "floor.png")
    with pytest.warns(MapWarning, match="grey 205"):
        assert any(wall.type == "Wall" for wall in read_ros_map(map_path, containers).obstacles)


def test_images_that_lose_something_or_are_too_large_are_refused(tmp_path):
    map_path, containers = write(tmp_path, map_text=MAP.replace("floor.pgm", "floor.tiff"))
    Image.fromarray(floor_image().astype(np.float32)).save(tmp_path / "floor.tiff")
    with pytest.raises(MapError, match=r"line 1: image: 'floor.tiff' pixels of mode F are not supported; save it as"):
        read_ros_map(map_path, containers)
    map_path.write_text(MAP)
    (tmp_path / "floor.pgm").write_bytes(b"P5 20000 20000 255\n")
    with pytest.raises(MapError, match=r"line 1: image: 'floor.pgm' has more than 16000000 cells"):
        read_ros_map(map_path, containers)


def test_unknown_cells_that_count_as_floor_are_said(tmp_path):
    paths = write(tmp_path, map_text=MAP.replace("0.196", "0.25"))
    with pytest.warns(MapWarning, match=r"map.yaml: \d+ cells of grey 205, .*; free_thresh: 0.196 leaves them out"):
        read_ros_map(*paths)


def shut_door():
    cells = floor_image()
    cells[:, 40:43] = BLACK
    return cells


def test_floor_behind_a_shut_door_is_left_out_and_said(tmp_path):
    in_the_hall = CONTAINERS.replace("position: [-0.5, -1.5]", "position: [2.0, 1.5]")
    scan = scan_floor(*write(tmp_path, shut_door(), containers=in_the_hall))
    assert scan.area_m2 == pytest.approx(((shut_door() == WHITE)[:, 43:]).sum() * 0.05**2)
    assert scan.summary == f"map.yaml: {scan.area_m2:.1f} m2 of floor (small), 2 rooms, 3 containers"
    kinds = {kind: int((scan.cells == kind).sum()) for kind in CellKind}
    assert kinds[CellKind.FLOOR] * 0.05**2 == pytest.approx(scan.area_m2) and kinds[CellKind.UNKNOWN_AS_FLOOR] == 0
    assert f"{kinds[CellKind.LEFT_OUT] * 0.05**2:.1f} m2 of free floor in 1 region are left out" in scan.told[1]
    assert scan.told == (scan.summary, f"warning: {scan.warnings[0]}")
    [warning] = scan.warnings
    assert "7.6 m2 of free floor in 1 region are left out: no way leads there on the scan" in warning


def test_a_container_behind_a_shut_door_is_not_reached_through_the_wall(tmp_path):
    near_the_wall = CONTAINERS.replace("position: [-0.5, -1.5]", "position: [0.6, -1.5]")
    for listed in (CONTAINERS, near_the_wall):
        with pytest.raises(MapError, match=r"line 3: containers\[0\].position: .* is on floor that is not connected"):
            read_ros_map(*write(tmp_path, shut_door(), containers=listed))


def test_a_room_that_shares_its_only_floor_with_another_is_refused(tmp_path):
    twin = "  - {name: hatch, type: Shelf, room: lounge, position: [4.0, 1.2], size: [1.6, 0.8]}\n"
    with pytest.raises(MapError, match=r"line 10: containers\[3\].room: no floor is left for 'lounge'"):
        read_ros_map(*write(tmp_path, containers=CONTAINERS + twin))


def test_a_scan_full_of_specks_is_refused_at_once(tmp_path):
    cells = np.full((600, 600), WHITE, np.uint8)
    cells[np.random.default_rng(0).random(cells.shape) < 0.15] = BLACK
    with pytest.raises(MapError, match=r"line 1: image: \d+ separate spots of the image are not free, more than 5000"):
        read_ros_map(*write(tmp_path, cells))


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
    message = (
        r"containers\.yaml, line 6: containers\[2\]\.type: the contents of a Rack are not known; choose one of Arm"
    )
    with pytest.raises(MapError, match=message):
        read_map_worlds(*paths, worlds=2, seed=0)
