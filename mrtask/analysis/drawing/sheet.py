"""From a home's metres to the whole centimetres of a drawing in a page, where y runs down."""

from collections.abc import Sequence
from dataclasses import dataclass

from shapely.geometry import Polygon as ShapelyPolygon

from mrtask.homes.home import Home, Point, Polygon

CM_PER_M = 100
MARGIN_M = 0.3


@dataclass(frozen=True)
class Sheet:
    """Convert metres with y up into the picture's centimetres with y down."""

    x0_m: float
    y1_m: float
    width: int
    height: int

    @staticmethod
    def of(home: Home) -> "Sheet":
        """The sheet that a home fits on."""
        xs, ys = zip(*(point for room in home.rooms for point in room.polygon), strict=True)
        width, height = max(xs) - min(xs) + 2 * MARGIN_M, max(ys) - min(ys) + 2 * MARGIN_M
        return Sheet(min(xs) - MARGIN_M, max(ys) + MARGIN_M, round(width * CM_PER_M), round(height * CM_PER_M))

    def point(self, point: Point) -> tuple[int, int]:
        """A point in the picture."""
        return round((point[0] - self.x0_m) * CM_PER_M), round((self.y1_m - point[1]) * CM_PER_M)

    def points(self, points: Sequence[Point]) -> str:
        """``x,y x,y``, the format of SVG's polygons."""
        return " ".join(f"{x},{y}" for x, y in map(self.point, points))

    def middle(self, polygon: Polygon) -> tuple[int, int]:
        """A point inside a polygon, near its middle."""
        shape = ShapelyPolygon(polygon)
        inside = shape.centroid if shape.contains(shape.centroid) else shape.representative_point()
        return self.point((inside.x, inside.y))
