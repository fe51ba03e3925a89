"""Turns homes into labelled rows: which object types lie in which container types, home by home.

The rows go to ``<datasets_dir>/rows`` as Parquet with a manifest and a data card. They are made again only when homes,
split or code have changed.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.dataset")

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pipeline.app.stage import Session, Stage
from pipeline.base.specs import HomesSpec
from pipeline.inputs import homes, rows


@dataclass(frozen=True)
class DatasetJob:
    """The homes to label."""

    homes: HomesSpec

    def run(self, session: Session) -> Path:
        """Return the folder of the homes' dataset."""
        return rows.build(homes.make(self.homes, session.pool), self.homes.datasets_dir, session.pool)

    def outline(self, session: Session) -> Iterator[str]:
        """Say of which homes the rows would be."""
        yield homes.outline(self.homes)
        yield "would label which of their containers hold which objects"


STAGE = Stage(lambda config: DatasetJob(config.homes_spec), locks="never")
