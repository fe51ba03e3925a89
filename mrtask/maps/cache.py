"""Maps kept on disk, named by the layout of their home and by all that they depend on.

What the containers hold is no part of the layout. Only the free cells' distances are stored. Files appear whole or not
at all, so several processes may share a folder; a damaged file is made anew.
"""

import hashlib
import json
import os
import tempfile
import zipfile
from pathlib import Path

import numpy as np

from mrtask.homes.home import Home
from mrtask.maps.home_map import (
    CORNER_SEGMENTS,
    DEFAULT_RESOLUTION_M,
    DEFAULT_ROBOT_RADIUS_M,
    DOOR_DEPTH_M,
    REACH_M,
    HomeMap,
    build_map,
)

FORMAT_VERSION = 2
"""To be raised when a map's making or its file changes."""


def cached_map(
    home: Home,
    cache_dir: Path | None,
    resolution_m: float = DEFAULT_RESOLUTION_M,
    robot_radius_m: float = DEFAULT_ROBOT_RADIUS_M,
) -> HomeMap:
    """`build_map`, or what it gave for the same home and parameters before; without ``cache_dir`` always built."""
    if cache_dir is None:
        return build_map(home, resolution_m, robot_radius_m)
    key = [FORMAT_VERSION, home.layout_id, resolution_m, robot_radius_m, REACH_M, DOOR_DEPTH_M, CORNER_SEGMENTS]
    path = cache_dir / f"{home.layout_id}-{hashlib.sha256(json.dumps(key).encode()).hexdigest()[:16]}.npz"
    if (stored := _load(path, home.id)) is not None:
        return stored
    home_map = build_map(home, resolution_m, robot_radius_m)
    _store(path, home_map)
    return home_map


def _store(path: Path, home_map: HomeMap) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.stem, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(
                file,
                resolution_m=home_map.resolution_m,
                origin_m=np.array(home_map.origin_m),
                free=home_map.free,
                access=home_map.access,
                distances_m=home_map.fields_m[:, home_map.free],
            )
        os.replace(name, path)
    except BaseException:
        os.unlink(name)
        raise


def _load(path: Path, home_id: str) -> HomeMap | None:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            free, access = stored["free"], stored["access"]
            fields_m = np.full((len(access), *free.shape), np.inf, np.float32)
            fields_m[:, free] = stored["distances_m"]
            x, y = stored["origin_m"].tolist()
            return HomeMap(home_id, float(stored["resolution_m"]), (x, y), free, access, fields_m)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
