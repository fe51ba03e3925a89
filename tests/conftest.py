"""Fixtures shared by all tests: real homes where this checkout has them, and a small home laid out by hand."""

import copy
import functools
import os
from pathlib import Path
from typing import Any

import pytest

from mrtask.homes.catalogue import Asset, AssetDatabase, Size
from mrtask.homes.generator import homes as generated
from mrtask.homes.generator.house import generate_house
from mrtask.homes.home import Home
from mrtask.homes.procthor import parse_house
from mrtask.maps.home_map import HomeMap, build_map

_generate_once = functools.cache(generated.generate_home)
SHARED_HOMES = Path(__file__).resolve().parents[2] / "shared" / "homes"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Where several processes share the tests, one of them has the Ray session and the finished experiment.

    The other tests of one file stay together, since they share what its fixtures set up. First come the tests with Ray,
    which take one process as long as the others take another, then those of whole programs, which are the longest.
    """
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return
    with_ray = {_file(item) for item in items if "ray_session" in getattr(item, "fixturenames", ())}
    for item in items:
        file = _file(item)
        item.add_marker(pytest.mark.xdist_group("ray" if file in with_ray else file))
    items.sort(key=lambda item: (_file(item) not in with_ray, _file(item).count("/")))


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]


ASSETS: AssetDatabase = {
    "Fridge_1": Asset("Fridge", Size(0.8, 1.8, 0.6)),
    "Bed_1": Asset("Bed", Size(1.6, 0.6, 2.0)),
    "Table_1": Asset("DiningTable", Size(1.0, 0.8, 0.6)),
    "Lamp_1": Asset("FloorLamp", Size(0.3, 1.6, 0.3)),
    "Painting_1": Asset("Painting", Size(0.8, 0.6, 0.05)),
    "Egg_1": Asset("Egg", Size(0.05, 0.05, 0.05)),
    "Pillow_1": Asset("Pillow", Size(0.5, 0.15, 0.4)),
    "Book_1": Asset("Book", Size(0.2, 0.03, 0.15)),
}


def _vectors(*points: tuple[float, float]) -> list[dict[str, float]]:
    return [{"x": x, "y": 0, "z": z} for x, z in points]


def _thing(name: str, asset: str, x: float, z: float, turn: float = 0, *children: dict[str, Any]) -> dict[str, Any]:
    height = ASSETS[asset].size_m.y
    position = {"x": x, "y": 1.8 if asset == "Painting_1" else height / 2, "z": z}
    return {
        "id": name,
        "assetId": asset,
        "position": position,
        "rotation": {"x": 0, "y": turn, "z": 0},
        "children": list(children),
    }


def make_two_room_house() -> dict[str, Any]:
    """A kitchen (x 0 to 4) and a bedroom (x 4 to 8), 4 m deep, with a 1 m door in their wall at y 2.5 to 3.5.

    The door's wall runs *down* its id's coordinates, as half of ProcTHOR's do: its 0.5 to 1.5 m count from y = 4.
    """
    shared = "4.00|0.00|4.00|4.00"
    egg = {"id": "small|2|0", "assetId": "Egg_1", "children": []}
    page = {"id": "small|3|1", "assetId": "Book_1", "children": []}
    pillow = {"id": "small|3|0", "assetId": "Pillow_1", "children": [page]}
    return {
        "rooms": [
            {"id": "room|2", "roomType": "Kitchen", "floorPolygon": _vectors((0, 0), (0, 4), (4, 4), (4, 0))},
            {"id": "room|3", "roomType": "Bedroom", "floorPolygon": _vectors((4, 0), (4, 4), (8, 4), (8, 0))},
        ],
        "walls": [
            {"id": f"wall|2|{shared}", "roomId": "room|2", "polygon": _vectors((4, 4), (4, 0))},
            {"id": f"wall|3|{shared}", "roomId": "room|3", "polygon": _vectors((4, 0), (4, 4))},
        ],
        "doors": [
            {
                "id": "door|2|3",
                "room0": "room|2",
                "room1": "room|3",
                "wall0": f"wall|2|{shared}",
                "wall1": f"wall|3|{shared}",
                "holePolygon": [{"x": 0.5, "y": 0, "z": 0}, {"x": 1.5, "y": 2.1, "z": 0}],
            }
        ],
        "objects": [
            _thing("2|0", "Fridge_1", 0.4, 0.3, 0, egg, dict(egg, id="small|2|1")),
            _thing("2|1", "Table_1", 2.0, 3.0),
            _thing("3|0", "Bed_1", 7.0, 1.2, 270, pillow),
            _thing("3|1", "Lamp_1", 5.0, 0.2),
            _thing("3|2", "Painting_1", 6.0, 3.9),
        ],
        "metadata": {"schema": "1.0.0"},
    }


@pytest.fixture
def homes_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs of examples and documentation that generate the same homes share them."""
    monkeypatch.setattr(generated, "generate_home", _generate_once)


@pytest.fixture
def shared_homes() -> Path:
    """The folder of real ProcTHOR homes beside the repository; the test is skipped if the folder does not exist."""
    if not SHARED_HOMES.is_dir():
        pytest.skip("needs the real ProcTHOR homes beside the repository")
    return SHARED_HOMES


@pytest.fixture
def two_room_house() -> dict[str, Any]:
    """A hand-made house JSON, see `make_two_room_house`; free to be changed."""
    return copy.deepcopy(make_two_room_house())


@pytest.fixture
def two_room_assets() -> AssetDatabase:
    """The assets of the hand-made house."""
    return ASSETS


@pytest.fixture(scope="session")
def two_room_home() -> Home:
    """The hand-made house as a home: Fridge and DiningTable in the kitchen, Bed in the bedroom."""
    return parse_house(make_two_room_house(), ASSETS, "two-rooms", 0)


@pytest.fixture(scope="session")
def two_room_map(two_room_home: Home) -> HomeMap:
    """The hand-made home's map at the default resolution."""
    return build_map(two_room_home)


@pytest.fixture(scope="session")
def generated_homes() -> list[Home]:
    """Nine generated homes, three of each size class."""
    return [
        parse_house(generate_house(seed, size_class), None, "generated", seed)
        for size_class in ("small", "medium", "large")
        for seed in range(3)
    ]
