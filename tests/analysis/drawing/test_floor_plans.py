from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pytest
import shapely
from matplotlib.colors import to_rgb

from mrtask.analysis.drawing.floor_plans import (
    FULL_COLOR,
    ROOM_COLORS,
    SCANNED,
    draw_gallery,
    draw_home,
    draw_scan,
    passages,
)
from mrtask.homes.home import Door, Home, Room
from mrtask.maps.home_map import build_map
from mrtask.maps.ros_map import CellKind, ScannedFloor


@pytest.fixture
def ax():
    figure, ax = plt.subplots(figsize=(8, 4), dpi=100)
    yield ax
    plt.close(figure)


def pixel(ax, x, y):
    """The colour that was drawn at a place in the home."""
    ax.figure.canvas.draw()
    image = np.asarray(ax.figure.canvas.buffer_rgba())
    col, row = ax.transData.transform((x, y))
    return image[image.shape[0] - 1 - int(row), int(col), :3] / 255


def test_rooms_furniture_and_doors_are_where_they_belong(ax, two_room_home, two_room_map):
    draw_home(two_room_home, None, ax, names=False, objects=False)
    assert pixel(ax, 1.0, 2.0) == pytest.approx(to_rgb(ROOM_COLORS["Kitchen"]), abs=0.02)
    assert pixel(ax, 5.0, 3.0) == pytest.approx(to_rgb(ROOM_COLORS["Bedroom"]), abs=0.02)
    assert pixel(ax, 6.5, 0.7) == pytest.approx(to_rgb(FULL_COLOR), abs=0.02)
    wall, door = pixel(ax, 4.0, 1.0), pixel(ax, 4.0, 3.0)
    assert wall.mean() < 0.5 < door.mean()


def test_no_wall_is_left_where_an_opening_turns_a_corner(ax):
    """Two L-shaped rooms that meet along a step."""
    left = ((0, 0), (2, 0), (2, 2), (3, 2), (3, 4), (0, 4))
    right = ((2, 0), (5, 0), (5, 4), (3, 4), (3, 2), (2, 2))
    step = [((2, 0), (2, 2)), ((2, 2), (3, 2)), ((3, 2), (3, 4))]
    doors = tuple(Door(f"d{number}", ("left", "right"), *ends) for number, ends in enumerate(step))
    home = Home("steps", (Room("left", "Kitchen", left), Room("right", "Bedroom", right)), doors, (), ())
    assert passages(home) == [[(2.0, 0.0), (2.0, 2.0), (3.0, 2.0), (3.0, 4.0)]]
    draw_home(home, None, ax, names=False)
    for x, y in ((2, 1), (2, 2), (2.5, 2), (3, 2), (3, 3)):
        assert min(pixel(ax, x + dx, y + dy).mean() for dx in (-0.02, 0, 0.02) for dy in (-0.02, 0, 0.02)) > 0.5


def test_names_counts_and_access_cells(ax, two_room_home, two_room_map):
    draw_home(two_room_home, two_room_map, ax)
    texts = {text.get_text() for text in ax.texts}
    assert {"Kitchen", "Bedroom", "Bed\n2"} <= texts
    (dots,) = (collection for collection in ax.collections if len(collection.get_offsets()))
    expected = [two_room_map.cell_center(tuple(cell)) for cell in two_room_map.access]
    np.testing.assert_allclose(dots.get_offsets(), expected)


def test_names_may_hold_dollar_signs(ax, two_room_home):
    rooms = tuple(replace(room, type="$\\frac$") for room in two_room_home.rooms)
    containers = tuple(replace(one, type="$_$") for one in two_room_home.containers)
    draw_home(replace(two_room_home, rooms=rooms, containers=containers), None, ax)
    ax.figure.canvas.draw()


def test_a_scan_is_drawn_as_it_was_read(ax, two_room_home):
    cells = np.zeros((45, 90), np.int64)
    cells[5:40, 5:60], cells[5:40, 20:30], cells[5:40, 65:85] = CellKind.FLOOR, CellKind.UNKNOWN_AS_FLOOR, 3
    warnings = ("two_room.yaml: it costs $5 or $6",)
    scan = ScannedFloor(two_room_home, 20.0, warnings, Path("c.yaml"), cells, (0.0, 0.0), 0.1)
    draw_scan(scan, ax)
    for x, kind in ((1.0, CellKind.FLOOR), (2.5, CellKind.UNKNOWN_AS_FLOOR), (8.8, 0), (7.5, CellKind.LEFT_OUT)):
        assert pixel(ax, x, 2.4) == pytest.approx(to_rgb(SCANNED[kind][0]), abs=0.02)
    assert {text.get_text() for text in ax.get_legend().get_texts()} == {text for _, text in SCANNED.values()}
    assert scan.summary in ax.get_title(loc="left") and "warning: two_room.yaml" in ax.get_title(loc="left")


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_pictures_can_be_saved(tmp_path, ax, generated_homes, suffix):
    draw_home(generated_homes[-1], None, ax)
    path = tmp_path / f"home.{suffix}"
    ax.figure.savefig(path)
    assert path.stat().st_size > 5000


def test_names_stay_inside_their_furniture_and_rooms_are_named_on_clear_floor(ax, generated_homes):
    home = generated_homes[-1]
    draw_home(home, None, ax)
    ax.figure.canvas.draw()
    furniture = [shapely.Polygon(item.footprint) for item in (*home.containers, *home.obstacles)]
    room_types = {room.type for room in home.rooms}
    named = 0
    for text in ax.texts:
        box = text.get_window_extent().transformed(ax.transData.inverted())
        middle = shapely.Point((box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2)
        if text.get_text() in room_types:
            assert not shapely.union_all(furniture).covers(middle)
        else:
            own = min(furniture, key=lambda shape: shape.centroid.distance(shapely.Point(text.get_position())))
            x0, y0, x1, y1 = own.bounds
            assert box.x0 > x0 - 0.1 and box.x1 < x1 + 0.1 and box.y0 > y0 - 0.1 and box.y1 < y1 + 0.1
            named += not text.get_text().isdigit()
    assert named > 5


def test_a_gallery_has_a_row_for_each_size_class(generated_homes):
    pairs = [(home, build_map(home, 0.1)) for home in generated_homes if home.size_class != "medium"]
    figure = draw_gallery({"one": pairs, "other": pairs[:2]})
    titles = [ax.get_title().partition(",")[0] for block in figure.subfigs for ax in block.axes]
    assert titles == ["small"] * 3 + ["large"] * 3 + ["small"] * 2 + [""] * 2
