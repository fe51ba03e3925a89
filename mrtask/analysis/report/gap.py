"""What the gap is made of: the parts of a planner's mean cost above that of `known`.

Between a planner and `known` stand two others, each with less to hold against it: our search planner with as many
samples as were run, given the model's likelihoods and given the true ones. From step to step, on the same trials, the
means differ by

- *not knowing*: the search with the true likelihoods above `known`; as far as that search is optimal, nobody avoids it;
- *the model's error*: the search with the model's likelihoods above it with the true ones;
- *deciding*: the planner itself above the search with the model's likelihoods. For the search with fewer samples that
  is what its missing samples cost, for a baseline its myopia.

So the parts add up to the whole, whatever the costs are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from mrtask.analysis.page.tables import Entry, Row, Table, interval_text
from mrtask.analysis.page.tables import percent_entry
from mrtask.analysis.page.style import BLACK, BLUE, GREY, NOTHING, ORANGE, house_style, new_figure, planner_label
from mrtask.analysis.results.optimality import CellOptimality
from mrtask.analysis.results.roles import KNOWN
from mrtask.analysis.results.statistics import (
    ALL_TEAMS,
    EVERYTHING,
    Bootstrap,
    Cell,
    Estimate,
    Floats,
    Summary,
    cell_name,
    paired_costs,
)
from mrtask.names import counted
from mrtask.planning.planners import Role, planners_in_order, planners_with_role

SEARCH = planners_with_role(Role.OURS)[0]
PARTS = ("not knowing", "the model's error", "deciding")
PART_COLORS = (GREY, ORANGE, BLUE)
PANEL_IN = (3.5, 0.34, 1.3)
"""Width of a panel, height of a bar, height of all else."""


@dataclass(frozen=True)
class Ladder:
    """The planners that the parts are the steps between, and those whose gap is taken apart."""

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
        """All whose gap is taken apart."""
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
    """The ladder among planners that ran, by what the run says of them; None where a step is missing.

    Args:
        manifest: has ``planner_options``, ``behind`` (the planner that a name stands for) and ``likelihood`` (which it
            is given), each by planner.
    """
    behind, likelihood = manifest.get("behind"), manifest.get("likelihood")
    if not isinstance(behind, Mapping) or not isinstance(likelihood, Mapping) or KNOWN not in planners:
        return None
    with_model = [name for name in planners if _is_given(likelihood.get(name), "model") and name != KNOWN]
    with_truth = [name for name in planners if _is_given(likelihood.get(name), "truth") and name != KNOWN]
    options = manifest.get("planner_options", {})

    def most_samples(names: Sequence[str]) -> str | None:
        own = [name for name in names if behind.get(name) == SEARCH]
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


def _is_given(likelihood: object, source: str) -> bool:
    """Whether these are the likelihoods of that source as they are."""
    return likelihood == {"source": source, "uniform_mix": 0, "noise_sd": 0}


def gaps_of(
    episodes: pd.DataFrame, summary: Summary, ladder: Ladder, optimality: Sequence[CellOptimality] = ()
) -> list[Gap]:
    """The gaps of all planners: over everything, by size class, and by cell.

    All are over the trials that every planner of the ladder finished, so that what they share is the same for all.
    """
    costs = paired_costs(episodes, "cost_cells")[[KNOWN, ladder.truth, *ladder.planners]].dropna()
    trials = episodes.drop_duplicates("trial_id").set_index("trial_id").loc[costs.index]
    certified = {(one.cell, one.planner): one.gap_percent for one in optimality}
    gaps = []
    for cell in [EVERYTHING, *((name, ALL_TEAMS) for name in summary.size_classes), *summary.cells]:
        inside = np.ones(len(costs), dtype=bool)
        if cell != EVERYTHING:
            inside &= (trials["size_class"] == cell[0]).to_numpy()
            inside &= (cell[1] == ALL_TEAMS) | (trials["robots"] == cell[1]).to_numpy()
        of_cell = costs[inside]
        draws = Bootstrap(of_cell.to_numpy())
        gaps += [_gap(cell, planner, draws, list(of_cell.columns), ladder, certified) for planner in ladder.planners]
    return gaps


def _gap(
    cell: Cell,
    planner: str,
    draws: Bootstrap,
    columns: list[str],
    ladder: Ladder,
    certified: Mapping[tuple[Cell, str], Estimate],
) -> Gap:
    above = ladder.truth if planner in ladder.informed else ladder.model
    steps = (KNOWN, ladder.truth, above, planner)
    known = columns.index(KNOWN)

    def between(lower: str, upper: str) -> Estimate:
        return draws.estimate(_share_of_known, [known, columns.index(lower), columns.index(upper)])

    return Gap(
        cell=cell,
        planner=planner,
        whole=between(KNOWN, planner),
        parts=tuple(between(lower, upper) for lower, upper in pairwise(steps)),
        known_cells=float(draws.costs[:, known].mean()) if len(draws.costs) else float("nan"),
        certified=certified.get((cell, planner)),
    )


def _share_of_known(means: Floats) -> Floats:
    """From means [..., 3] of known, lower and upper: the difference of the last two in percent of the first."""
    return np.asarray(100 * (means[..., 2] - means[..., 1]) / means[..., 0])


def gap_table(gaps: Sequence[Gap]) -> Table:
    """The gaps with their parts, cell by cell."""
    columns = [("", "trials"), ("above known", "whole"), *(("of which", name) for name in PARTS)]
    certified = any(gap.certified for gap in gaps)
    if certified:
        columns.append(("certified", "above bound"))
    rows = []
    for cell in dict.fromkeys(gap.cell for gap in gaps):
        rows.append(Row("all" if cell == EVERYTHING else cell_name(cell), heading=True))
        for gap in (gap for gap in gaps if gap.cell == cell):
            entries = [Entry(str(gap.whole.n)), *(_entry(one, gap.known_cells) for one in (gap.whole, *gap.parts))]
            if certified:
                entries.append(percent_entry(gap.certified) if gap.certified else Entry(NOTHING))
            rows.append(Row(planner_label(gap.planner), tuple(entries)))
    return Table(tuple(columns), tuple(rows))


def _entry(estimate: Estimate, known_cells: float) -> Entry:
    if not estimate.defined:
        return Entry(NOTHING)
    cells = f"{estimate.value * known_cells / 100:.0f} cells"
    return Entry(f"{estimate.value:.1f} %", (interval_text(estimate), cells))


def gap_sentences(gaps: Sequence[Gap]) -> list[str]:
    """What the gaps over all trials are made of, in words."""
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


def draw_gaps(gaps: Sequence[Gap]) -> Figure | None:
    """Each cell's gaps as bars of their parts, a panel for each size class; None without a cell."""
    cells = [cell for cell in dict.fromkeys(gap.cell for gap in gaps) if cell[1] != ALL_TEAMS]
    classes = list(dict.fromkeys(size_class for size_class, _ in cells))
    if not cells:
        return None
    found = {(gap.cell, gap.planner): gap for gap in gaps if gap.whole.defined}
    planners = list(dict.fromkeys(gap.planner for gap in gaps))[::-1]
    teams = sorted({robots for _, robots in cells}, reverse=True)
    width_in, bar_in, rest_in = PANEL_IN
    with house_style():
        figure = new_figure(width_in * max(len(classes), 2), bar_in * (len(planners) + 1) * len(teams) + rest_in)
        panels = figure.subplots(1, len(classes), squeeze=False, sharex=True, sharey=True)[0]
        places = {
            (robots, planner): group * (len(planners) + 1) + line
            for group, robots in enumerate(teams)
            for line, planner in enumerate(planners)
        }
        for axes, size_class in zip(panels, classes, strict=True):
            for (robots, planner), place in places.items():
                if (gap := found.get(((size_class, robots), planner))) is not None:
                    _bar(axes, place, gap)
            for robots in teams:
                above, across = places[robots, planners[-1]] + 0.75, axes.get_yaxis_transform()
                axes.text(0.01, above, counted(robots, "robot"), transform=across, fontweight="bold", va="center")
            axes.axvline(0, color=BLACK, linewidth=0.8)
            axes.set(title=size_class, xlabel="above known (%)")
            axes.grid(axis="y", visible=False)
        panels[0].set_yticks(list(places.values()), [planner_label(planner) for _, planner in places])
        handles = [Patch(color=color, label=name) for name, color in zip(PARTS, PART_COLORS, strict=True)]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _bar(axes: Axes, place: float, gap: Gap) -> None:
    """Parts above zero go to the right, one after the other, and those below zero to the left."""
    ends = {True: 0.0, False: 0.0}
    for part, color in zip(gap.parts, PART_COLORS, strict=True):
        adds = part.value >= 0
        axes.barh(place, part.value, 0.8, left=ends[adds], color=color)
        ends[adds] += part.value
    axes.plot([gap.whole.value], [place], marker="|", markersize=9, markeredgewidth=1.8, color=BLACK)
