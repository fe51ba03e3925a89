"""Makes or reads the homes and splits them into training, validation and test homes by content.

Generated homes go to ``<datasets_dir>/generated`` in ProcTHOR's own schema and are read like anybody's. Homes of your
own: homes=procthor homes.files=[a.jsonl.gz,...] homes.assets=asset-database.json. A scanned floor: homes=ros_map
homes.map=lab.yaml homes.containers=containers.yaml. draw=true draws floor plans. homes.contents=housekeep refurnishes
any of them with what people put where.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.homes")

from collections.abc import Iterator
from dataclasses import dataclass

from pipeline.app.stage import Session, Stage
from pipeline.base.specs import HomesSpec, MapOptions
from pipeline.inputs import homes
from pipeline.inputs.floor_plans import draw
from pipeline.store.folder import Folder
from pipeline.store.layout import HOMES


@dataclass(frozen=True)
class HomesJob:
    """Which homes, and the folder of their floor plans where they are drawn."""

    homes: HomesSpec
    maps: MapOptions
    drawn_to: Folder | None

    def run(self, session: Session) -> None:
        """Make or read the homes; draw floor plans of some of them."""
        home_set = homes.make(self.homes, session.pool)
        if self.drawn_to is not None:
            draw(home_set.evaluated, self.homes.homes.source, self.maps, self.drawn_to)

    def outline(self, session: Session) -> Iterator[str]:
        """Say which homes would be made or read."""
        yield homes.outline(self.homes)


STAGE = Stage(
    lambda config: HomesJob(
        config.homes_spec,
        config.maps,
        Folder(config.output_dir) / HOMES if config.draw else None,
    ),
    locks="to draw",
)
