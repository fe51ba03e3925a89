"""Draw a home as a floor plan: rooms, doors, furniture with its contents, and where the robot can be."""

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import matplotlib.patheffects as patheffects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Polygon as Patch
from matplotlib.path import Path
from shapely import MultiLineString, get_coordinates, get_parts, line_merge, maximum_inscribed_circle, union_all
from shapely.geometry import Polygon as ShapelyPolygon

from mrtask.homes.home import SIZE_CLASSES, Home, Point, Polygon, Room
from mrtask.maps.home_map import HomeMap
from mrtask.maps.ros_map import CellKind, ScannedFloor
from mrtask.names import counted

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
MARGIN_M = 0.3
ROOM_FONT_PT, MAX_FONT_PT, MIN_FONT_PT = 7.0, 6.0, 2.5
"""A label is as large as its furniture allows, between the last two sizes; it is left out where even the smallest does
not fit."""
POINTS_PER_INCH = 72
CHAR_WIDTH, LINE_HEIGHT = 0.65, 1.3
"""Relative to the font's size."""
UNNAMED_TYPES = frozenset({"Chair"})
"""They stand close together around tables, whose names they would hide."""
SCANNED: Mapping[CellKind, tuple[str, str]] = {
    CellKind.NOT_FREE: ("#3b3f45", "not free"),
    CellKind.FLOOR: ("#e4eedd", "floor"),
    CellKind.UNKNOWN_AS_FLOOR: ("#e0b03c", "floor, though the grey is that of unknown space"),
    CellKind.LEFT_OUT: ("#c2575a", "left out: no way leads there"),
}
"""The colour and the meaning of each kind of cell of a scan, by the kinds' numbers."""
TITLE_CHARS = 110
CENTERED: Mapping[str, Any] = {"ha": "center", "va": "center", "zorder": 5, "parse_math": False}
ROOM_NAME_COLOR = "#555b63"
GALLERY_CELL_IN = 4.0


def draw_home(home: Home, home_map: HomeMap | None, ax: Axes, *, objects: bool = True, names: bool = True) -> None:
    """Draw a floor plan into ``ax``, in metres.

    Full containers are dark and empty ones light, with the number of objects if ``objects`` is true; other furniture
    is grey. With a map, floor that the robot cannot reach is shaded and a dot marks where each container is reached.
    """
    draw_rooms(home, ax)
    if home_map is not None:
        _shade_blocked(home, home_map, ax)
    # Chairs last: they stand partly under their tables.
    for container in sorted(home.containers, key=lambda container: -ShapelyPolygon(container.footprint).area):
        color = FULL_COLOR if container.objects else EMPTY_COLOR
        ax.add_patch(Patch(container.footprint, facecolor=color, edgecolor="white", linewidth=0.6, zorder=2))
        named = names and container.type not in UNNAMED_TYPES
        lines = [container.type] * named + [str(len(container.objects))] * (objects and bool(container.objects))
        _label(lines, container.footprint, ax)
    if names:
        for room in home.rooms:
            x, y = clear_spot(home, room)
            text = ax.text(x, y, room.type, fontsize=ROOM_FONT_PT, color=ROOM_NAME_COLOR, **CENTERED)
            text.set_path_effects([patheffects.withStroke(linewidth=2, foreground="#ffffffb0")])
    if home_map is not None:
        spots = np.array(
            [home_map.cell_center((row, col)) for row, col in home_map.access[home_map.reachable].tolist()]
        )
        if len(spots):
            ax.scatter(spots[:, 0], spots[:, 1], s=7, color=ACCESS_COLOR, zorder=6, linewidths=0)


def draw_rooms(home: Home, ax: Axes) -> None:
    """Draw floors, walls, doors and the furniture other than containers, which go on top at zorder 2 to 3."""
    xs, ys = zip(*(point for room in home.rooms for point in room.polygon), strict=True)
    ax.set_xlim(min(xs) - MARGIN_M, max(xs) + MARGIN_M)
    ax.set_ylim(min(ys) - MARGIN_M, max(ys) + MARGIN_M)
    ax.set_aspect("equal")
    ax.set_axis_off()
    for room in home.rooms:
        ax.add_patch(Patch(room.polygon, facecolor=ROOM_COLORS.get(room.type, OTHER_ROOM_COLOR), edgecolor="none"))
    for obstacle in home.obstacles:
        ax.add_patch(Patch(obstacle.footprint, facecolor=OBSTACLE_COLOR, edgecolor="white", linewidth=0.4, zorder=2))
    _draw_walls(home, ax)


def draw_scan(scan: ScannedFloor, ax: Axes) -> None:
    """Draw a scanned floor into ``ax``, in metres: what each cell was read as, and the containers with their names."""
    rows, cols = scan.cells.shape
    (x, y), size_m = scan.origin_m, scan.resolution_m
    ax.imshow(
        scan.cells,
        extent=(x, x + cols * size_m, y, y + rows * size_m),
        origin="lower",
        cmap=ListedColormap([color for color, _ in SCANNED.values()]),
        vmin=-0.5,
        vmax=len(SCANNED) - 0.5,
        interpolation="nearest",
    )
    for container in scan.home.containers:
        ax.add_patch(Patch(container.footprint, facecolor=EMPTY_COLOR, edgecolor=WALL_COLOR, linewidth=0.6, zorder=2))
        _label([container.id], container.footprint, ax)
    present = [kind for kind in SCANNED if (scan.cells == kind).any()]
    handles = [Patch([(0, 0)], facecolor=SCANNED[kind][0], label=SCANNED[kind][1]) for kind in present]
    ax.legend(
        handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0), ncols=2, frameon=False, fontsize=ROOM_FONT_PT
    )
    title = "\n".join(fill(text, TITLE_CHARS) for text in scan.told)
    ax.set_title(title, fontsize=ROOM_FONT_PT, loc="left", parse_math=False)
    ax.set_axis_off()


def draw_gallery(columns: Mapping[str, Sequence[tuple[Home, HomeMap]]]) -> Figure:
    """Homes side by side: a block of columns for each title, a row for each size class."""
    rows = [
        name for name in SIZE_CLASSES if any(home.size_class == name for block in columns.values() for home, _ in block)
    ]
    widths = [max(sum(home.size_class == name for home, _ in block) for name in rows) for block in columns.values()]
    figure = Figure(figsize=(GALLERY_CELL_IN * sum(widths), GALLERY_CELL_IN * len(rows)), layout="constrained")
    blocks = figure.subfigures(1, len(columns), squeeze=False, width_ratios=widths)[0]
    for block, width, (title, homes) in zip(blocks, widths, columns.items(), strict=True):
        block.suptitle(title)
        axes = block.subplots(len(rows), width, squeeze=False)
        for name, line in zip(rows, axes, strict=True):
            members = [pair for pair in homes if pair[0].size_class == name]
            for ax, (home, home_map) in zip(line, members, strict=False):
                draw_home(home, home_map, ax)
                ax.set_title(
                    f"{name}, {home.area_m2:.0f} m2, {counted(len(home.containers), 'container')}",
                    fontsize=ROOM_FONT_PT,
                )
            for ax in line[len(members) :]:
                ax.set_axis_off()
    return figure


def _shade_blocked(home: Home, home_map: HomeMap, ax: Axes) -> None:
    rows, cols = home_map.free.shape
    (x, y), size_m = home_map.origin_m, home_map.resolution_m
    extent = (x, x + cols * size_m, y, y + rows * size_m)
    image = np.ma.masked_where(home_map.free, np.ones(home_map.free.shape))
    shade = ax.imshow(
        image, extent=extent, origin="lower", cmap=ListedColormap([BLOCKED_COLOR]), interpolation="nearest"
    )
    shade.set_zorder(1.5)
    shade.set_clip_path(Path.make_compound_path(*(Patch(room.polygon).get_path() for room in home.rooms)), ax.transData)


def _draw_walls(home: Home, ax: Axes) -> None:
    """All room outlines, with the doors between rooms cut out and those to the outside dashed."""
    for room in home.rooms:
        ax.add_patch(Patch(room.polygon, fill=False, edgecolor=WALL_COLOR, linewidth=WALL_WIDTH_PT, zorder=3))
    for lines, color, style in ((passages(home), OTHER_ROOM_COLOR, "-"), (ways_out(home), "white", (0, (1, 1)))):
        for line in lines:
            ax.plot(
                *zip(*line, strict=True),
                color=color,
                linestyle=style,
                linewidth=WALL_WIDTH_PT + 0.6,
                solid_capstyle="butt",
                solid_joinstyle="miter",
                zorder=4,
            )


def passages(home: Home) -> list[list[Point]]:
    """The openings between rooms as lines; openings that go on round a corner are one line."""
    inner = [(door.start, door.end) for door in home.doors if door.rooms[0] != door.rooms[1]]
    merged = line_merge(MultiLineString(inner))
    return [[(float(x), float(y)) for x, y in line.coords] for line in get_parts(merged)]


def ways_out(home: Home) -> list[list[Point]]:
    """The doors to the outside as lines."""
    return [[door.start, door.end] for door in home.doors if door.rooms[0] == door.rooms[1]]


def clear_spot(home: Home, room: Room) -> tuple[float, float]:
    """The middle of the largest circle on the room's floor that no furniture stands in."""
    floor = ShapelyPolygon(room.polygon)
    footprints = [*(item.footprint for item in home.containers), *(item.footprint for item in home.obstacles)]
    clear = floor.difference(union_all([ShapelyPolygon(footprint) for footprint in footprints]))
    x, y = get_coordinates(maximum_inscribed_circle(floor if clear.is_empty else clear))[0]
    return float(x), float(y)


def _label(lines: list[str], footprint: Polygon, ax: Axes) -> None:
    """Write the lines into a piece of furniture, along its longer side; drop the first ones where not all fit."""
    shape = ShapelyPolygon(footprint)
    x0, y0, x1, y1 = shape.bounds
    turn = 90 if y1 - y0 > 1.3 * (x1 - x0) else 0
    long_pt, short_pt = (side * _points_per_m(ax) for side in ((y1 - y0, x1 - x0) if turn else (x1 - x0, y1 - y0)))
    while lines:
        widest = max(map(len, lines))
        font_pt = min(MAX_FONT_PT, long_pt / (CHAR_WIDTH * widest), short_pt / (LINE_HEIGHT * len(lines)))
        if font_pt >= MIN_FONT_PT:
            middle = shape.centroid
            ax.text(middle.x, middle.y, "\n".join(lines), fontsize=font_pt, rotation=turn, **CENTERED)
            return
        lines = lines[1:]


def _points_per_m(ax: Axes) -> float:
    """The drawing's scale, for an axis of equal aspect."""
    box = ax.get_window_extent()
    (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
    return POINTS_PER_INCH / ax.figure.dpi * min(box.width / (x1 - x0), box.height / (y1 - y0))
