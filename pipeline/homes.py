"""Makes or reads the homes and splits them into training, validation and test homes by content.

Generated homes go to ``<datasets_dir>/generated`` in ProcTHOR's own schema and are read like anybody's. Homes of your
own: homes=procthor homes.files=[a.jsonl.gz,...] homes.assets=asset-database.json. A scanned floor: homes=ros_map
homes.map=lab.yaml homes.containers=containers.yaml. draw=true draws floor plans. homes.contents=housekeep refurnishes
any of them with what people put where.
"""

from collections.abc import Iterator

from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.base.config import Config
from pipeline.inputs import homes
from pipeline.inputs.floor_plans import draw
from pipeline.store.folder import Folder
from pipeline.store.home_set import HomeSet
from pipeline.store.layout import HOMES
from pipeline.store.maps import MapOptions


def run(config: Config, session: Session) -> HomeSet:
    """Return the homes; with ``draw=true`` also draw floor plans of some in ``<output_dir>/homes``."""
    home_set = homes.make(config.homes, config.contents, config.datasets_dir, session.pool)
    if config.draw:
        maps = MapOptions.of(config.map, config.cache_dir)
        draw(home_set.evaluated, config.homes.source, maps, Folder(config.output_dir) / HOMES)
    return home_set


def outline(config: Config, session: Session) -> Iterator[str]:
    """Say which homes would be made or read."""
    yield homes.outline(config.homes, config.contents, config.datasets_dir)


STAGE = Stage(run, outline, locks="to draw")

if __name__ == "__main__":
    main("pipeline.homes")
