"""Turns homes into labelled rows: which object types lie in which container types, home by home.

The rows go to ``<datasets_dir>/rows`` as Parquet with a manifest and a data card. They are made again only when homes,
split or code have changed.
"""

from collections.abc import Iterator
from pathlib import Path

from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.base.config import Config
from pipeline.inputs import homes, rows


def run(config: Config, session: Session) -> Path:
    """Return the folder of the dataset of the configured homes."""
    home_set = homes.make(config.homes, config.contents, config.datasets_dir, session.pool)
    return rows.build(home_set, config.datasets_dir, session.pool)


def outline(config: Config, session: Session) -> Iterator[str]:
    """Say of which homes the rows would be."""
    yield homes.outline(config.homes, config.contents, config.datasets_dir)
    yield "would label which of their containers hold which objects"


STAGE = Stage(run, outline, locks="never")

if __name__ == "__main__":
    main("pipeline.dataset")
