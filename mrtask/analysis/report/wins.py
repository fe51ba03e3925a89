"""How often a planner finishes sooner than another on the same trial: wins, ties, losses, and whether they are chance.

The share of wins is among the trials that one of the two won, with Wilson's interval; the sign test is exact and leaves
ties out too (both are SciPy's). Where homes repeat, the interval comes from resampling homes, and the test counts the
homes in which one of the two won more trials. They measure how often, not by how much: a planner may win most trials
and lose on average.
"""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.stats import binomtest

from mrtask.analysis.page.charts import WIDTH_IN, legend_below, panels, stacked_bars
from mrtask.analysis.page.style import BLACK, LIGHT_GREY, NOTHING, ORANGE, house_style, planner_label, planner_looks
from mrtask.analysis.page.tables import Column, Table, cell_label, make_table
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
)

ROW_IN = 0.27
MIN_LABELLED_PERCENT = 9.0
"""Narrower parts of a bar carry no number."""


def share_sooner(pair: Comparison) -> Estimate:
    """The share of decided trials that the planner won, in percent with its interval."""
    if pair.by_home is not None:
        return pair.by_home.share_sooner
    return share(pair.wins, pair.wins + pair.losses)


def share(count: int, trials: int) -> Estimate:
    """A proportion in percent with Wilson's interval; `UNDEFINED` without trials."""
    if trials == 0:
        return UNDEFINED
    interval = binomtest(count, trials).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(100 * count / trials, 100 * interval.low, 100 * interval.high, trials)


def sign_test(pair: Comparison) -> float:
    """The two-sided p value of the exact sign test that both win equally often; NaN where nobody won."""
    won, lost = (pair.wins, pair.losses) if pair.by_home is None else (pair.by_home.won, pair.by_home.lost)
    return float(binomtest(won, won + lost).pvalue) if won + lost else np.nan


def p_value_text(value: float) -> str:
    """The p value with three digits."""
    return NOTHING if not np.isfinite(value) else "< 0.001" if value < 0.001 else f"{value:.3f}"


def without_ties(pair: Comparison) -> tuple[str, ...]:
    """Wilcoxon's p value without the equal pairs, where leaving them out changes what is significant."""
    return (f"{p_value_text(pair.p_value_without_ties)} without ties",) if pair.ties_decide else ()


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
    Column[Comparison](lambda pair: pair.p_value, ("mean cost", "Wilcoxon p"), text=p_value_text, details=without_ties),
)


def compared_cells(summary: Summary, planner: str, reference: str) -> list[tuple[Cell, Comparison]]:
    """All cells, then size classes over all teams, then everything, where the two are compared."""
    cells = [*summary.cells, *((name, ALL_TEAMS) for name in summary.size_classes), EVERYTHING]
    found = ((cell, summary.comparisons.get((cell, planner, reference))) for cell in cells)
    return [(cell, pair) for cell, pair in found if pair is not None]


def pair_table(summary: Summary, planner: str | None) -> Table | None:
    """``planner`` against every reference, cell by cell: pairs, wins, ties, losses, tests; None without a pair."""
    rows: list[str | tuple[str, Comparison]] = []
    for reference in REFERENCES:
        if planner is not None and (pairs := compared_cells(summary, planner, reference)):
            rows += [f"against {planner_label(reference)}", *((cell_label(cell), pair) for cell, pair in pairs)]
    return make_table(PAIR_COLUMNS, rows) if rows else None


@house_style()
def draw_wins(summary: Summary, planner: str) -> Figure | None:
    """The shares of trials that ``planner`` won, tied and lost, a panel per other planner, a bar per cell."""
    found = {name: dict(compared_cells(summary, planner, name)) for name in REFERENCES}
    shown = {name: pairs for name, pairs in found.items() if any(pair.improvement.n for pair in pairs.values())}
    if not shown:
        return None
    present = dict.fromkeys(cell for pairs in shown.values() for cell in pairs)
    cells = [cell for cell in present if cell == EVERYTHING or cell[1] != ALL_TEAMS]
    label = planner_label(planner)
    colors = {f"{label} sooner": planner_looks([planner])[planner][0], "equal": LIGHT_GREY, f"{label} later": ORANGE}
    figure, (line,) = panels(WIDTH_IN, ROW_IN * len(cells) + 1.2, columns=len(shown), sharey=True)
    for axes, (reference, pairs) in zip(line, shown.items(), strict=True):
        bars = {place: pairs[cell] for place, cell in enumerate(cells) if cell in pairs and pairs[cell].improvement.n}
        shares = np.array([[pair.wins, pair.ties, pair.losses] for pair in bars.values()]).T
        percent = 100 * shares / shares.sum(axis=0)
        parts = stacked_bars(axes, list(bars), percent, list(colors.values()), height=0.78)
        for part, ink in zip(parts, ("white", BLACK, BLACK), strict=True):
            axes.bar_label(part, fmt=_written, label_type="center", color=ink, fontsize=7)
        axes.set(title=f"against {planner_label(reference)}", xlabel="trials (%)", xlim=(0, 100))
        axes.grid(visible=False)
    line[0].set_yticks(range(len(cells)), list(map(cell_label, cells)))
    line[0].set_ylim(len(cells) - 0.4, -0.6)
    legend_below(figure, [Patch(color=color, label=name) for name, color in colors.items()])
    return figure


def _written(percent: float) -> str:
    return f"{percent:.0f}" if percent >= MIN_LABELLED_PERCENT else ""
