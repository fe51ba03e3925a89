"""The report's tables of cells: the paper's own table, the variants of a sweep, and how far planners are from optimal.

The table of all planners, which is also written for machines, is in `mrtask.analysis.report.planner_table`; planner
against reference in `mrtask.analysis.report.wins`.
"""

from collections.abc import Mapping, Sequence

from mrtask.analysis.page.style import NOTHING, planner_label
from mrtask.analysis.page.tables import (
    Column,
    Entry,
    Row,
    Table,
    block,
    cell_headings,
    estimate_entry,
    improvement_entry,
    interval_text,
    make_table,
)
from mrtask.analysis.report.planner_table import published_name
from mrtask.analysis.results.episodes import Variant
from mrtask.analysis.results.optimality import CellOptimality
from mrtask.analysis.results.published import Published, RealWorldTrial
from mrtask.analysis.results.roles import BASELINES, INFORMED_BASELINE, KNOWN
from mrtask.analysis.results.statistics import EVERYTHING, Cell, Summary, cell_name
from mrtask.homes.home import SIZE_CLASSES
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

    def line(name: str) -> tuple[str, list[Entry]]:
        return planner_label(name), [_cost_entry(summary, published, cell, name) for cell in cells]

    not_run = [name for name in published.planners if name not in map(published_counterpart, summary.planners)]
    lines = [line(name) for name in summary.planners]
    lines += [
        (f"{published_name(name)} (not run)", [Entry(NOTHING, _printed(published, name, cell)) for cell in cells])
        for name in not_run
    ]
    rows = block("Mean cost in grid cells of 0.05 m, its 95 % interval, and the paper's mean", lines)
    for baseline in BASELINES:
        if planner is not None and summary.compared(planner, baseline):
            title = f"Improvement of {planner_label(planner)} over {planner_label(baseline)}"
            entries = [improvement_entry(summary, published, cell, planner, baseline) for cell in cells]
            rows += block(f"{title}, its 95 % interval, and the paper's", [("improvement", entries)])
    if planner is not None and any(name == planner for _, name in summary.gaps):
        shares = [estimate_entry(summary.gap(cell, planner)) for cell in cells]
        title = f"Share closed of the gap between {INFORMED_BASELINE} and {KNOWN}"
        rows += block(title, [(planner_label(planner), shares)])
    return Table(cell_headings(cells), tuple(rows))


def _all_cells(summary: Summary, published: Published) -> list[Cell]:
    present = {*summary.cells, *(cell for _, cell in published.cost_cells)}
    classes = [*dict.fromkeys([*SIZE_CLASSES, *summary.size_classes])]
    return sorted(present, key=lambda cell: (classes.index(cell[0]), cell[1]))


def _cost_entry(summary: Summary, published: Published, cell: Cell, planner: str) -> Entry:
    found, printed = summary.planner_cells.get((cell, planner)), _printed(published, planner, cell)
    if found is None:
        return Entry(NOTHING, printed)
    unfinished = (f"{found.accepted}/{found.episodes} finished",) if found.accepted < found.episodes else ()
    value = estimate_entry(found.cost_cells, unit="").value
    return Entry(value, (interval_text(found.cost_cells), *printed, *unfinished))


def _printed(published: Published, planner: str, cell: Cell) -> tuple[str, ...]:
    value = published.cost_of(planner, cell)
    return () if value is None else (f"paper {value:.2f}",)


def variant_table(summaries: Mapping[Variant, Summary], planner: str | None) -> Table | None:
    """A sweep's variants side by side; None without a sweep."""
    if len(summaries) < 2 or planner is None:
        return None
    cells = [*dict.fromkeys(cell for summary in summaries.values() for cell in summary.cells), EVERYTHING]
    named = {variant or "as configured": summary for variant, summary in summaries.items()}
    rows: list[Row] = []
    for baseline in BASELINES:
        lines = (
            (name, [estimate_entry(summary.improvement(cell, planner, baseline)) for cell in cells])
            for name, summary in named.items()
            if summary.compared(planner, baseline)
        )
        rows += block(f"Improvement of {planner_label(planner)} over {planner_label(baseline)}", lines)
    title = f"Mean cost of {planner_label(planner)} in grid cells, over the trials it finished"
    costs = ((name, [_plain_cost(summary, cell, planner) for cell in cells]) for name, summary in named.items())
    return Table(cell_headings(cells), (*rows, *block(title, costs)))


def _plain_cost(summary: Summary, cell: Cell, planner: str) -> Entry:
    cost = summary.cost(cell, planner)
    ran = (cell, planner) in summary.planner_cells
    return Entry(estimate_entry(cost, unit="").value, (f"n = {cost.n}",) if ran else ())


def optimality_table(cells: Sequence[CellOptimality]) -> Table:
    """How far planners are from optimal, cell by cell."""
    several = len({cell.planner for cell in cells}) > 1
    labels = [cell_name(one.cell) + (f", {planner_label(one.planner)}" if several else "") for one in cells]
    return make_table(OPTIMALITY_COLUMNS, list(zip(labels, cells, strict=True)))


def real_world_table(published: Published) -> Table:
    """The paper's two-robot trials in real apartments; ours are simulated, so they stand alone."""
    labels = [f"{trial.name}: {trial.task} ({len(trial.containers)} containers)" for trial in published.real_world]
    return make_table(REAL_WORLD_COLUMNS, list(zip(labels, published.real_world, strict=True)))
