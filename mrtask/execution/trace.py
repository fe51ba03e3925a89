"""What every robot did and when: enough to check an episode independently, and to draw it."""

import json
from dataclasses import asdict, dataclass

from mrtask.homes.home import Point


@dataclass(frozen=True)
class Leg:
    """One robot's uninterrupted act of one kind: ``move``, ``search``, ``interact`` or ``wait``.

    ``path`` holds a move's turning points in metres; of any other leg, the one place where the robot stands.
    """

    kind: str
    t0_s: float
    t1_s: float
    container: str | None
    object: str | None
    path: tuple[Point, ...]


@dataclass(frozen=True)
class Letter:
    """A completed interaction: one letter of the run's word."""

    t_s: float
    robot: int
    object: str
    container: str


@dataclass(frozen=True)
class Trace:
    """Each robot's legs in time order, and the word that the team spelled."""

    start: Point
    robots: tuple[tuple[Leg, ...], ...]
    letters: tuple[Letter, ...]

    def to_json(self) -> str:
        """Return the trace as compact JSON, with all digits."""
        return json.dumps(asdict(self), separators=(",", ":"), default=float)

    @staticmethod
    def from_json(text: str) -> "Trace":
        """Read what `to_json` wrote."""
        raw = json.loads(text)
        return Trace(
            start=_point(raw["start"]),
            robots=tuple(
                tuple(Leg(**{**leg, "path": tuple(_point(point) for point in leg["path"])}) for leg in legs)
                for legs in raw["robots"]
            ),
            letters=tuple(Letter(**letter) for letter in raw["letters"]),
        )


def _point(raw: list[float]) -> Point:
    x, y = raw
    return (x, y)
