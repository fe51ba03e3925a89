"""What the rooms below the stages work with: homes, maps, a training, planners and an evaluation, resolved once.

`pipeline.base.config.Config` makes them; no room receives the whole configuration.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mrtask.likelihood.options import LikelihoodChoice
from mrtask.planning.planner import Planner
from mrtask.planning.planners import make_planner
from pipeline.base.sections import (
    Belief,
    Contents,
    Evaluation,
    Frequency,
    Homes,
    Likelihood,
    Map,
    Model,
    Perception,
    Team,
    Tracking,
    Trainer,
)

if TYPE_CHECKING:
    from mrtask.homes.home import Home
    from mrtask.maps.home_map import HomeMap


@dataclass(frozen=True)
class PlannerSpec:
    """A planner, its options, and the likelihoods that it plans with."""

    name: str
    """What its rows call it: its own name, or that of a variant."""
    planner: str
    """A planner of ours, or the import path of your own. Seeds depend on this, not on ``name``."""
    options: Mapping[str, Any] = field(default_factory=dict)
    likelihood: LikelihoodChoice = field(default_factory=LikelihoodChoice)

    def make(self) -> Planner:
        """Return the planner itself; raises `ValueError` where it is unknown or refuses its options."""
        return make_planner(self.planner, self.options)


@dataclass(frozen=True)
class HomesSpec:
    """Which homes with which contents, and the folder of everything that is made of them."""

    homes: Homes
    contents: Contents
    datasets_dir: Path


@dataclass(frozen=True)
class MapOptions:
    """The options of occupancy grids, and the cache that holds maps on each machine."""

    grid: Map
    cache_dir: Path

    def map_of(self, home: "Home", radius_m: float | None = None) -> "HomeMap":
        """Return the home's map, from the cache if it is there; for robots of another radius, theirs."""
        from mrtask.maps.cache import cached_map  # maps take seconds to import, and a mistake should be told at once

        options = self.grid.model_dump() | ({} if radius_m is None else {"robot_radius_m": radius_m})
        return cached_map(home, self.cache_dir / "maps", **options)


@dataclass(frozen=True)
class TrainingSpec:
    """What is trained, how, and where it is kept."""

    model: Model
    trainer: Trainer
    seed: int
    tracking: Tracking
    datasets_dir: Path
    cache_dir: Path

    @property
    def params(self) -> dict[str, Any]:
        """What the run in MLflow says of it."""
        return {
            "model": self.model.model_dump(mode="json"),
            "trainer": self.trainer.model_dump(mode="json"),
            "seed": self.seed,
        }

    @property
    def what(self) -> str:
        """The kind of model, and the embedding that it is trained on."""
        return self.model.kind if isinstance(self.model, Frequency) else f"{self.model.kind} on {self.model.embedding}"


@dataclass(frozen=True)
class EvaluationSpec:
    """Which planners run which trials in which homes with which model, and where the rows go."""

    experiment: str
    seed: int
    homes: HomesSpec
    maps: MapOptions
    options: Evaluation
    planners: tuple[PlannerSpec, ...]
    """Those to compare; they stand in for the names in ``options``."""
    likelihood: Likelihood
    perception: Perception
    team: Team
    belief: Belief
    tracking: Tracking
    output_dir: str
    overwrite: bool
    dry_run: bool
    pdf: bool
    cache_limit_gb: float
    record: Mapping[str, Any]
    """The whole configuration as plain data, for the record."""
