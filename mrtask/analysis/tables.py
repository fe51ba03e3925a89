"""The result as tables: one flat table for machines (``table.csv``) and the paper's table for people.

Tables for people are plain values (`Table`) that the report's template lays out.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mrtask.analysis.episodes import Variant
from mrtask.analysis.findings import EVERYTHING, cell_name
from mrtask.analysis.published import PAPERS_PLANNER, Published, published_counterpart
from mrtask.analysis.statistics import (
    ALL_TEAMS,
    BASELINES,
    KNOWN,
    REFERENCES,
    Cell,
    Comparison,
    Estimate,
    Summary,
)
from mrtask.analysis.style import NOTHING, seconds, short_name

ABOVE, BELOW, LEVEL = "▲", "▼", "≈"
"""The whole interval above or below the published value, or around it."""


@dataclass(frozen=True)
class Entry:
    """One place in a table: the value, finer print under it, and ``tone``: ``good``, ``bad``, ``text``."""

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


def result_table(summaries: Mapping[Variant, Summary], published: Published) -> pd.DataFrame:
    """One row per (size class, robots, planner), and per variant of a sweep.

    Costs are means over the ``n`` accepted episodes; improvements, in percent, are over the ``pairs_`` trials that both
    planners finished.
    """
    records = [
        _record(summary, published, cell, planner) | ({"sweep": variant} if len(summaries) > 1 or variant else {})
        for variant, summary in summaries.items()
        for cell in summary.cells
        for planner in summary.planners
        if (cell, planner) in summary.planner_cells
    ]
    frame = pd.DataFrame(records, columns=None if records else list(_record_columns()))
    return frame[["sweep", *frame.columns.drop("sweep")]] if "sweep" in frame.columns else frame


def _record_columns() -> list[str]:
    columns = ["size_class", "robots", "planner", "episodes", "n", "failed", "error", "timeout"]
    columns += ["mean_cost_cells", "cost_cells_low", "cost_cells_high", "mean_cost_s", "planning_s_per_decision"]
    columns += ["published_cost_cells", "published_planner"]
    for name in REFERENCES:
        columns += [f"improvement_over_{name}_percent", f"improvement_over_{name}_low", f"improvement_over_{name}_high"]
        columns += [f"pairs_{name}", f"wins_{name}", f"ties_{name}", f"losses_{name}", f"p_value_{name}"]
        columns += [f"published_improvement_over_{name}_percent"] if name in BASELINES else []
    return [*columns, "gap_closed_percent", "gap_closed_low", "gap_closed_high"]


def _record(summary: Summary, published: Published, cell: Cell, planner: str) -> dict[str, object]:
    found = summary.planner_cells[cell, planner]
    printed = published.cost_of(planner, cell)
    values: list[object] = [*cell, planner, found.episodes, found.accepted]
    values += [found.counts[status] for status in ("failed", "error", "timeout")]
    values += [*_numbers(found.cost_cells), found.cost_s, found.decision_s]
    values += [_or_nan(printed), "" if printed is None else _published_name(published_counterpart(planner))]
    for name in REFERENCES:
        values += _comparison_values(summary.comparisons.get((cell, planner, name)))
        values += [_or_nan(published.improvement_of(planner, name, cell))] if name in BASELINES else []
    values += _numbers(summary.gaps.get((cell, planner)))
    return dict(zip(_record_columns(), values, strict=True))


def _comparison_values(comparison: Comparison | None) -> list[float]:
    if comparison is None:
        return [np.nan, np.nan, np.nan, 0, 0, 0, 0, np.nan]
    counts = [comparison.improvement.n, comparison.wins, comparison.ties, comparison.losses]
    return [*_numbers(comparison.improvement), *counts, comparison.p_value]


def _numbers(estimate: Estimate | None) -> list[float]:
    return [estimate.value, estimate.low, estimate.high] if estimate else [np.nan] * 3


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value


def paper_table(summary: Summary, published: Published, planner: str | None) -> Table:
    """The paper's table: mean costs of all planners, then ``planner``'s improvements, published values beside ours.

    All cells of the published table and of ours are columns, so that a missing one is seen.
    """
    ours = set(summary.cells)
    printed = {cell for _, cell in published.cost_cells}
    classes = dict.fromkeys([*("small", "medium", "large"), *summary.size_classes])
    robots = sorted({count for _, count in ours | printed})
    cells = [(name, count) for name in classes for count in robots if (name, count) in ours | printed]
    rows = [Row("Mean cost in grid cells of 0.05 m, its 95 % interval, and the paper's mean", heading=True)]
    for name in summary.planners:
        rows.append(Row(short_name(name), tuple(_cost_entry(summary, published, cell, name) for cell in cells)))
    for name in ("nonlearned_myopic", "learned_myopic", PAPERS_PLANNER):
        if not any(published_counterpart(own) == name for own in summary.planners):
            entries = tuple(Entry(NOTHING, (_published(published.cost_of(name, cell)),)) for cell in cells)
            rows.append(Row(f"{_published_name(name)} (not run)", entries))
    for baseline in BASELINES:
        if planner is not None and any(key[1:] == (planner, baseline) for key in summary.comparisons):
            title = f"Improvement of {short_name(planner)} over {short_name(baseline)}"
            title += ", its 95 % interval, and the paper's"
            rows.append(Row(title, heading=True))
            entries = tuple(_improvement_entry(summary, published, cell, planner, baseline) for cell in cells)
            rows.append(Row("improvement", entries))
    if planner is not None and any(name == planner for _, name in summary.gaps):
        rows.append(Row(f"Share closed of the gap between learned_myopic and {KNOWN}", heading=True))
        rows.append(
            Row(short_name(planner), tuple(_percent_entry(summary.gaps.get((cell, planner))) for cell in cells))
        )
    return Table(tuple((name, "1 robot" if count == 1 else f"{count} robots") for name, count in cells), tuple(rows))


def planner_table(summary: Summary) -> Table:
    """All planners over all episodes: how many finished, at what cost, improvements over the references, planning."""
    references = [name for name in REFERENCES if name in summary.planners]
    columns = [("episodes", "run"), ("episodes", "not accepted")]
    columns += [("mean cost", "seconds"), ("mean cost", "cells")]
    columns += [("improvement over", short_name(name)) for name in references]
    columns += [("gap to known", "closed")] if KNOWN in summary.planners else []
    columns += [("planning", "per decision")]
    rows = []
    for name in summary.planners:
        found = summary.planner_cells[EVERYTHING, name]
        lost = {status: count for status, count in found.counts.items() if count and status != "accepted"}
        kinds = tuple(f"{count} {status}" for status, count in lost.items())
        entries = [Entry(str(found.episodes)), Entry(str(sum(lost.values())), kinds)]
        entries += [Entry(_number(found.cost_s, 2)), Entry(_number(found.cost_cells.value, 1))]
        for reference in references:
            comparison = summary.comparisons.get((EVERYTHING, name, reference))
            entries.append(_percent_entry(comparison.improvement if comparison else None, colored=True))
        if KNOWN in summary.planners:
            entries.append(_percent_entry(summary.gaps.get((EVERYTHING, name))))
        entries.append(Entry(seconds(found.decision_s)))
        rows.append(Row(short_name(name), tuple(entries)))
    return Table(tuple(columns), tuple(rows))


def pair_table(summary: Summary, planner: str | None) -> Table | None:
    """``planner`` against every reference, cell by cell: pairs, wins, ties, losses, test; None where there is none."""
    columns = [("trials", "paired"), ("planner is", "sooner"), ("planner is", "equal"), ("planner is", "later")]
    columns += [
        ("trials", "only it finished"),
        ("trials", "only the other"),
        ("improvement", "95 %"),
        ("Wilcoxon", "p"),
    ]
    rows: list[Row] = []
    pooled = [*((name, ALL_TEAMS) for name in summary.size_classes), EVERYTHING]
    for reference in REFERENCES:
        lines = [
            Row(
                "all" if cell == EVERYTHING else cell_name(cell),
                _pair_entries(summary.comparisons[cell, planner, reference]),
            )
            for cell in [*summary.cells, *pooled]
            if planner is not None and (cell, planner, reference) in summary.comparisons
        ]
        if lines:
            rows += [Row(f"against {short_name(reference)}", heading=True), *lines]
    return Table(tuple(columns), tuple(rows)) if rows else None


def variant_table(summaries: Mapping[Variant, Summary], planner: str | None) -> Table | None:
    """A sweep's variants side by side; None without a sweep."""
    if len(summaries) < 2 or planner is None:
        return None
    cells = list(dict.fromkeys(cell for summary in summaries.values() for cell in [*summary.cells, EVERYTHING]))
    cells = [cell for cell in cells if cell != EVERYTHING] + [EVERYTHING]
    rows: list[Row] = []
    for baseline in BASELINES:
        lines = []
        for variant, summary in summaries.items():
            found = [summary.comparisons.get((cell, planner, baseline)) for cell in cells]
            if any(found):
                entries = tuple(_percent_entry(each.improvement if each else None) for each in found)
                lines.append(Row(variant or "as configured", entries))
        if lines:
            rows += [Row(f"Improvement of {short_name(planner)} over {short_name(baseline)}", heading=True), *lines]
    rows.append(Row(f"Mean cost of {short_name(planner)} in grid cells, over the trials it finished", heading=True))
    for variant, summary in summaries.items():
        costs = [summary.planner_cells.get((cell, planner)) for cell in cells]
        rows.append(
            Row(
                variant or "as configured",
                tuple(_plain_cost_entry(each.cost_cells if each else None) for each in costs),
            )
        )
    return Table(tuple((name, _team(count)) for name, count in cells), tuple(rows))


def _team(robots: int) -> str:
    return "all teams" if robots == ALL_TEAMS else "1 robot" if robots == 1 else f"{robots} robots"


def real_world_table(published: Published) -> Table:
    """The paper's two-robot trials in real apartments; ours are simulated, so they stand alone."""
    rows = []
    for trial in published.real_world:
        saved = Entry(f"{100 * (1 - trial.planner_m / trial.myopic_m):.1f} %")
        costs = (Entry(f"{trial.myopic_m:.2f} m"), Entry(f"{trial.planner_m:.2f} m"), saved)
        rows.append(Row(f"{trial.name}: {trial.task} ({len(trial.containers)} containers)", costs))
    return Table((("navigation cost", "myopic"), ("navigation cost", "planner"), ("", "improvement")), tuple(rows))


def _cost_entry(summary: Summary, published: Published, cell: Cell, planner: str) -> Entry:
    found = summary.planner_cells.get((cell, planner))
    printed = published.cost_of(planner, cell)
    details = (_published(printed),) if printed is not None else ()
    if found is None:
        return Entry(NOTHING, details)
    unfinished = (f"{found.accepted}/{found.episodes} finished",) if found.accepted < found.episodes else ()
    return Entry(_number(found.cost_cells.value, 1), (_interval(found.cost_cells), *details, *unfinished))


def _improvement_entry(summary: Summary, published: Published, cell: Cell, planner: str, baseline: str) -> Entry:
    comparison = summary.comparisons.get((cell, planner, baseline))
    printed = published.improvement_of(planner, baseline, cell)
    entry = _percent_entry(comparison.improvement if comparison else None)
    if printed is None:
        return entry
    mark = ""
    if comparison and np.isfinite(comparison.improvement.low):
        estimate = comparison.improvement
        mark = ABOVE if estimate.low > printed else BELOW if estimate.high < printed else LEVEL
    tone = {ABOVE: "good", BELOW: "bad"}.get(mark, "")
    return Entry(f"{entry.value} {mark}".strip(), (*entry.details, f"paper {printed:.2f} %"), tone)


def _percent_entry(estimate: Estimate | None, colored: bool = False) -> Entry:
    if estimate is None or not estimate.defined:
        return Entry(NOTHING)
    tone = ("good" if estimate.low > 0 else "bad" if estimate.high < 0 else "") if colored else ""
    return Entry(f"{estimate.value:.1f} %", (_interval(estimate),), tone)


def _plain_cost_entry(estimate: Estimate | None) -> Entry:
    return Entry(NOTHING) if estimate is None else Entry(_number(estimate.value, 1), (f"n = {estimate.n}",))


def _pair_entries(comparison: Comparison) -> tuple[Entry, ...]:
    counts = [comparison.improvement.n, comparison.wins, comparison.ties, comparison.losses]
    counts += [comparison.only_planner, comparison.only_baseline]
    p_value = comparison.p_value
    p_text = NOTHING if not np.isfinite(p_value) else "< 0.001" if p_value < 0.001 else f"{p_value:.3f}"
    return (
        *(Entry(str(count)) for count in counts),
        _percent_entry(comparison.improvement, colored=True),
        Entry(p_text),
    )


def _interval(estimate: Estimate) -> str:
    return f"[{estimate.low:.1f}, {estimate.high:.1f}]" if np.isfinite(estimate.low) else f"n = {estimate.n}"


def _published(value: float | None) -> str:
    return "" if value is None else f"paper {value:.2f}"


def _published_name(name: str) -> str:
    return "multi-robot planner" if name == PAPERS_PLANNER else name


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else NOTHING
