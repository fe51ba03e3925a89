"""How homes are mapped, and where the maps are kept."""

from dataclasses import dataclass
from pathlib import Path

from mrtask.homes.home import Home
from mrtask.maps.cache import cached_map
from mrtask.maps.home_map import HomeMap
from pipeline.base.sections import Map


@dataclass(frozen=True)
class MapOptions:
    """The options of occupancy grids, and the cache that holds maps on each machine."""

    grid: Map
    cache_dir: Path

    def map_of(self, home: Home) -> HomeMap:
        """Return the home's map, from the cache if it is there."""
        return cached_map(home, self.cache_dir / "maps", **self.grid.model_dump())
