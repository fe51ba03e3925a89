import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from mrtask.maps.draw import FULL_COLOR, ROOM_COLORS, draw_home


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


def test_names_counts_and_access_cells(ax, two_room_home, two_room_map):
    draw_home(two_room_home, two_room_map, ax)
    texts = {text.get_text() for text in ax.texts}
    assert {"Kitchen", "Bedroom", "Bed\n2"} <= texts
    (dots,) = (collection for collection in ax.collections if len(collection.get_offsets()))
    expected = [two_room_map.cell_center(tuple(cell)) for cell in two_room_map.access]
    np.testing.assert_allclose(dots.get_offsets(), expected)


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_pictures_can_be_saved(tmp_path, ax, generated_homes, suffix):
    draw_home(generated_homes[-1], None, ax)
    path = tmp_path / f"home.{suffix}"
    ax.figure.savefig(path)
    assert path.stat().st_size > 5000
