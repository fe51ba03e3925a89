"""Tables as plain values that the report's templates lay out, and the declaration of one column.

A column says once what it shows and how, so that no table depends on the position of its values.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from mrtask.analysis.page.style import NOTHING
from mrtask.analysis.results.statistics import Estimate

T = TypeVar("T")
Value = str | int | float | Estimate


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
        if isinstance(value, Estimate):
            return self._estimate_entry(value, details)
        return Entry(value if isinstance(value, str) else self._number(value), details or (), self.tone)

    def record(self, subject: T) -> dict[str, Value]:
        """The cells for machines, by name."""
        value = self.value(subject)
        values = (value.value, value.low, value.high) if isinstance(value, Estimate) else (value,)
        return dict(zip(self.csv, values, strict=True))

    def _estimate_entry(self, estimate: Estimate, details: tuple[str, ...] | None) -> Entry:
        if not estimate.defined:
            return Entry(NOTHING)
        if details is None:
            details = (interval_text(estimate),)
        if self.higher_is_better is None:
            return Entry(self._number(estimate.value), details, self.tone)
        above, below = ("good", "bad") if self.higher_is_better else ("bad", "good")
        tone = above if estimate.low > 0 else below if estimate.high < 0 else ""
        return Entry(self._number(estimate.value), details, tone)

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


def interval_text(estimate: Estimate) -> str:
    """``[low, high]``; the number of trials where they are too few for an interval."""
    return f"[{estimate.low:.1f}, {estimate.high:.1f}]" if estimate.has_interval else f"n = {estimate.n}"
