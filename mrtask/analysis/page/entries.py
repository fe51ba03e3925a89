"""Table cells that several pages share: percentages with intervals, and improvements beside published ones."""

from collections.abc import Sequence

from mrtask.analysis.page.columns import Entry, interval_text
from mrtask.analysis.page.style import NOTHING
from mrtask.analysis.results.published import Published
from mrtask.analysis.results.statistics import ALL_TEAMS, Cell, Estimate, Summary
from mrtask.names import counted

ABOVE, BELOW, LEVEL = "▲", "▼", "≈"
"""The whole interval above or below the published value, or around it."""


def improvement_entry(summary: Summary, published: Published, cell: Cell, planner: str, baseline: str) -> Entry:
    """Our improvement with its interval and the published one, marked as above, around or below it."""
    estimate = summary.improvement(cell, planner, baseline)
    printed = published.improvement_of(planner, baseline, cell)
    entry = percent_entry(estimate)
    if printed is None:
        return entry
    mark = ""
    if estimate.has_interval:
        mark = ABOVE if estimate.low > printed else BELOW if estimate.high < printed else LEVEL
    tone = {ABOVE: "good", BELOW: "bad"}.get(mark, "")
    return Entry(f"{entry.value} {mark}".strip(), (*entry.details, f"paper {printed:.2f} %"), tone)


def cell_headings(cells: Sequence[Cell]) -> tuple[tuple[str, str], ...]:
    """Size class and team of each cell, as a table's headings."""
    return tuple((name, counted(robots, "robot") if robots != ALL_TEAMS else "all teams") for name, robots in cells)


def percent_entry(estimate: Estimate) -> Entry:
    """A percentage with its interval."""
    return Entry(f"{estimate.value:.1f} %", (interval_text(estimate),)) if estimate.defined else Entry(NOTHING)
