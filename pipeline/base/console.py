"""Prints what a stage says: a headline, a few lines, one progress bar with the time left, where the result is.

On a terminal the bar is drawn in place; elsewhere (a log file, CI) it becomes a plain line every few seconds. Where
several cells of a sweep run at once, lines begin with the cell, and `under_way` sums their progress for one bar.
"""

import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager
from contextvars import ContextVar
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tqdm import tqdm

from mrtask.errors import without_secrets

PLAIN_LINE_EVERY_S = 15.0
INDENT = "   "

_label: ContextVar[str] = ContextVar("label", default="")
"""What lines of this thread begin with."""
_quiet: "set[Progress]" = set()
"""What is under way in labelled threads."""


def labelled(label: str, run: Callable[[], None]) -> None:
    """Run something, in a thread of its own, whose lines begin with a label and that draws no bar."""
    token = _label.set(f"[{label}] ")
    try:
        run()
    finally:
        _label.reset(token)


def under_way() -> str:
    """Return the progress of all labelled threads together: ``12/48 episodes``."""
    done, total = Counter[str](), Counter[str]()
    for one in list(_quiet):
        done[one.unit] += one.done
        total[one.unit] += one.total
    return ", ".join(f"{done[unit]}/{total[unit]} {unit}" for unit in sorted(total))


def headline(stage: str, text: str) -> None:
    """Open a stage."""
    _print(f"== {stage}: {text}")


def line(text: str) -> None:
    """Print one line below the headline."""
    _print(INDENT + text)


def _print(text: str) -> None:
    """Print a line, above a bar that is drawn meanwhile; in one piece, as several threads may print."""
    from tqdm import tqdm  # only a run says lines, and a mistake is to be told at once

    with tqdm.external_write_mode(sys.stdout):
        print(f"{_label.get()}{without_secrets(text)}\n", end="", flush=True)


def text(lines: str) -> None:
    """Print several lines below the headline."""
    for one in lines.splitlines():
        line(one)


def result(path: object, seconds: float) -> None:
    """Close a stage: say where its result is."""
    line(f"-> {path} ({duration(seconds)})")


def skipped(path: object) -> None:
    """Close a stage that had nothing to do."""
    line(f"-> {path} (unchanged, skipped)")


def shown(path: Path) -> Path:
    """Return a local path as a person in this folder would type it."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def duration(seconds: float) -> str:
    """Return ``850 ms``, ``12 s``, ``3 min 20 s``, ``2 h 05 min``."""
    if seconds < 1:
        return f"{seconds * 1000:.0f} ms"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


class Progress(AbstractContextManager["Progress"]):
    """One bar (or a plain line now and then) for ``total`` things, ``done`` of which existed before."""

    def __init__(self, total: int, unit: str, done: int = 0) -> None:
        self.total, self.unit, self.done = total, unit, done
        self._note = ""
        self._last_line_s = time.monotonic()
        self._first: tuple[int, float] | None = None
        self._bar: tqdm[object] | None = None
        self._labelled = bool(_label.get())
        if self._labelled:
            _quiet.add(self)
        elif sys.stderr.isatty():
            self._bar = self._opened()

    def _opened(self) -> "tqdm[object]":
        """Return the bar on the terminal."""
        from tqdm import tqdm

        form = INDENT + "{percentage:3.0f}% |{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}, {rate_fmt}{postfix}]"
        return tqdm(
            total=self.total,
            initial=self.done,
            unit=f" {self.unit}",
            bar_format=form,
            dynamic_ncols=True,
            leave=False,
        )

    def update(self, count: int = 1, note: str = "") -> None:
        """Count ``count`` more as done; ``note`` ends the line."""
        self.done += count
        self._note = note or self._note
        self._first = self._first or (self.done, time.monotonic())
        if self._bar is not None:
            self._bar.set_postfix_str(self._note, refresh=False)
            self._bar.update(count)
        elif not self._labelled and time.monotonic() - self._last_line_s >= PLAIN_LINE_EVERY_S:
            self._last_line_s = time.monotonic()
            line(self._plain())

    def _plain(self) -> str:
        return ", ".join(filter(None, (f"{self.done}/{self.total} {self.unit}", self._pace(), self._note)))

    def _pace(self) -> str:
        """Return the rate since the first result, before which workers start and compile; nothing before the second."""
        assert self._first is not None
        first_done, first_s = self._first
        rate = (self.done - first_done) / max(time.monotonic() - first_s, 1e-9)
        if rate == 0:
            return ""
        speed = f"{rate:.0f}/s" if rate >= 10 else f"{rate:.2g}/s"
        return f"{speed}, {duration((self.total - self.done) / rate)} left"

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        _quiet.discard(self)
        if self._bar is not None:
            self._bar.close()
