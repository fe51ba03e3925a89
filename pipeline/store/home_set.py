"""Homes that were read without a fault and split into training, validation and test homes."""

from dataclasses import dataclass
from pathlib import Path

from mrtask.homes.home import Home
from mrtask.likelihood.rows import SPLITS
from pipeline.base.sections import EvaluationHomes
from pipeline.store.home_files import HomeFiles, HouseFiles
from pipeline.store.records import HomesManifest


@dataclass(frozen=True)
class HomeSet:
    """Where the homes are, and which home serves which purpose."""

    folder: Path
    """The folder of the manifest."""
    manifest: HomesManifest
    houses: HouseFiles
    """The homes that are split."""
    instead_of_test: HomeFiles | None = None
    """What planners are evaluated on instead of the test homes: the maps of homes=ros_map, or homes=residence."""

    @property
    def evaluated(self) -> HomeFiles:
        """The files with the homes that planners are evaluated on, unless others are given."""
        return self.instead_of_test or self.houses

    def read(self) -> dict[str, tuple[Home, ...]]:
        """Return the homes by split, each split in the order of its ids."""
        homes = {home.id: home for home in self.houses.read()}
        return {name: tuple(homes[home_id] for home_id in ids) for name, ids in self.split.items()}

    @property
    def split(self) -> dict[str, tuple[str, ...]]:
        """The ids of the training, validation and test homes, by these names."""
        return {name: getattr(self.manifest.split, name) for name in SPLITS}

    def evaluation_homes(self, options: EvaluationHomes) -> tuple[HomeFiles, tuple[Home, ...]]:
        """Return the homes to evaluate planners on, in the order of their files, and those files.

        These are the homes in the configured files, else what replaces the test homes, else the test homes. Files that
        come without a database of assets use that of the set's own houses. All have contents of the set's kind.
        """
        if options.files:
            others = HouseFiles(
                files=options.files,
                assets=options.assets or self.houses.assets,
                skip_faulty=options.skip_faulty,
                contents=self.houses.contents,
            )
            return others, others.read()
        if self.instead_of_test is not None:
            return self.instead_of_test, self.instead_of_test.read()
        test = set(self.manifest.split.test)
        return self.houses, tuple(home for home in self.houses.read() if home.id in test)
