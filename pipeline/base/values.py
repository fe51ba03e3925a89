"""The kinds of values that the sections of the configuration share.

Relative paths are relative to the caller's folder.
"""

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

Positive = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(ge=0, le=1)]


def absolute(path: Path) -> Path:
    """Return a local path from the root."""
    return Path(path).expanduser().absolute()


def absolute_unless_url(location: str) -> str:
    """Return a local path from the root, and a URL as it is."""
    return location if "://" in location else str(absolute(Path(location)))


def listed(value: object) -> object:
    """Return one text or number, as typed on the command line, as a list."""
    return [value] if isinstance(value, str | int) else value


def distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the values; raises ValueError where one is given twice."""
    if len(set(values)) != len(values):
        raise ValueError(f"each may be given once, got {', '.join(map(str, values))}")
    return values


def spelled(pattern: str, allowed: str) -> AfterValidator:
    """Return a validator of texts that match a pattern; it refuses others by saying what is ``allowed``."""

    def check(text: str) -> str:
        if re.fullmatch(pattern, text) is None:
            raise ValueError(f"allowed: {allowed}")
        return text

    return AfterValidator(check)


LocalPath = Annotated[Path, AfterValidator(absolute)]
Location = Annotated[str, Field(min_length=1), AfterValidator(absolute_unless_url)]
"""A local path, made absolute, or an fsspec URL."""


class Section(BaseModel):
    """Keys that belong together; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=())
