"""What the gap consists of: the parts of a planner's mean cost above that of `known`.

Between a planner and `known` stand two others, each with one handicap less: our search planner with the largest number
of samples that was run, once with the model's likelihoods and once with the true ones. From step to step, on the same
trials, the means differ by

- *not knowing*: the search with the true likelihoods above `known`; nobody avoids it, as far as that search is optimal;
- *the model's error*: the search with the model's likelihoods above it with the true ones;
- *deciding*: the planner itself above the search with the model's likelihoods. This is what missing samples cost a
  search with fewer of them, and what myopia costs a baseline.

So the parts add up to the whole, whatever the costs are.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from mrtask.analysis.page.charts import legend_below, panels, stacked_bars
from mrtask.analysis.page.style import BLACK, BLUE, GREY, NOTHING, ORANGE, house_style, planner_label
from mrtask.analysis.page.tables import Entry, Row, Table, block, cell_label, estimate_entry, interval_text
from mrtask.analysis.results.optimality import CellOptimality
from mrtask.analysis.results.roles import KNOWN, OUR_PLANNER
from mrtask.analysis.results.statistics import (
    ALL_TEAMS,
    EVERYTHING,
    Cell,
    Estimate,
    PairedCosts,
    Summary,
    homes_of,
    paired_costs,
)
from mrtask.arrays import Floats
from mrtask.names import counted
from mrtask.planning.planners import planners_in_order

PARTS = ("not knowing", "the model's error", "deciding")
PART_COLORS = (GREY, ORANGE, BLUE)
PANEL_IN = (3.5, 0.34, 1.3)
"""Width of a panel, height of a bar, height of all else."""


@dataclass(frozen=True)
class Ladder:
    """The planners between which the parts are the steps, and the planners whose gap is split."""

    truth: str
    """Our search with the true likelihoods."""
    model: str
    """Our search with the model's."""
    decided: tuple[str, ...]
    """Planners with the model's likelihoods."""
    informed: tuple[str, ...]
    """Other planners with the true likelihoods: the model's error is no part of their gap."""

    @property
    def planners(self) -> tuple[str, ...]:
        """All planners whose gap is split."""
        return (*self.decided, *self.informed)


@dataclass(frozen=True)
class Gap:
    """A planner's gap in one cell, in percent of `known`'s mean cost."""

    cell: Cell
    planner: str
    whole: Estimate
    parts: tuple[Estimate, ...]
    """Of `PARTS`; their values add up to that of the whole."""
    known_cells: float
    """The mean cost of `known` in grid cells."""
    certified: Estimate | None
    """By how much at most the planner's cost is above the least that any planner can reach under its belief, in percent
    of that; None where it was not measured."""


def find_ladder(manifest: Mapping[str, Any], planners: Sequence[str]) -> Ladder | None:
    """The ladder among the planners that ran, by what the run recorded; None where a step is missing.

    Args:
        manifest: has ``planner_options``, ``behind`` (the planner that a name stands for) and ``likelihood`` (which it
            is given), each by planner.
    """
    behind, likelihood = manifest.get("behind"), manifest.get("likelihood")
    if not isinstance(behind, Mapping) or not isinstance(likelihood, Mapping) or KNOWN not in planners:
        return None
    with_model = [name for name in planners if _is_plain(likelihood.get(name), "model") and name != KNOWN]
    with_truth = [name for name in planners if _is_plain(likelihood.get(name), "truth") and name != KNOWN]
    options = manifest.get("planner_options", {})

    def most_samples(names: Sequence[str]) -> str | None:
        own = [name for name in names if behind.get(name) == OUR_PLANNER]
        return max(own, key=lambda name: options.get(name, {}).get("samples", 0), default=None)

    model, truth = most_samples(with_model), most_samples(with_truth)
    if model is None or truth is None:
        return None
    order = planners_in_order(planners)
    return Ladder(
        truth,
        model,
        tuple(name for name in order if name in with_model),
        tuple(name for name in order if name in with_truth and name != truth),
    )


def _is_plain(likelihood: object, source: str) -> bool:
    """Whether these are the unchanged likelihoods of that source."""
    return likelihood == {"source": source, "uniform_mix": 0, "noise_sd": 0}


def gaps_of(
    episodes: pd.DataFrame, summary: Summary, ladder: Ladder, optimality: Sequence[CellOptimality] = ()
) -> list[Gap]:
    """The gaps of all planners: over everything, by size class, and by cell.

    All are over the trials that every planner of the ladder finished, so that what they share is the same for all.
    """
    costs = paired_costs(episodes, "cost_cells")[[KNOWN, ladder.truth, *ladder.planners]].dropna()
    homes = homes_of(episodes)
    trials = episodes.drop_duplicates("trial_id").set_index("trial_id").loc[costs.index]
    certified = {(one.cell, one.planner): one.gap_percent for one in optimality}
    gaps = []
    for cell in [EVERYTHING, *((name, ALL_TEAMS) for name in summary.size_classes), *summary.cells]:
        inside = pd.Series(True, index=costs.index)
        if cell != EVERYTHING:
            inside &= trials["size_class"] == cell[0]
        if cell[1] != ALL_TEAMS:
            inside &= trials["robots"] == cell[1]
        paired = PairedCosts(costs[inside], homes)
        for planner in ladder.planners:
            above = ladder.truth if planner in ladder.informed else ladder.model
            steps = (KNOWN, ladder.truth, above, planner)
            whole, *parts = (
                paired.estimate(_share_of_known, [KNOWN, *step]) for step in ((KNOWN, planner), *pairwise(steps))
            )
            known_cells = float(paired.costs[KNOWN].mean())
            gaps.append(Gap(cell, planner, whole, tuple(parts), known_cells, certified.get((cell, planner))))
    return gaps


def _share_of_known(means: Floats) -> Floats:
    """From means [..., 3] of known, lower and upper: the difference of the last two in percent of the first."""
    return np.asarray(100 * (means[..., 2] - means[..., 1]) / means[..., 0])


def gap_table(gaps: Sequence[Gap]) -> Table:
    """The gaps with their parts, cell by cell."""
    certified = [("certified", "above bound")] if any(gap.certified for gap in gaps) else []

    def entries(gap: Gap) -> Iterable[Entry]:
        yield Entry(str(gap.whole.n))
        for estimate in (gap.whole, *gap.parts):
            entry = estimate_entry(estimate)
            cells = f"{estimate.value * gap.known_cells / 100:.0f} cells"
            yield replace(entry, details=(*entry.details, cells)) if estimate.defined else entry
        if certified:
            yield estimate_entry(gap.certified) if gap.certified else Entry(NOTHING)

    rows: list[Row] = []
    for cell in dict.fromkeys(gap.cell for gap in gaps):
        own = ((planner_label(gap.planner), entries(gap)) for gap in gaps if gap.cell == cell)
        rows += block(cell_label(cell), own)
    columns = [("", "trials"), ("above known", "whole"), *(("of which", name) for name in PARTS), *certified]
    return Table(tuple(columns), tuple(rows))


def gap_sentences(gaps: Sequence[Gap]) -> list[str]:
    """The parts of the gaps over all trials, in words."""
    sentences = []
    for gap in gaps:
        if gap.cell == EVERYTHING and gap.whole.defined:
            parts = [f"{_said(part)} {name}" for name, part in zip(PARTS, gap.parts, strict=True)]
            whole = f"costs {_said(gap.whole)} more than knowing everything"
            sentences.append(f"{planner_label(gap.planner)} {whole}: {', '.join(parts)}.")
    return sentences


def _said(estimate: Estimate) -> str:
    interval = f" {interval_text(estimate)}" if estimate.has_interval else ""
    return f"{estimate.value:.1f} %{interval}"


@house_style()
def draw_gaps(gaps: Sequence[Gap]) -> Figure | None:
    """Each cell's gaps as bars of their parts, a panel for each size class; None without a cell."""
    cells = [cell for cell in dict.fromkeys(gap.cell for gap in gaps) if cell[1] != ALL_TEAMS]
    if not cells:
        return None
    classes = list(dict.fromkeys(size_class for size_class, _ in cells))
    planners = list(dict.fromkeys(gap.planner for gap in gaps))[::-1]
    teams = sorted({robots for _, robots in cells}, reverse=True)
    lines = len(planners) + 1
    places = {(n, name): i * lines + line for i, n in enumerate(teams) for line, name in enumerate(planners)}
    width_in, bar_in, rest_in = PANEL_IN
    size_in = width_in * max(len(classes), 2), bar_in * lines * len(teams) + rest_in
    figure, (line_of_panels,) = panels(*size_in, columns=len(classes), sharex=True, sharey=True)
    for axes, size_class in zip(line_of_panels, classes, strict=True):
        shown = [gap for gap in gaps if gap.cell in cells and gap.cell[0] == size_class and gap.whole.defined]
        at = [places[gap.cell[1], gap.planner] for gap in shown]
        parts = np.array([[part.value for part in gap.parts] for gap in shown]).reshape(-1, len(PARTS)).T
        stacked_bars(axes, at, parts, PART_COLORS, height=0.8)
        wholes = [gap.whole.value for gap in shown]
        axes.plot(wholes, at, linestyle="none", marker="|", markersize=9, markeredgewidth=1.8, color=BLACK)
        for robots in teams:
            above, across = places[robots, planners[-1]] + 0.75, axes.get_yaxis_transform()
            axes.text(0.01, above, counted(robots, "robot"), transform=across, fontweight="bold", va="center")
        axes.axvline(0, color=BLACK, linewidth=0.8)
        axes.set(title=size_class, xlabel="above known (%)")
        axes.grid(axis="y", visible=False)
    line_of_panels[0].set_yticks(list(places.values()), [planner_label(planner) for _, planner in places])
    legend_below(figure, [Patch(color=color, label=name) for name, color in zip(PARTS, PART_COLORS, strict=True)])
    return figure
