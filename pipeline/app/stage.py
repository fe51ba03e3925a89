"""A stage as its module declares it, and the one way to start it: dry or real, with its folder locked."""

from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Literal, Protocol

from pipeline.backends.pool import Pool
from pipeline.base import console
from pipeline.base.config import Config
from pipeline.store.folder import Folder, locked


@dataclass(frozen=True)
class Cell:
    """Which cell of a sweep a stage runs for; outside sweeps all fields are empty."""

    text: str = ""
    """The cell's values of the swept keys: ``planner.pouct.samples=100``. Empty where all cells are compared."""
    title: str = ""
    """The same without the keys' groups, ``samples=100``, where that is as clear: lists cut long names off."""
    parent_run_id: str | None = None
    """The MLflow run of the sweep."""


@dataclass(frozen=True)
class Session:
    """What a job runs with."""

    pool: Pool
    cell: Cell = Cell()


class Job(Protocol):
    """What a stage does, with those parts of the configuration that it needs."""

    def run(self, session: Session) -> object:
        """Do it."""

    def outline(self, session: Session) -> Iterable[str]:
        """Say line by line what `run` would do. This leaves no file behind but in the cache."""


def _nothing(config: Config) -> None:
    pass


@dataclass(frozen=True)
class Stage:
    """What the module of a stage declares as ``STAGE``."""

    job: Callable[[Config], Job]
    """Resolves the configuration, without any work."""
    check: Callable[[Config], None] = _nothing
    """Refuses what can be known to be wrong before any work; of a sweep's cells, before the first one runs."""
    locks: Literal["always", "to draw", "never"] = "always"
    """When the stage holds ``output_dir``, so that no other run writes there: always, with ``draw=true``, never."""
    compare: "Stage | None" = None
    """Compares the cells of a sweep, from the sweep's configuration; for stages that leave episodes."""
    side_by_side: bool = False
    """Whether several cells of a sweep may run at once, in threads."""

    def start(self, config: Config, session: Session) -> None:
        """Check, then run the stage, or with ``dry_run=true`` say what it would do."""
        self.check(config)
        for name in config.idle_variants:
            console.line(f"planner_variants.{name} does not run: evaluation.planners does not list it")
        job = self.job(config)
        if config.dry_run:
            console.headline("dry run", "nothing is written")
            for text in job.outline(session):
                console.line(text)
            return
        holds = self.locks == "always" or (self.locks == "to draw" and config.draw)
        with locked(Folder(config.output_dir), config.cache_dir) if holds else nullcontext():
            job.run(session)
