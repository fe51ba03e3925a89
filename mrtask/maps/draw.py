"""Draws a home as a floor plan: rooms, doors, furniture with what it holds, and where the robot can be."""

from collections.abc import Mapping

import matplotlib.patheffects as patheffects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Polygon as Patch
from matplotlib.path import Path
from shapely.geometry import Polygon as ShapelyPolygon

from mrtask.homes.home import Home
from mrtask.maps.home_map import HomeMap

ROOM_COLORS: Mapping[str, str] = {
    "Bathroom": "#dcebf2",
    "Bedroom": "#ece4f1",
    "Kitchen": "#f8ead6",
    "LivingRoom": "#e4eedd",
}
OTHER_ROOM_COLOR = "#eeeeee"
FULL_COLOR, EMPTY_COLOR, OBSTACLE_COLOR = "#c98a4b", "#eadbc8", "#b9bdc1"
WALL_COLOR, ACCESS_COLOR, BLOCKED_COLOR = "#3b3f45", "#1f6fb2", "#00000018"
WALL_WIDTH_PT = 2.4
WIDE_TYPE_M = 0.9
"""Furniture narrower than this in both directions gets no name."""
MARGIN_M = 0.3


def draw_home(home: Home, home_map: HomeMap | None, ax: Axes, *, objects: bool = True, names: bool = True) -> None:
    """Draw a floor plan into ``ax``, in metres.

    Full containers are dark and empty ones light, with the number of objects where ``objects``; other furniture is
    grey.
    With a map, floor out of the robot's reach is shaded and a dot marks where each container is reached.
    """
    for room in home.rooms:
        ax.add_patch(Patch(room.polygon, facecolor=ROOM_COLORS.get(room.type, OTHER_ROOM_COLOR), edgecolor="none"))
    if home_map is not None:
        _shade_blocked(home_map, ax)
    for obstacle in home.obstacles:
        ax.add_patch(Patch(obstacle.footprint, facecolor=OBSTACLE_COLOR, edgecolor="white", linewidth=0.4, zorder=2))
    # Chairs last: they stand partly under their tables.
    for container in sorted(home.containers, key=lambda container: -ShapelyPolygon(container.footprint).area):
        color = FULL_COLOR if container.objects else EMPTY_COLOR
        ax.add_patch(Patch(container.footprint, facecolor=color, edgecolor="white", linewidth=0.6, zorder=2))
        _label(container.type, container.footprint, len(container.objects) if objects else 0, names, ax)
    _draw_walls(home, ax)
    if names:
        for room in home.rooms:
            spot = ShapelyPolygon(room.polygon).representative_point()
            text = ax.text(spot.x, spot.y, room.type, ha="center", va="center", fontsize=7, color="#555b63", zorder=5)
            text.set_path_effects([patheffects.withStroke(linewidth=2, foreground="#ffffffb0")])
    if home_map is not None:
        spots = np.array(
            [home_map.cell_center((row, col)) for row, col in home_map.access[home_map.reachable].tolist()]
        )
        if len(spots):
            ax.scatter(spots[:, 0], spots[:, 1], s=7, color=ACCESS_COLOR, zorder=6, linewidths=0)
    xs, ys = zip(*(point for room in home.rooms for point in room.polygon), strict=True)
    ax.set_xlim(min(xs) - MARGIN_M, max(xs) + MARGIN_M)
    ax.set_ylim(min(ys) - MARGIN_M, max(ys) + MARGIN_M)
    ax.set_aspect("equal")
    ax.set_axis_off()


def _shade_blocked(home_map: HomeMap, ax: Axes) -> None:
    rows, cols = home_map.free.shape
    (x, y), size_m = home_map.origin_m, home_map.resolution_m
    extent = (x, x + cols * size_m, y, y + rows * size_m)
    image = np.ma.masked_where(home_map.free, np.ones(home_map.free.shape))
    shade = ax.imshow(
        image, extent=extent, origin="lower", cmap=ListedColormap([BLOCKED_COLOR]), interpolation="nearest"
    )
    shade.set_zorder(1.5)
    shade.set_clip_path(Path.make_compound_path(*(patch.get_path() for patch in ax.patches)), ax.transData)


def _draw_walls(home: Home, ax: Axes) -> None:
    """All room outlines, with the doors between rooms cut out and those to the outside dashed."""
    for room in home.rooms:
        ax.add_patch(Patch(room.polygon, fill=False, edgecolor=WALL_COLOR, linewidth=WALL_WIDTH_PT, zorder=3))
    for door in home.doors:
        (x0, y0), (x1, y1) = door.start, door.end
        inner = door.rooms[0] != door.rooms[1]
        color, style = (OTHER_ROOM_COLOR, "-") if inner else ("white", (0, (1, 1)))
        ax.plot(
            [x0, x1],
            [y0, y1],
            color=color,
            linestyle=style,
            linewidth=WALL_WIDTH_PT + 0.6,
            solid_capstyle="butt",
            zorder=4,
        )


def _label(kind: str, footprint: tuple[tuple[float, float], ...], count: int, names: bool, ax: Axes) -> None:
    shape = ShapelyPolygon(footprint)
    x0, y0, x1, y1 = shape.bounds
    text = "\n".join([kind] * (names and max(x1 - x0, y1 - y0) >= WIDE_TYPE_M) + [str(count)] * (count > 0))
    turn = 90 if y1 - y0 > 1.3 * (x1 - x0) else 0
    ax.text(shape.centroid.x, shape.centroid.y, text, ha="center", va="center", fontsize=4.5, rotation=turn, zorder=5)
