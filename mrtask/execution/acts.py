"""The acts that a robot can be doing."""

from dataclasses import dataclass
from enum import StrEnum

WAIT_LEG = "wait"
"""The kind of a trace's legs in which a robot did nothing."""


class ActKind(StrEnum):
    """The kinds of acts; the values are the texts in traces and saved states."""

    MOVE = "move"
    SEARCH = "search"
    INTERACT = "interact"
    FREE = "free"
    """Waits for a decision."""
    SETTLING = "settling"
    """Has arrived or finished in this instant, and may begin another act before it becomes free."""
    LOST = "lost"
    """Takes no part."""

    @property
    def leg(self) -> str:
        """The kind of the act's leg in a trace."""
        return self.value if self in (ActKind.MOVE, ActKind.SEARCH, ActKind.INTERACT) else WAIT_LEG


@dataclass(frozen=True)
class Act:
    """One thing that a robot does."""

    kind: ActKind
    until_s: float = float("inf")
    """The time at which it is expected to end."""
    obj: int = -1
    """The task object of an interaction. A lost robot keeps it, because it may still report the end."""
