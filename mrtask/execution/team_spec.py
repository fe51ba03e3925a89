"""The robots of a team: how fast each is, how long its acts take, what it can reach and touch, and how well it sees."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Self

from mrtask.execution.acts import ActKind
from mrtask.execution.perception import Perception
from mrtask.names import name_to_text

if TYPE_CHECKING:
    from mrtask.arrays import Bools
    from mrtask.homes.home import Container

ALIKE = "alike"
"""The name of a team whose robots do not differ."""


@dataclass(frozen=True)
class RobotSpec:
    """How fast a robot drives, searches and interacts, how well it sees, and what it can do at all."""

    speed_m_per_s: float = 1.0
    search_time_s: float = 0.0
    interact_time_s: float = 0.0
    perception: Perception = field(default_factory=Perception)
    radius_m: float | None = None
    """Decides where it fits; None: as wide as the robots for which the home's map was made."""
    handles: tuple[str, ...] | None = None
    """The types of objects with which it can interact; None: all."""
    opens: tuple[str, ...] | None = None
    """The types of containers that it can search and use; None: all."""
    start_m: tuple[float, float] | None = None
    """Where it starts, in the map's metres; None: with the team."""
    name: str = ""

    def __post_init__(self) -> None:
        if not 0 < self.speed_m_per_s < float("inf"):
            raise ValueError(f"speed_m_per_s must be > 0, not {self.speed_m_per_s}")
        for name in ("search_time_s", "interact_time_s"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise ValueError(f"{name} must be >= 0, not {getattr(self, name)}")
        if self.radius_m is not None and not self.radius_m >= 0:
            raise ValueError(f"radius_m must be >= 0, not {self.radius_m}")

    @property
    def kind(self) -> Self:
        """Return the same without name and start, which do not tell one kind of robot from another."""
        return replace(self, name="", start_m=None)

    def duration_s(self, kind: ActKind) -> float:
        """Return how long an act of this kind takes, for kinds whose duration depends on the robot alone."""
        return {ActKind.SEARCH: self.search_time_s, ActKind.INTERACT: self.interact_time_s}[kind]

    def can_use(self, containers: "Sequence[Container]") -> "Bools":
        """Return the containers [C] whose types it opens."""
        return _among([container.type for container in containers], self.opens)

    def can_touch(self, objects: tuple[str, ...]) -> "Bools":
        """Return the objects [O] that it handles."""
        return _among(objects, self.handles)


@dataclass(frozen=True)
class Team:
    """The robots of a team, in their order."""

    members: tuple[RobotSpec, ...]
    name: str = ALIKE

    def __post_init__(self) -> None:
        if not self.members:
            raise ValueError("a team needs at least one robot, not 0")
        names = [member.name for member in self.members if member.name]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"two robots are called {twice[0]!r}; give each its own name")
        if any(member.perception != self.perception for member in self.members):
            raise ValueError("the robots of a team must see equally well; give them one perception")

    @classmethod
    def alike(cls, robots: int, spec: RobotSpec | None = None) -> Self:
        """Return a team of so many robots that do not differ."""
        if robots < 1:
            raise ValueError(f"a team needs at least one robot, not {robots}")
        return cls((spec or RobotSpec(),) * robots)

    @property
    def robots(self) -> int:
        """The team's size."""
        return len(self.members)

    @property
    def perception(self) -> Perception:
        """How well the robots see."""
        return self.members[0].perception

    @property
    def speed_m_per_s(self) -> float | None:
        """The robots' speed, or None if they differ in it."""
        speeds = {member.speed_m_per_s for member in self.members}
        return speeds.pop() if len(speeds) == 1 else None

    @property
    def limited(self) -> bool:
        """Whether some robot does not handle or open everything, or is of another width than the home's map is for."""
        return any(
            one is not None for member in self.members for one in (member.handles, member.opens, member.radius_m)
        )

    def called(self, robot: int) -> str:
        """Return a robot's name, or what it is called that has none."""
        return self.members[robot].name or f"robot {robot + 1}"

    def first(self, robots: int) -> Self:
        """Return the team of the first so many robots.

        Raises:
            ValueError: the team has fewer.
        """
        if not 1 <= robots <= self.robots:
            raise ValueError(f"team {self.name!r} has {self.robots} robots, so it cannot be asked for {robots}")
        return replace(self, members=self.members[:robots])


def _among(names: Sequence[str], allowed: tuple[str, ...] | None) -> "Bools":
    import numpy as np  # the configuration names robots, and a mistake in it is to be told at once

    known = {name_to_text(name) for name in allowed or ()}
    return np.array([allowed is None or name_to_text(name) in known for name in names], dtype=bool)
