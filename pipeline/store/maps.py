"""How homes are mapped, and where the maps are kept."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from mrtask.homes.home import Home
from mrtask.maps.cache import cached_map
from mrtask.maps.home_map import HomeMap
from pipeline.base.sections import Map


@dataclass(frozen=True)
class MapOptions:
    """The options of occupancy grids, and the cache that holds maps on each machine."""

    resolution_m: float
    robot_radius_m: float
    cache_dir: Path
    ways: str = "shortest"

    @classmethod
    def of(cls, options: Map, cache_dir: Path) -> Self:
        """Return the configured options with the machine's cache."""
        return cls(**options.model_dump(), cache_dir=cache_dir)

    def map_of(self, home: Home) -> HomeMap:
        """Return the home's map, from the cache if it is there."""
        return cached_map(home, self.cache_dir / "maps", self.resolution_m, self.robot_radius_m, self.ways)
