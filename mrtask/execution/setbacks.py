"""What one robot failed at, and how long it leaves that alone.

After a failure the robot leaves the container alone for a while, after the next one twice as long. What it failed at is
forgotten with time, or once somebody shows that it can be done.
"""

from dataclasses import dataclass, field

NAVIGATE, SEARCH = -2, -1
"""What failed: the way to the container, or its search. Task objects (0 and more) stand for interactions with them."""
FIRST_S = 5.0
LONGEST_S = 320.0
"""A robot leaves a container alone for this long after its first failure there, and at most."""
FORGOTTEN_S = 900.0
"""Failures count as long as no two are further apart than this."""
OFTEN = 3
"""After this many failures a robot that has nothing else to do counts as stuck."""


@dataclass(frozen=True)
class Setback:
    """How often something failed in a row, and when it last did."""

    count: int
    last_s: float

    @property
    def until_s(self) -> float:
        """The time from which the robot may try again."""
        return self.last_s + min(FIRST_S * 2.0 ** (self.count - 1), LONGEST_S)


@dataclass
class Setbacks:
    """One robot's setbacks, by container and by what failed there."""

    by: dict[tuple[int, int], Setback] = field(default_factory=dict)

    def add(self, container: int, what: int, now_s: float) -> None:
        """Count a failure."""
        before = self.by.get((container, what))
        count = before.count if before is not None and now_s <= before.last_s + FORGOTTEN_S else 0
        self.by[container, what] = Setback(count + 1, now_s)

    def forgive(self, container: int | None = None, what: int | None = None) -> None:
        """Forget what failed at this container (None: at any), and of this kind (None: of any)."""
        self.by = {
            key: setback
            for key, setback in self.by.items()
            if (container is not None and key[0] != container) or (what is not None and key[1] != what)
        }

    def left_alone(self, now_s: float) -> dict[int, Setback]:
        """Return the containers that the robot leaves alone now, each with the setback that keeps it away longest."""
        held: dict[int, Setback] = {}
        for (container, _), setback in self.by.items():
            if setback.until_s > now_s and (container not in held or held[container].until_s < setback.until_s):
                held[container] = setback
        return held

    def objects_left_alone(self, container: int, now_s: float) -> list[int]:
        """Return the task objects with which the robot does not try to interact there now."""
        return [obj for (at, obj), one in self.by.items() if at == container and obj >= 0 and one.until_s > now_s]
