"""Keep maps on disk, named by everything on which they depend: the home's layout, the parameters and the code.

The code is this module and what it imports: the home, the map and its distance fields. The contents of the containers
are not part of the layout. Only the distances and steps of free cells are stored. Files appear whole or not at all, so
several processes may share a folder; a damaged file is rebuilt.
"""

import hashlib
import json
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mrtask.files import replacing
from mrtask.homes.home import Home
from mrtask.maps.distance_fields import AT_GOAL
from mrtask.maps.home_map import DEFAULT_RESOLUTION_M, DEFAULT_ROBOT_RADIUS_M, HomeMap, build_map
from mrtask.sources import hash_module


def cached_map(
    home: Home,
    cache_dir: Path | None,
    resolution_m: float = DEFAULT_RESOLUTION_M,
    robot_radius_m: float = DEFAULT_ROBOT_RADIUS_M,
    ways: str = "shortest",
) -> HomeMap:
    """Return the home's map from the folder, or build it and store it there.

    Without ``cache_dir``, the map is always built.
    """
    if cache_dir is None:
        return build_map(home, resolution_m, robot_radius_m, ways)
    key = [_code(), home.layout_id, resolution_m, robot_radius_m, ways]
    path = cache_dir / f"{home.layout_id}-{hashlib.sha256(json.dumps(key).encode()).hexdigest()[:16]}.npz"
    if (stored := _load(path, home.id)) is not None:
        return stored
    home_map = build_map(home, resolution_m, robot_radius_m, ways)
    _store(path, home_map)
    return home_map


@cache
def _code() -> str:
    return hash_module(__name__)


def _store(path: Path, home_map: HomeMap) -> None:
    arrays: dict[str, Any] = {
        "resolution_m": home_map.resolution_m,
        "origin_m": np.array(home_map.origin_m),
        "free": home_map.free,
        "access": home_map.access,
        "distances_m": home_map.fields_m[:, home_map.free],
    }
    if home_map.steps is not None:
        arrays["steps"] = home_map.steps[:, home_map.free]
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)


def _load(path: Path, home_id: str) -> HomeMap | None:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            free, access = stored["free"], stored["access"]
            fields_m = np.full((len(access), *free.shape), np.inf, np.float32)
            fields_m[:, free] = stored["distances_m"]
            steps = None
            if "steps" in stored:
                steps = np.full(fields_m.shape, AT_GOAL, np.uint8)
                steps[:, free] = stored["steps"]
            x, y = stored["origin_m"].tolist()
            return HomeMap(home_id, float(stored["resolution_m"]), (x, y), free, access, fields_m, steps)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
