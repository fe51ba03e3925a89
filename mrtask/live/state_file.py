"""The file that keeps a live team's state: a first line with everything, and a line for each message that changed it.

So an event costs the same however long the team has worked. Once the changes outgrow the first line, the file is
written anew as one line; it is never without a whole state.
"""

import json
from pathlib import Path
from typing import Any

from mrtask.files import replacing
from mrtask.live.live_team import LiveTeam
from mrtask.live.saved import GROWN, IDS, StateError
from mrtask.live.state import LiveSetup
from mrtask.live.store import LEGS_JSON, Mark, restore, save

COMPACT_BYTES = 1_000_000
"""A file with fewer bytes of changes than this is not written anew."""


class StateFile:
    """A live team's state file, which is written after every message."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._kept: Mark | None = None
        """What the file holds; None if that is not known."""
        self._whole_bytes = self._bytes = 0

    def keep(self, live: LiveTeam, now: Mark) -> None:
        """Write the state down, of which ``now`` is the mark.

        Raises:
            OSError: it cannot be written; the file then holds an earlier state.
        """
        kept, self._kept = self._kept, None
        if kept is None or self._bytes - self._whole_bytes > max(COMPACT_BYTES, self._whole_bytes):
            self._write_whole(live)
        elif (line := changes(live, kept, now)) is not None:
            try:
                self._append(line)
            except OSError:
                self._write_whole(live)
        self._kept = now

    def _write_whole(self, live: LiveTeam) -> None:
        text = f"{save(live)}\n".encode()
        with replacing(self.path) as temporary:
            temporary.write_bytes(text)
        self._whole_bytes = self._bytes = len(text)

    def _append(self, line: str) -> None:
        text = f"{line}\n".encode()
        with self.path.open("r+b") as file:
            if file.seek(0, 2) != self._bytes:
                raise OSError("somebody else has written to the file")
            file.write(text)
        self._bytes += len(text)


def changes(live: LiveTeam, before: Mark, now: Mark) -> str | None:
    """Return the line of what changed since a mark; None if nothing did."""
    entry: dict[str, Any] = {key: value for key, value in now.fields.items() if value != before.fields[key]}
    if (now.legs, now.passed) != (before.legs, before.passed):
        entry[GROWN] = []
        for number, robot in enumerate(live.team.robots):
            known, passed = (before.legs[number], before.passed[number]) if number < len(before.legs) else (0, ())
            kept = len(passed) if robot.passed[: len(passed)] == passed else 0
            legs = LEGS_JSON.dump_python(robot.legs[known:], mode="json")
            entry[GROWN].append((legs, kept, robot.passed[kept:]))
    if now.taken > before.taken:
        entry[IDS] = live.ids_since(before.taken)
    return json.dumps(entry, separators=(",", ":")) if entry else None


def read_state(setup: LiveSetup, path: Path) -> LiveTeam:
    """Return the live team whose state is in a file.

    Raises:
        StateError: the file cannot be read, or its state not be restored here.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise StateError(f"{path}: the state cannot be read ({error})") from None
    try:
        return restore(setup, text)
    except StateError as error:
        raise StateError(f"{path}: {error}") from None
