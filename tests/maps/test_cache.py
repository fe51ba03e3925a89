from dataclasses import replace

import numpy as np
import pytest

from mrtask.maps import cache
from mrtask.maps.cache import cached_map
from mrtask.maps.home_map import build_map


@pytest.fixture
def builds(monkeypatch):
    """Counts how often a map is made."""
    calls = []

    def counting(*arguments):
        calls.append(arguments)
        return build_map(*arguments)

    monkeypatch.setattr(cache, "build_map", counting)
    return calls


def same(first, second):
    assert first.home_id == second.home_id
    assert (first.resolution_m, first.origin_m) == (second.resolution_m, second.origin_m)
    for name in ("free", "access", "fields_m", "travel_m"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_a_map_is_made_once(tmp_path, two_room_home, two_room_map, builds):
    folder = tmp_path / "new" / "maps"
    same(cached_map(two_room_home, folder), two_room_map)
    same(cached_map(two_room_home, folder), two_room_map)
    assert len(builds) == 1
    assert [path.suffix for path in folder.iterdir()] == [".npz"]


def test_other_parameters_are_other_maps(tmp_path, two_room_home, builds):
    assert cached_map(two_room_home, tmp_path).resolution_m == 0.05
    assert cached_map(two_room_home, tmp_path, 0.1).resolution_m == 0.1
    narrow = cached_map(two_room_home, tmp_path, 0.1, 0.4)
    assert narrow.free.sum() < cached_map(two_room_home, tmp_path, 0.1).free.sum()
    assert len(builds) == 3


def test_soft_ways_are_another_map_and_come_back_whole(tmp_path, two_room_home, two_room_map, builds):
    soft = build_map(two_room_home, ways="soft")
    for _ in range(2):
        stored = cached_map(two_room_home, tmp_path, ways="soft")
        same(stored, soft)
        np.testing.assert_array_equal(stored.steps, soft.steps)
    same(cached_map(two_room_home, tmp_path), two_room_map)
    assert len(builds) == 2


def test_other_code_makes_other_maps(tmp_path, two_room_home, builds, monkeypatch):
    cached_map(two_room_home, tmp_path)
    monkeypatch.setattr(cache, "_code", lambda: "the hash of an edited map builder")
    cached_map(two_room_home, tmp_path)
    cached_map(two_room_home, tmp_path)
    assert len(builds) == 2
    assert len(list(tmp_path.iterdir())) == 2


def test_without_a_folder_nothing_is_kept(two_room_home, builds):
    cached_map(two_room_home, None)
    cached_map(two_room_home, None)
    assert len(builds) == 2


@pytest.mark.parametrize("damage", [b"", b"not a zip", "cut"])
def test_a_damaged_file_is_made_anew(tmp_path, two_room_home, two_room_map, builds, damage):
    cached_map(two_room_home, tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:2000] if damage == "cut" else damage)
    same(cached_map(two_room_home, tmp_path), two_room_map)
    same(cached_map(two_room_home, tmp_path), two_room_map)
    assert len(builds) == 2


def test_a_failed_write_leaves_nothing(tmp_path, two_room_home, monkeypatch):
    def full_disk(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full_disk)
    with pytest.raises(OSError, match="No space"):
        cached_map(two_room_home, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_homes_that_differ_in_their_objects_share_a_map(tmp_path, two_room_home, builds):
    emptied = replace(two_room_home, containers=tuple(replace(c, objects=()) for c in two_room_home.containers))
    moved = replace(two_room_home, containers=two_room_home.containers[::-1])
    maps = [cached_map(home, tmp_path) for home in (two_room_home, emptied, moved)]
    assert [home_map.home_id for home_map in maps] == [two_room_home.id, emptied.id, moved.id]
    np.testing.assert_array_equal(maps[0].fields_m, maps[1].fields_m)
    assert len(builds) == 2
