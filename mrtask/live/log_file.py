"""The log of a live team: every message in and out, one JSON object a line.

A log is for later; it never stops the team. Where it cannot be written, that is said once, and a line of kind ``gap``
follows as soon as it can be written again.
"""

import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mrtask.errors import InputError

LOGGER = logging.getLogger(__name__)
GAP = "gap"


class LogFile:
    """A log that lines are added to; a last line that was cut off by an earlier process is removed."""

    def __init__(self, path: Path) -> None:
        self._path, self._gap, self._opened = path, False, False

    def write(self, kind: str, lines: list[str], out: list[str], **facts: object) -> None:
        """Add an entry: the lines that came in, and those that went out."""
        added: list[dict[str, Any]] = [{"kind": GAP, "lines": [], "out": []}] if self._gap else []
        added.append({"kind": kind, "lines": lines, "out": out, **facts})
        text = "".join(f"{json.dumps(entry)}\n" for entry in added).encode()
        try:
            if not self._opened:
                self._begin()
            with self._path.open("ab") as file:
                size = file.tell()
                try:
                    file.write(text)
                    file.flush()
                except OSError:
                    file.truncate(size)
                    raise
            self._gap = False
        except OSError as error:
            if not self._gap:
                LOGGER.warning("%s: the log cannot be written (%s); the team goes on without", self._path, error)
            self._gap = True

    def _begin(self) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        if self._path.exists():
            with self._path.open("r+b") as file:
                file.truncate(_end_of_lines(file))
        self._opened = True


def _end_of_lines(file: Any, block: int = 65_536) -> int:
    """Return where the last whole line of a file ends."""
    end: int = file.seek(0, 2)
    while end > 0:
        start = max(end - block, 0)
        file.seek(start)
        found = file.read(end - start).rfind(b"\n")
        if found >= 0:
            return start + int(found) + 1
        end = start
    return 0


def entries(log: Path) -> Iterator[tuple[int, dict[str, Any] | None]]:
    """Yield (line number, entry) of a log; None for a line that is no entry, such as one that was cut off.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        with log.open("rb") as file:
            for number, line in enumerate(file, 1):
                yield number, _entry(line)
    except OSError as error:
        raise InputError(f"{log}: the log cannot be read ({error})") from None


def _entry(line: bytes) -> dict[str, Any] | None:
    try:
        entry = json.loads(line)
        well = {"kind", "lines"} <= entry.keys() and all(isinstance(one, str) for one in entry["lines"])
    except (ValueError, AttributeError, TypeError, RecursionError):
        return None
    return {"out": [], **entry} if well else None
