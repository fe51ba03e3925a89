"""One robot of a team: where it is, what it does, and what it has done."""

from dataclasses import dataclass, field

from mrtask.execution.motion import Position, Route
from mrtask.execution.trace import Leg
from mrtask.homes.home import Point
from mrtask.planning.problem import WAIT, Assignment

LOST = "lost"


@dataclass
class Robot:
    """One robot; ``obj`` is the object it interacts with."""

    position: Position
    place: int = -1
    """The container the robot stands at."""
    mode: str = "free"
    """``free``, ``move``, ``search``, ``interact``, ``lost`` or, between arrival and the end of the instant,
    ``settling``."""
    assignment: Assignment = field(default=Assignment(WAIT))
    since_s: float = 0.0
    """Since when it does this."""
    moved_s: float = 0.0
    """Since when it drives its route."""
    until_s: float = float("inf")
    """When it is expected to end."""
    route: Route | None = None
    passed: tuple[Point, ...] = ()
    """The way driven in this leg before the present route."""
    obj: int = -1
    legs: list[Leg] = field(default_factory=list)
