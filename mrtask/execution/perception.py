"""How well robots see: a search may miss an object that is present, or report one that is not.

`Perception` holds these rates for each type of object; by default searches never err. What they do to a belief is in
`mrtask.execution.sensor`, apart from here, where a configuration is checked without numpy.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Rates:
    """How likely a search is to detect an object that is present (a hit), and one that is absent (a false alarm)."""

    true_positive_prob: float = 1.0
    false_positive_prob: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.false_positive_prob < self.true_positive_prob <= 1.0:
            raise ValueError(
                f"false_positive_prob ({self.false_positive_prob}) must be >= 0 and less than true_positive_prob "
                f"({self.true_positive_prob}), which is at most 1; otherwise a detection says nothing"
            )


@dataclass(frozen=True)
class Perception:
    """The rates of all types of objects, and by name those of the types that differ."""

    rates: Rates = field(default_factory=Rates)
    by_object: Mapping[str, Rates] = field(default_factory=dict, hash=False)

    @property
    def sees_all(self) -> bool:
        """Whether searches never err."""
        return all(one == Rates() for one in (self.rates, *self.by_object.values()))
