"""Floor plans show the homes on the configured maps."""

from pathlib import Path

import numpy as np

from mrtask.homes.home import Home
from mrtask.maps.home_map import build_map
from pipeline.base.specs import MapOptions
from pipeline.inputs.floor_plans import _examples
from tests.pipeline.configured import configured


class Two:
    """A source of two homes of one layout."""

    paths = ()

    def __init__(self, home: Home) -> None:
        self.home = home

    def read(self) -> tuple[Home, ...]:
        """Both."""
        return (self.home, self.home)

    def faults(self) -> tuple[str, ...]:
        """None."""
        return ()


def test_a_layout_is_drawn_once_on_the_configured_map(two_room_home: Home, tmp_path: Path) -> None:
    maps = MapOptions(configured("map.ways=soft", "map.resolution_m=0.1").map, tmp_path)
    [(home, home_map)] = _examples(Two(two_room_home), maps)
    assert home == two_room_home
    soft, shortest = (build_map(home, 0.1, 0.2, ways) for ways in ("soft", "shortest"))
    np.testing.assert_array_equal(home_map.fields_m, soft.fields_m)
    assert home_map.steps is not None and shortest.steps is None
