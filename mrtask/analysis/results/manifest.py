"""What a run left about itself, as JSON."""

from collections.abc import Mapping
from typing import Any

Manifest = Mapping[str, Any]


def part(manifest: Manifest, key: str) -> Manifest:
    """Return a nested part of the manifest, or an empty one if it is missing or no mapping."""
    value = manifest.get(key)
    return value if isinstance(value, Mapping) else {}
