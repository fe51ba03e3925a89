"""Homes that were read without a fault and split into training, validation and test homes."""

from dataclasses import dataclass
from pathlib import Path

from mrtask.homes.home import Home
from mrtask.likelihood.rows import SPLITS
from pipeline.base.config import EvaluationHomes
from pipeline.store.home_files import HomeFiles, HouseFiles, MapFiles
from pipeline.store.records import HomesManifest


@dataclass(frozen=True)
class HomeSet:
    """Where the homes are and which is for what."""

    folder: Path
    """The folder of the manifest."""
    manifest: HomesManifest
    houses: HouseFiles
    """What the model learns from; without maps, the planners are evaluated on the test homes among them."""
    maps: MapFiles | None = None
    """With homes=ros_map: what the planners are evaluated on."""

    def read(self) -> dict[str, tuple[Home, ...]]:
        """The homes by split, each split in the order of its ids."""
        homes = {home.id: home for home in self.houses.read()}
        return {name: tuple(homes[home_id] for home_id in ids) for name, ids in self.split.items()}

    @property
    def split(self) -> dict[str, tuple[str, ...]]:
        """The ids of the training, validation and test homes, by these names."""
        return {name: getattr(self.manifest.split, name) for name in SPLITS}

    def evaluation_homes(self, given: EvaluationHomes) -> tuple[HomeFiles, tuple[Home, ...]]:
        """The homes to evaluate planners on, and the files that they are from.

        These are the homes in the files given, else those of the maps, else the test homes. Files that come without a
        database of assets are read with the one of the set's own houses.
        """
        if given.files:
            assets = given.assets or self.houses.assets
            others = HouseFiles(files=given.files, assets=assets, skip_faulty=given.skip_faulty)
            return others, others.read()
        return (self.maps, self.maps.read()) if self.maps else (self.houses, self.read()["test"])
