"""Tables as plain values that the pages' templates lay out, the declaration of one column, and entries for estimates.

A column says once what it shows and how, so that no table depends on the position of its values.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from mrtask.analysis.page.style import NOTHING
from mrtask.analysis.results.published import Published
from mrtask.analysis.results.statistics import ALL_TEAMS, EVERYTHING, Cell, Estimate, Summary, cell_name
from mrtask.names import counted

T = TypeVar("T")
Value = str | int | float | Estimate

ABOVE, BELOW, LEVEL = "▲", "▼", "≈"
"""The whole interval is above the published value, below it, or contains it."""
MARKS = {"above": ABOVE, "level": LEVEL, "below": BELOW}


@dataclass(frozen=True)
class Entry:
    """One cell of a table: the value, smaller text under it, and ``tone``: ``good``, ``bad``, ``text``."""

    value: str
    details: tuple[str, ...] = ()
    tone: str = ""


@dataclass(frozen=True)
class Row:
    """A labelled row; a ``heading`` row has no entries and opens a part of the table."""

    label: str
    entries: tuple[Entry, ...] = ()
    heading: bool = False


@dataclass(frozen=True)
class Table:
    """``columns`` are ``(upper heading, lower heading)``; neighbours with one upper heading share it."""

    columns: tuple[tuple[str, str], ...]
    rows: tuple[Row, ...]

    @property
    def spans(self) -> list[tuple[str, int]]:
        """The upper headings with the number of columns each spans."""
        spans: list[tuple[str, int]] = []
        for upper, _ in self.columns:
            if spans and spans[-1][0] == upper:
                spans[-1] = (upper, spans[-1][1] + 1)
            else:
                spans.append((upper, 1))
        return spans


@dataclass(frozen=True)
class Column(Generic[T]):
    """What one column shows of each ``T``, for people (`entry`) and for machines (`record`)."""

    value: Callable[[T], Value]
    heading: tuple[str, str] = ("", "")
    """Upper and lower heading for people."""
    csv: tuple[str, ...] = ()
    """Names for machines: one, or three for an estimate (value, low, high)."""
    digits: int = 0
    unit: str = ""
    higher_is_better: bool | None = None
    """An estimate whose whole interval is above or below zero is coloured by this; None: never."""
    text: Callable[[float], str] | None = None
    """How a number is written where ``digits`` and ``unit`` do not serve."""
    details: Callable[[T], tuple[str, ...]] | None = None
    """Smaller text under the value; None: the interval of an estimate."""
    tone: str = ""

    def entry(self, subject: T) -> Entry:
        """The cell for people."""
        value = self.value(subject)
        details = self.details(subject) if self.details else None
        if not isinstance(value, Estimate):
            return Entry(value if isinstance(value, str) else self._number(value), details or (), self.tone)
        entry = estimate_entry(value, self.digits, self.unit, higher_is_better=self.higher_is_better)
        return entry if details is None else replace(entry, details=details)

    def record(self, subject: T) -> dict[str, Value]:
        """The cells for machines, by name."""
        value = self.value(subject)
        values = (value.value, value.low, value.high) if isinstance(value, Estimate) else (value,)
        return dict(zip(self.csv, values, strict=True))

    def _number(self, value: float) -> str:
        if self.text:
            return self.text(value)
        return f"{value:.{self.digits}f}{self.unit}" if np.isfinite(value) else NOTHING


def make_table(columns: Sequence[Column[T]], rows: Iterable[str | tuple[str, T]]) -> Table:
    """The table of ``(label, subject)`` rows; a string is a heading row."""
    return Table(
        tuple(column.heading for column in columns),
        tuple(
            Row(row, heading=True)
            if isinstance(row, str)
            else Row(row[0], tuple(column.entry(row[1]) for column in columns))
            for row in rows
        ),
    )


def block(heading: str, lines: Iterable[tuple[str, Iterable[Entry]]]) -> list[Row]:
    """A heading row with the labelled rows below it; nothing where there are none."""
    rows = [Row(label, tuple(entries)) for label, entries in lines]
    return [Row(heading, heading=True), *rows] if rows else []


def estimate_entry(
    estimate: Estimate,
    digits: int = 1,
    unit: str = " %",
    sign: str = "",
    higher_is_better: bool | None = None,
    interval_digits: int = 1,
) -> Entry:
    """An estimate above its interval, coloured where the whole interval is better or worse than zero."""
    if not estimate.defined:
        return Entry(NOTHING)
    tone = ""
    if higher_is_better is not None and (estimate.low > 0 or estimate.high < 0):
        tone = "good" if (estimate.low > 0) == higher_is_better else "bad"
    return Entry(f"{estimate.value:{sign}.{digits}f}{unit}", (interval_text(estimate, interval_digits),), tone)


def saved_entry(estimate: Estimate) -> Entry:
    """What is saved, in percent: green where the interval is above zero, red where it is below."""
    return estimate_entry(estimate, higher_is_better=True)


def improvement_entry(summary: Summary, published: Published, cell: Cell, planner: str, baseline: str) -> Entry:
    """Our improvement with its interval and the published one, marked as above, around or below it."""
    estimate = summary.improvement(cell, planner, baseline)
    printed = published.improvement_of(planner, baseline, cell)
    entry = estimate_entry(estimate)
    if printed is None:
        return entry
    sign = mark(estimate, printed)
    tone = {ABOVE: "good", BELOW: "bad"}.get(sign, "")
    return Entry(f"{entry.value} {sign}".strip(), (*entry.details, f"paper {printed:.2f} %"), tone)


def mark(estimate: Estimate, printed: float) -> str:
    """Whether the interval is above, around or below a published value; empty without an interval."""
    if not estimate.has_interval:
        return ""
    return ABOVE if estimate.low > printed else BELOW if estimate.high < printed else LEVEL


def cell_headings(cells: Sequence[Cell]) -> tuple[tuple[str, str], ...]:
    """Size class and team of each cell, as a table's headings; ``all teams`` for `EVERYTHING`."""
    return tuple((name, counted(robots, "robot") if robots != ALL_TEAMS else "all teams") for name, robots in cells)


def cell_label(cell: Cell) -> str:
    """The cell's name as a row's label; ``all`` for everything together."""
    return "all" if cell == EVERYTHING else cell_name(cell)


def interval_text(estimate: Estimate, digits: int = 1) -> str:
    """``[low, high]``; the number of trials where they are too few for an interval."""
    if not estimate.has_interval:
        return f"n = {estimate.n}"
    return f"[{estimate.low:.{digits}f}, {estimate.high:.{digits}f}]"
