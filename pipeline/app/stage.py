"""What the command line needs of a stage, and what it gives to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pipeline.backends.pool import Pool
from pipeline.base.config import Config


@dataclass(frozen=True)
class Cell:
    """Which cell of a sweep a stage runs for; outside sweeps all is empty."""

    text: str = ""
    """What the cell has of the swept values: ``planner.pouct.samples=100``."""
    title: str = ""
    """The same without the keys' groups, ``samples=100``, where that is as clear: lists show names cut off."""
    parent_run_id: str | None = None
    """The MLflow run of the sweep."""


@dataclass(frozen=True)
class Session:
    """What a stage runs with besides its configuration."""

    pool: Pool
    cell: Cell = Cell()


@dataclass(frozen=True)
class Stage:
    """A stage as the command line runs it: what the module of a stage has as ``STAGE``."""

    run: Callable[[Config, Session], object]
    compare_cells: Callable[[Config, str | None], object] | None = None
    """Compares the cells of a sweep, given its own configuration and MLflow run; of a stage that leaves episodes."""
    shorthands: Mapping[str, str] = field(default_factory=dict)
    """Keys that the stage also takes without their group: ``trial_id`` -> ``replay.trial_id``."""
