"""How often a planner is sooner than another on the same trial: wins, ties, losses, and whether they are luck.

The share of wins is among the trials that one of the two won, with Wilson's interval; the sign test is exact and leaves
ties out too (both SciPy's). They ask how often, not by how much: a planner may win most trials and lose on average.
"""

import numpy as np
from scipy.stats import binomtest

from mrtask.analysis.page.tables import Column, Table, make_table
from mrtask.analysis.page.style import NOTHING, planner_label
from mrtask.analysis.results.roles import REFERENCES
from mrtask.analysis.results.statistics import (
    ALL_TEAMS,
    CONFIDENCE,
    EVERYTHING,
    UNDEFINED,
    Cell,
    Comparison,
    Estimate,
    Summary,
    cell_name,
)


def share_sooner(pair: Comparison) -> Estimate:
    """Of the trials that one of the two won, the share that the planner won, in percent with Wilson's interval."""
    return share(pair.wins, pair.wins + pair.losses)


def share(count: int, trials: int) -> Estimate:
    """A proportion in percent with Wilson's interval; `UNDEFINED` without trials."""
    if trials == 0:
        return UNDEFINED
    interval = binomtest(count, trials).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(100 * count / trials, 100 * interval.low, 100 * interval.high, trials)


def sign_test(pair: Comparison) -> float:
    """The two-sided p value of the exact sign test that both win equally often; NaN where nobody won."""
    decided = pair.wins + pair.losses
    return float(binomtest(pair.wins, decided).pvalue) if decided else np.nan


def p_value_text(value: float) -> str:
    """Three digits."""
    return NOTHING if not np.isfinite(value) else "< 0.001" if value < 0.001 else f"{value:.3f}"


PAIR_COLUMNS = (
    Column[Comparison](lambda pair: pair.improvement.n, ("trials", "paired")),
    Column[Comparison](lambda pair: pair.only_planner, ("trials", "only it finished")),
    Column[Comparison](lambda pair: pair.only_baseline, ("trials", "only the other")),
    Column[Comparison](lambda pair: pair.wins, ("planner is", "sooner")),
    Column[Comparison](lambda pair: pair.ties, ("planner is", "equal")),
    Column[Comparison](lambda pair: pair.losses, ("planner is", "later")),
    Column[Comparison](share_sooner, ("of those decided", "sooner, 95 %"), unit=" %"),
    Column[Comparison](sign_test, ("of those decided", "sign test p"), text=p_value_text),
    Column[Comparison](
        lambda pair: pair.improvement, ("mean cost", "improvement, 95 %"), digits=1, unit=" %", higher_is_better=True
    ),
    Column[Comparison](lambda pair: pair.p_value, ("mean cost", "Wilcoxon p"), text=p_value_text),
)


def compared_cells(summary: Summary, planner: str, reference: str) -> list[tuple[Cell, Comparison]]:
    """All cells, then size classes over all teams, then everything, where the two are compared."""
    cells = [*summary.cells, *((name, ALL_TEAMS) for name in summary.size_classes), EVERYTHING]
    found = ((cell, summary.comparisons.get((cell, planner, reference))) for cell in cells)
    return [(cell, pair) for cell, pair in found if pair is not None]


def pair_table(summary: Summary, planner: str | None) -> Table | None:
    """``planner`` against every reference, cell by cell: pairs, wins, ties, losses, tests; None where there is none."""
    rows: list[str | tuple[str, Comparison]] = []
    for reference in REFERENCES:
        lines = [
            ("all" if cell == EVERYTHING else cell_name(cell), pair)
            for cell, pair in (compared_cells(summary, planner, reference) if planner is not None else ())
        ]
        if lines:
            rows += [f"against {planner_label(reference)}", *lines]
    return make_table(PAIR_COLUMNS, rows) if rows else None
