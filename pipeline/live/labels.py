"""What a detector calls objects, in the names of the task; what never matched is counted, to be said."""

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

import yaml

from mrtask.names import name_to_text
from pipeline.base.config import UserError

SHOWN = 10


class Labels:
    """The names of a detector's labels.

    Args:
        names: label -> name, or None for a label to ignore; other labels are names themselves.
        objects: the task's objects.
    """

    def __init__(self, names: Mapping[str, str | None], objects: Iterable[str]) -> None:
        self._names = names
        self._objects = {name_to_text(name): name for name in objects}
        self._seen: set[str] = set()
        """The task's objects that were detected."""
        self._strange: Counter[str] = Counter()
        """Label -> how often it was detected, of those that are no object of the task."""

    def name(self, label: str) -> str | None:
        """Return the name of what was detected; None for what is to be ignored."""
        name = self._names.get(label, label)
        if name is None:
            return None
        if (text := name_to_text(name)) in self._objects:
            self._seen.add(text)
        else:
            self._strange[label] += 1
        return name

    @property
    def unmatched(self) -> str:
        """A line that says which labels matched no object of the task and which objects no label, or nothing."""
        missing = [name for text, name in self._objects.items() if text not in self._seen]
        if not (self._strange and missing):
            return ""
        labels = ", ".join(f"{label!r} ({count})" for label, count in self._strange.most_common(SHOWN))
        return f"never detected: {', '.join(missing)}; detected, but nothing of the task: {labels}; labels= gives names"


def read_labels(path: Path | None) -> dict[str, str | None]:
    """Read a YAML file of labels and names, as ``cell phone: CellPhone``; None: no file.

    Raises:
        UserError: the file cannot be read, or holds something else.
    """
    if path is None:
        return {}
    try:
        raw = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UserError(f"labels={path}: cannot be read ({' '.join(str(error).split())})") from None
    if not isinstance(raw, dict) or not all(_is_name(name) for name in raw.values()):
        raise UserError(f"labels={path}: give a line for each label, as `cell phone: CellPhone`, or null to ignore it")
    return {str(label): name for label, name in raw.items()}


def _is_name(name: object) -> bool:
    return name is None or (isinstance(name, str) and bool(name))
