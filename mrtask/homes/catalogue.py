"""Facts about household furniture: which types hold small objects, how large they are, and what stands or lies where.

The figures are in ``catalogue.yaml``, which ``python tools/derive_catalogue.py`` derived from homes of
ProcTHOR's own generator.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any, NamedTuple

import yaml

CONTAINER_TYPES = frozenset(
    {
        "ArmChair", "Bed", "Chair", "CoffeeTable", "CounterTop", "Desk", "DiningTable", "Dresser", "Footstool",
        "Fridge", "GarbageCan", "Ottoman", "ShelvingUnit", "SideTable", "Sink", "Sofa", "Stool", "TVStand", "Toilet",
    }
)  # fmt: skip
"""The floor-standing types that hold small objects. Lamps, plants, boxes and the like are obstacles."""


class Size(NamedTuple):
    """A bounding box in metres: ``x`` across, ``y`` up, ``z`` from back to front."""

    x: float
    y: float
    z: float


@dataclass(frozen=True)
class Asset:
    """One asset of the asset database: its object type and its bounding box in metres."""

    type: str
    size_m: Size


AssetDatabase = Mapping[str, Asset]
"""The assets by id."""


@dataclass(frozen=True)
class Catalogue:
    """The facts of ``catalogue.yaml``, one attribute per section."""

    homes: Mapping[str, Any]
    doors: Mapping[str, Any]
    rooms: Mapping[str, Any]
    types: Mapping[str, Any]
    objects: Mapping[str, Any]
    assets: AssetDatabase

    def typical_size_m(self, object_type: str) -> Size | None:
        """Return the median size of a type's assets, or None for a type that is not listed."""
        entry = self.types.get(object_type)
        return Size(*entry["size_m"]) if entry else None


@cache
def load_catalogue() -> Catalogue:
    """Read the catalogue that comes with the package."""
    text = files("mrtask.homes").joinpath("catalogue.yaml").read_text(encoding="utf-8")
    facts = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    assets = {
        name: Asset(kind, Size(*size_m))
        for kind, entry in facts["types"].items()
        for name, size_m in entry["assets"].items()
    }
    sections = {name: facts[name] for name in ("homes", "doors", "rooms", "types", "objects")}
    return Catalogue(**sections, assets=MappingProxyType(assets))


def is_larger(area_m2: float, area_classes_m2: Sequence[float]) -> bool:
    """Return whether a room is in the larger half of its kind, given the borders of the area classes."""
    return area_m2 >= area_classes_m2[len(area_classes_m2) // 2]
