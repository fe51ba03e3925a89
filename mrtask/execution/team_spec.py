"""The robots of a team: their number, speed, times and perception."""

from dataclasses import dataclass, field

from mrtask.execution.acts import ActKind
from mrtask.execution.perception import Perception


@dataclass(frozen=True)
class RobotSpec:
    """How fast a robot drives, searches and interacts, and how well it sees."""

    speed_m_per_s: float = 1.0
    search_time_s: float = 0.0
    interact_time_s: float = 0.0
    perception: Perception = field(default_factory=Perception)

    def __post_init__(self) -> None:
        if self.speed_m_per_s <= 0:
            raise ValueError(f"speed_m_per_s must be > 0, not {self.speed_m_per_s}")
        for name in ("search_time_s", "interact_time_s"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must be >= 0, not {getattr(self, name)}")

    def duration_s(self, kind: ActKind) -> float:
        """Return how long an act of this kind takes, for kinds whose duration depends on the robot alone."""
        return {ActKind.SEARCH: self.search_time_s, ActKind.INTERACT: self.interact_time_s}[kind]


@dataclass(frozen=True)
class Team:
    """A number of identical robots."""

    robots: int
    spec: RobotSpec = field(default_factory=RobotSpec)

    def __post_init__(self) -> None:
        if self.robots < 1:
            raise ValueError(f"a team needs at least one robot, not {self.robots}")
