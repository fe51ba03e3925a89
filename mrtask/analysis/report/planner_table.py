"""The statistics reported for each planner: the columns of ``table.csv`` and of the report's table of all planners.

To add a statistic, declare its `Column` here and list it in `csv_columns`, in `report_columns`, or in both.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mrtask.analysis.page.style import planner_label, seconds
from mrtask.analysis.page.tables import Column, Table, make_table
from mrtask.analysis.results.episodes import Variant
from mrtask.analysis.results.published import Published
from mrtask.analysis.results.roles import BASELINES, KNOWN, REFERENCES
from mrtask.analysis.results.statistics import EVERYTHING, Cell, Comparison, PlannerCell, Summary
from mrtask.planning.planners import PAPERS_PLANNER, published_counterpart


@dataclass(frozen=True)
class Result:
    """One planner in one cell, with everything it is compared with: the subject of every column here."""

    summary: Summary
    published: Published
    cell: Cell
    planner: str

    @property
    def found(self) -> PlannerCell:
        """The planner's own numbers."""
        return self.summary.planner_cells[self.cell, self.planner]

    @property
    def published_cost(self) -> float | None:
        """The published mean cost of the planner's counterpart, in grid cells."""
        return self.published.cost_of(self.planner, self.cell)

    @property
    def published_name(self) -> str:
        """The counterpart's published name; empty where no cost of it was published."""
        counterpart = published_counterpart(self.planner)
        return "" if counterpart is None or self.published_cost is None else published_name(counterpart)

    @property
    def lost(self) -> dict[str, int]:
        """Status -> number of episodes that ended with it, other than accepted ones."""
        return {status: count for status, count in self.found.counts.items() if count and status != "accepted"}


def published_name(planner: str) -> str:
    """What the paper calls a planner of its table."""
    return "multi-robot planner" if planner == PAPERS_PLANNER else planner


SIZE_CLASS = Column[Result](lambda result: result.cell[0], csv=("size_class",))
ROBOTS = Column[Result](lambda result: result.cell[1], csv=("robots",))
PLANNER = Column[Result](lambda result: result.planner, csv=("planner",))
EPISODES = Column[Result](lambda result: result.found.episodes, ("episodes", "run"), ("episodes",))
ACCEPTED = Column[Result](lambda result: result.found.accepted, csv=("n",))
FAILED = Column[Result](lambda result: result.found.counts["failed"], csv=("failed",))
ERROR = Column[Result](lambda result: result.found.counts["error"], csv=("error",))
TIMEOUT = Column[Result](lambda result: result.found.counts["timeout"], csv=("timeout",))
NOT_ACCEPTED = Column[Result](
    lambda result: sum(result.lost.values()),
    ("episodes", "not accepted"),
    details=lambda result: tuple(f"{count} {status}" for status, count in result.lost.items()),
)
COST_CELLS = Column[Result](
    lambda result: result.found.cost_cells,
    ("mean cost", "cells"),
    ("mean_cost_cells", "cost_cells_low", "cost_cells_high"),
    digits=1,
    details=lambda result: (),
)
COST_S = Column[Result](lambda result: result.found.cost_s, ("mean cost", "seconds"), ("mean_cost_s",), digits=2)
DECISION_S = Column[Result](
    lambda result: result.found.decision_s, ("planning", "per decision"), ("planning_s_per_decision",), text=seconds
)
PUBLISHED_COST = Column[Result](lambda result: _or_nan(result.published_cost), csv=("published_cost_cells",))
PUBLISHED_PLANNER = Column[Result](lambda result: result.published_name, csv=("published_planner",))
GAP_CLOSED = Column[Result](
    lambda result: result.summary.gap(result.cell, result.planner),
    ("gap to known", "closed"),
    ("gap_closed_percent", "gap_closed_low", "gap_closed_high"),
    digits=1,
    unit=" %",
)


def improvement_over(reference: str) -> Column[Result]:
    """The improvement over a reference, in percent of its mean cost."""
    name = f"improvement_over_{reference}"
    return Column(
        lambda result: result.summary.improvement(result.cell, result.planner, reference),
        ("improvement over", planner_label(reference)),
        (f"{name}_percent", f"{name}_low", f"{name}_high"),
        digits=1,
        unit=" %",
        higher_is_better=True,
    )


def pairs_with(reference: str) -> tuple[Column[Result], ...]:
    """How often each of the two was sooner on the trials that both finished, and the test."""

    def compared(name: str, value: Callable[[Comparison], int | float], missing: int | float) -> Column[Result]:
        def of_result(result: Result) -> int | float:
            comparison = result.summary.comparisons.get((result.cell, result.planner, reference))
            return value(comparison) if comparison else missing

        return Column(of_result, csv=(f"{name}_{reference}",))

    return (
        compared("pairs", lambda comparison: comparison.improvement.n, 0),
        compared("wins", lambda comparison: comparison.wins, 0),
        compared("ties", lambda comparison: comparison.ties, 0),
        compared("losses", lambda comparison: comparison.losses, 0),
        compared("p_value", lambda comparison: comparison.p_value, np.nan),
    )


def published_improvement_over(baseline: str) -> Column[Result]:
    """The published improvement over a baseline, in percent."""
    return Column(
        lambda result: _or_nan(result.published.improvement_of(result.planner, baseline, result.cell)),
        csv=(f"published_improvement_over_{baseline}_percent",),
    )


def csv_columns() -> tuple[Column[Result], ...]:
    """The columns of ``table.csv``, in order."""
    against: list[Column[Result]] = []
    for reference in REFERENCES:
        against += [improvement_over(reference), *pairs_with(reference)]
        against += [published_improvement_over(reference)] if reference in BASELINES else []
    return (
        *(SIZE_CLASS, ROBOTS, PLANNER, EPISODES, ACCEPTED, FAILED, ERROR, TIMEOUT),
        *(COST_CELLS, COST_S, DECISION_S, PUBLISHED_COST, PUBLISHED_PLANNER),
        *against,
        GAP_CLOSED,
    )


def report_columns(planners: Sequence[str]) -> tuple[Column[Result], ...]:
    """The columns of the report's table of all planners, without comparisons with planners that did not run."""
    return (
        *(EPISODES, NOT_ACCEPTED, COST_S, COST_CELLS),
        *(improvement_over(name) for name in REFERENCES if name in planners),
        *((GAP_CLOSED,) if KNOWN in planners else ()),
        DECISION_S,
    )


def result_table(summaries: Mapping[Variant, Summary], published: Published) -> pd.DataFrame:
    """One row per (size class, robots, planner), and per variant of a sweep.

    The last rows, of size class ``all`` and 0 robots, pool all cells: the headline quotes their improvements.

    Costs are means over the ``n`` accepted episodes; improvements, in percent, are over the ``pairs_`` trials that both
    planners finished.
    """
    columns = csv_columns()
    names = [name for column in columns for name in column.csv]
    swept = len(summaries) > 1 or any(summaries)
    records = []
    for variant, summary in summaries.items():
        for cell in (*summary.cells, EVERYTHING):
            for planner in summary.planners:
                if (cell, planner) in summary.planner_cells:
                    result = Result(summary, published, cell, planner)
                    parts = [column.record(result) for column in columns]
                    records.append({"sweep": variant} | {name: value for part in parts for name, value in part.items()})
    frame = pd.DataFrame(records, columns=["sweep", *names])
    return frame if swept and records else frame.drop(columns="sweep")


def planner_table(summary: Summary, published: Published) -> Table:
    """All planners over all episodes: how many finished, at what cost, improvements over the references, planning."""
    results = [(planner_label(name), Result(summary, published, EVERYTHING, name)) for name in summary.planners]
    return make_table(report_columns(summary.planners), results)


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value
