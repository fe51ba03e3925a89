"""The tables of the report for people: the paper's own, a sweep's variants, how far from optimal.

The table of all planners, which is also written for machines, is in `mrtask.analysis.report.planner_table`; planner
against reference in `mrtask.analysis.report.wins`.
"""

from collections.abc import Mapping, Sequence

from mrtask.analysis.page.tables import Column, Entry, Row, Table, interval_text, make_table
from mrtask.analysis.page.tables import cell_headings, improvement_entry, percent_entry
from mrtask.analysis.page.style import NOTHING, planner_label
from mrtask.analysis.report.planner_table import published_name
from mrtask.analysis.results.episodes import Variant
from mrtask.analysis.results.optimality import CellOptimality
from mrtask.analysis.results.published import Published, RealWorldTrial
from mrtask.analysis.results.roles import BASELINES, INFORMED_BASELINE, KNOWN
from mrtask.analysis.results.statistics import EVERYTHING, Cell, Estimate, Summary, cell_name
from mrtask.homes.home import SIZE_CLASSES
from mrtask.names import counted
from mrtask.planning.planners import published_counterpart

REAL_WORLD_COLUMNS = (
    Column[RealWorldTrial](lambda trial: trial.myopic_m, ("navigation cost", "myopic"), digits=2, unit=" m"),
    Column[RealWorldTrial](lambda trial: trial.planner_m, ("navigation cost", "planner"), digits=2, unit=" m"),
    Column[RealWorldTrial](
        lambda trial: 100 * (1 - trial.planner_m / trial.myopic_m), ("", "improvement"), digits=1, unit=" %"
    ),
)
OPTIMALITY_COLUMNS = (
    Column[CellOptimality](lambda cell: cell.gap_percent.n, ("", "trials")),
    Column[CellOptimality](lambda cell: cell.cost_s, ("mean makespan", "planner"), digits=2, unit=" s"),
    Column[CellOptimality](lambda cell: cell.bound_s, ("mean makespan", "bound"), digits=2, unit=" s"),
    Column[CellOptimality](lambda cell: cell.clairvoyant_s, ("mean makespan", "clairvoyant"), digits=2, unit=" s"),
    Column[CellOptimality](lambda cell: cell.gap_percent, ("planner above bound", "of means"), digits=1, unit=" %"),
    Column[CellOptimality](
        lambda cell: cell.median_gap_percent, ("planner above bound", "median trial"), digits=1, unit=" %"
    ),
    Column[CellOptimality](lambda cell: 100 * cell.exact_share, ("bound", "exact"), unit=" %"),
    Column[CellOptimality](lambda cell: cell.bound_seconds, ("bound", "CPU time"), digits=2, unit=" s"),
    Column[CellOptimality](lambda cell: cell.failed, ("", "unfinished")),
)


def paper_table(summary: Summary, published: Published, planner: str | None) -> Table:
    """The paper's table: mean costs of all planners, then ``planner``'s improvements, published values beside ours.

    All cells of the published table and of ours are columns, so that a missing one is seen.
    """
    cells = _all_cells(summary, published)
    rows = _cost_rows(summary, published, cells)
    if planner is not None:
        rows += _improvement_rows(summary, published, planner, cells)
        rows += _gap_rows(summary, planner, cells)
    return Table(tuple((name, counted(count, "robot")) for name, count in cells), tuple(rows))


def _all_cells(summary: Summary, published: Published) -> list[Cell]:
    present = {*summary.cells, *(cell for _, cell in published.cost_cells)}
    classes = dict.fromkeys([*SIZE_CLASSES, *summary.size_classes])
    robots = sorted({count for _, count in present})
    return [(name, count) for name in classes for count in robots if (name, count) in present]


def _cost_rows(summary: Summary, published: Published, cells: Sequence[Cell]) -> list[Row]:
    rows = [Row("Mean cost in grid cells of 0.05 m, its 95 % interval, and the paper's mean", heading=True)]
    for name in summary.planners:
        rows.append(Row(planner_label(name), tuple(_cost_entry(summary, published, cell, name) for cell in cells)))
    for name in published.planners:
        if not any(published_counterpart(own) == name for own in summary.planners):
            entries = tuple(Entry(NOTHING, (_published(published.cost_of(name, cell)),)) for cell in cells)
            rows.append(Row(f"{published_name(name)} (not run)", entries))
    return rows


def _improvement_rows(summary: Summary, published: Published, planner: str, cells: Sequence[Cell]) -> list[Row]:
    rows = []
    for baseline in BASELINES:
        if summary.compared(planner, baseline):
            title = f"Improvement of {planner_label(planner)} over {planner_label(baseline)}"
            rows.append(Row(f"{title}, its 95 % interval, and the paper's", heading=True))
            entries = tuple(improvement_entry(summary, published, cell, planner, baseline) for cell in cells)
            rows.append(Row("improvement", entries))
    return rows


def _gap_rows(summary: Summary, planner: str, cells: Sequence[Cell]) -> list[Row]:
    if not any(name == planner for _, name in summary.gaps):
        return []
    return [
        Row(f"Share closed of the gap between {INFORMED_BASELINE} and {KNOWN}", heading=True),
        Row(planner_label(planner), tuple(percent_entry(summary.gap(cell, planner)) for cell in cells)),
    ]


def variant_table(summaries: Mapping[Variant, Summary], planner: str | None) -> Table | None:
    """A sweep's variants side by side; None without a sweep."""
    if len(summaries) < 2 or planner is None:
        return None
    single = dict.fromkeys(cell for summary in summaries.values() for cell in summary.cells)
    cells = [*single, EVERYTHING]
    rows: list[Row] = []
    for baseline in BASELINES:
        lines = [
            Row(
                variant or "as configured",
                tuple(percent_entry(summary.improvement(cell, planner, baseline)) for cell in cells),
            )
            for variant, summary in summaries.items()
            if any((cell, planner, baseline) in summary.comparisons for cell in cells)
        ]
        if lines:
            title = f"Improvement of {planner_label(planner)} over {planner_label(baseline)}"
            rows += [Row(title, heading=True), *lines]
    rows.append(Row(f"Mean cost of {planner_label(planner)} in grid cells, over the trials it finished", heading=True))
    for variant, summary in summaries.items():
        entries = tuple(
            _plain_cost_entry(summary.cost(cell, planner) if (cell, planner) in summary.planner_cells else None)
            for cell in cells
        )
        rows.append(Row(variant or "as configured", entries))
    return Table(cell_headings(cells), tuple(rows))


def optimality_table(cells: Sequence[CellOptimality]) -> Table:
    """How far planners are from optimal, cell by cell."""
    several = len({cell.planner for cell in cells}) > 1
    return make_table(
        OPTIMALITY_COLUMNS,
        [
            (f"{cell_name(cell.cell)}, {planner_label(cell.planner)}" if several else cell_name(cell.cell), cell)
            for cell in cells
        ],
    )


def real_world_table(published: Published) -> Table:
    """The paper's two-robot trials in real apartments; ours are simulated, so they stand alone."""
    labels = [f"{trial.name}: {trial.task} ({len(trial.containers)} containers)" for trial in published.real_world]
    return make_table(REAL_WORLD_COLUMNS, list(zip(labels, published.real_world, strict=True)))


def _cost_entry(summary: Summary, published: Published, cell: Cell, planner: str) -> Entry:
    found = summary.planner_cells.get((cell, planner))
    printed = published.cost_of(planner, cell)
    details = (_published(printed),) if printed is not None else ()
    if found is None:
        return Entry(NOTHING, details)
    unfinished = (f"{found.accepted}/{found.episodes} finished",) if found.accepted < found.episodes else ()
    return Entry(_cost_text(found.cost_cells), (interval_text(found.cost_cells), *details, *unfinished))


def _plain_cost_entry(estimate: Estimate | None) -> Entry:
    return Entry(NOTHING) if estimate is None else Entry(_cost_text(estimate), (f"n = {estimate.n}",))


def _cost_text(estimate: Estimate) -> str:
    return f"{estimate.value:.1f}" if estimate.defined else NOTHING


def _published(value: float | None) -> str:
    return "" if value is None else f"paper {value:.2f}"
