"""Tell what pydantic refuses in the user's terms: the field in the user's own data, and what it should be.

Pydantic's places name its internals, too, such as the members of a union (``negate.bool``), and its messages name our
classes.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError

Place = tuple[str | int, ...]
"""The keys and list indices that lead to a field."""

_NO_MAPPING = ("model_type", "model_attributes_type", "dataclass_type", "dict_type")
_NUMBER = re.compile(r"[-+]?[\d.]+([eE][-+]?\d+)?")
_SHOULD_BE = "input should be "


def first_problem(error: ValidationError, data: object) -> tuple[Place, str]:
    """Return the first field of the data that does not fit, and what is wrong with it."""
    errors = error.errors(include_url=False)
    place = _place(errors[0], data)
    there = dict.fromkeys(problem(item) for item in errors if _place(item, data) == place)
    if len(there) > 1 and all(text.startswith(_SHOULD_BE) for text in there):  # the members of a union
        return place, _SHOULD_BE + " or ".join(text.removeprefix(_SHOULD_BE) for text in there)
    return place, next(iter(there))


def problem(item: Mapping[str, Any]) -> str:
    """Return what is wrong, from one of pydantic's errors."""
    if item["input"] is None:
        return "has no value"
    if item["type"] in _NO_MAPPING:
        return "should hold keys and values"
    if item["type"] == "path_type":
        return "should be the path of a file or folder"
    if item["type"] == "extra_forbidden":
        return "no such key"
    given = item["input"]
    if item["type"] in ("float_type", "int_type") and isinstance(given, str) and _NUMBER.fullmatch(given):
        return f"should be a number, not the text {given!r}; leave its quotes out"
    text = str(item["msg"]).removeprefix("Value error, ").replace(" after validation", "")
    return text[:1].lower() + text[1:]


def dotted(place: Sequence[str | int]) -> str:
    """Return a place as ``objects[3].position.x``."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")


def _place(item: Mapping[str, Any], data: object) -> Place:
    """Return those parts of pydantic's place that lead through the data; a key that is missing there ends it."""
    place: list[str | int] = []
    for part in item["loc"]:
        try:
            data = data[part]  # type: ignore[index]
        except (KeyError, IndexError, TypeError):
            if item["type"] != "missing" or part != item["loc"][-1]:
                continue
        place.append(part)
    return tuple(place)
