"""The answer in words, computed from the data: does the planner beat the baselines, and the published results?

Every sentence stays true when planners, cells or finished episodes are missing, and when the planner loses.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from mrtask.analysis.page.rendering import Findings
from mrtask.analysis.page.style import planner_label
from mrtask.analysis.results.published import Published
from mrtask.analysis.results.roles import BASELINES, INFORMED_BASELINE, REFERENCES
from mrtask.analysis.results.statistics import EVERYTHING, MIN_TRIALS_FOR_INTERVAL, Cell, Estimate, Summary, cell_name
from mrtask.names import counted

MIN_PAIRS = 30
"""With fewer trials the interval of a cell says little."""
MAX_NAMED_CELLS = 3
MIN_FINISHED_SHARE = 0.95
"""A planner that finished a smaller share of its episodes is named."""
SINGLE_VALUED = ("config_hash", "code_version", "model_version")
"""Columns that have one value in a single experiment."""


def find(summary: Summary, published: Published, planner: str | None) -> Findings:
    """The findings on ``planner`` against the baselines that ran."""
    if planner is None:
        return Findings("No answer", "There are no episodes yet.")
    name = planner_label(planner)
    others = [baseline for baseline in BASELINES if baseline != planner]
    shown = _pooled(summary, planner)
    warnings = (*partial_results(summary), *_warnings(summary, planner))
    said = headline(summary, planner)
    if said is None:
        reason = f"none of the baselines {' and '.join(others)} ran"
        if any(summary.compared(planner, baseline) for baseline in others):
            reason = "no trial was finished by both it and a baseline"
        return Findings("No answer", f"{name} cannot be compared with the baselines: {reason}.", warnings=warnings)
    sentences = [trial_by_trial(summary, planner, baseline) for baseline in reversed(shown)]
    sentences += [_cells_sentence(summary, planner, b) for b in reversed(shown)]
    sentences += _published_sentences(summary, published, planner, list(shown))
    sentences += _reference_sentences(summary, planner)
    return Findings(_verdict(list(shown.values())), said, tuple(sentences), warnings)


def headline(summary: Summary, planner: str) -> str | None:
    """By how much the planner's mean time differs from the baselines' over all cells; None where none is comparable."""
    shown = _pooled(summary, planner)
    if not shown:
        return None
    # The harder baseline, which a reader asks about first, opens the sentence.
    parts = [f"{_than(estimate, b)} ({_interval(estimate)})" for b, estimate in reversed(shown.items())]
    return f"Over {_trials(shown)}, {planner_label(planner)}'s mean time is {' and '.join(parts)}."


def _pooled(summary: Summary, planner: str) -> dict[str, Estimate]:
    """The improvements over all cells, over each baseline with which the planner can be compared."""
    found = {name: summary.improvement(EVERYTHING, planner, name) for name in BASELINES if name != planner}
    return {name: estimate for name, estimate in found.items() if estimate.defined}


def partial_results(summary: Summary) -> tuple[str, ...]:
    """Warnings about missing results: planners that finished few episodes, cells they did not run, a single trial."""
    warnings = []
    for name in summary.planners:
        whole, label = summary.planner_cells[EVERYTHING, name], planner_label(name)
        ran = {cell: found for cell in summary.cells if (found := summary.planner_cells.get((cell, name)))}
        emptied = [cell for cell, found in ran.items() if not found.accepted]
        finished = f"{label} finished {whole.accepted} of {counted(whole.episodes, 'episode')}"
        if not whole.accepted:
            warnings.append(f"{label} finished none of its {counted(whole.episodes, 'episode')}: it has no mean cost.")
        elif emptied:
            warnings.append(f"{finished} and none in {_named(emptied)}: means over all cells leave these out.")
        elif whole.accepted < MIN_FINISHED_SHARE * whole.episodes:
            warnings.append(f"{finished}: the others are in no mean.")
        if absent := [cell for cell in summary.cells if cell not in ran]:
            warnings.append(f"{label} did not run in {_named(absent)}: it is compared on fewer trials.")
    if all(summary.planner_cells[EVERYTHING, name].episodes == 1 for name in summary.planners):
        warnings.append("There is a single trial: it shows what happened once, not what to expect.")
    return tuple(warnings)


def _named(cells: Sequence[Cell]) -> str:
    return "; ".join(map(cell_name, cells)) if len(cells) <= MAX_NAMED_CELLS else f"{len(cells)} cells"


def mixture_warnings(episodes: pd.DataFrame) -> list[str]:
    """Warn where the rows of one variant come from several configurations, code versions or model versions.

    Each planner has its own configuration, and so has each of the cells of a sweep that together make one variant.
    """
    warnings = []
    in_sweep = "sweep" in episodes.columns and episodes["sweep"].nunique() > 1
    for column in SINGLE_VALUED:
        if column in episodes.columns and not (in_sweep and column == "config_hash"):
            known = episodes.dropna(subset=column)
            values = sorted(known[column].astype(str).unique())
            of_planner = known.groupby("planner")[column].nunique() if column == "config_hash" else None
            if len(values) > 1 and (of_planner is None or of_planner.max() > 1):
                shown = ", ".join(values[:4]) + (", ..." if len(values) > 4 else "")
                warnings.append(f"The episodes mix {len(values)} values of {column} ({shown}); compare with care.")
    return warnings


def percent(value: float) -> str:
    """A percentage with one decimal."""
    return f"{value:.1f}\N{NO-BREAK SPACE}%"


def _verdict(estimates: Sequence[Estimate]) -> str:
    better = [estimate.low > 0 for estimate in estimates]
    if all(better):
        return "Yes"
    if any(better):
        return "Only in part"
    return "No" if any(estimate.high < 0 for estimate in estimates) else "Not shown"


def trial_by_trial(summary: Summary, planner: str, baseline: str) -> str:
    """What the mean hides: the median trial, and how many trials are ties or take the planner longer."""
    pair = summary.comparisons[EVERYTHING, planner, baseline]
    ties, later = (f"{pair.percent_of_pairs(count):.0f}\N{NO-BREAK SPACE}%" for count in (pair.ties, pair.losses))
    return (
        f"Trial by trial against {planner_label(baseline)}: the median saving is {percent(pair.median_percent)}, "
        f"{ties} are ties, and in {later} it is later."
    )


def _than(estimate: Estimate, other: str) -> str:
    """``30.5 % lower than learned_myopic's``."""
    if round(estimate.value, 1) == 0:
        return f"equal to {planner_label(other)}'s"
    return f"{percent(abs(estimate.value))} {'lower' if estimate.value > 0 else 'higher'} than {planner_label(other)}'s"


def _interval(estimate: Estimate) -> str:
    if not estimate.has_interval:
        return "too few trials for an interval"
    sign = "" if estimate.value >= 0 else f"improvement {percent(estimate.value)}, "
    return f"{sign}95 % interval {estimate.low:.1f} to {estimate.high:.1f}"


def _trials(estimates: dict[str, Estimate]) -> str:
    counts = sorted({estimate.n for estimate in estimates.values()})
    text = f"{' and '.join(map(str, counts))} paired trial{'s' if counts != [1] else ''}"
    homes = max(estimate.homes for estimate in estimates.values())
    return f"{text} in {counted(homes, 'home')}" if homes < counts[-1] else text


def _cells_sentence(summary: Summary, planner: str, baseline: str) -> str:
    estimates = {cell: summary.improvement(cell, planner, baseline) for cell in summary.cells}
    found = {cell: estimate for cell, estimate in estimates.items() if estimate.defined}
    ahead = sum(estimate.value > 0 for estimate in found.values())
    clear = sum(estimate.low > 0 for estimate in found.values())
    behind = sum(estimate.high < 0 for estimate in found.values())
    least = min(found, key=lambda cell: found[cell].value)
    most = max(found, key=lambda cell: found[cell].value)
    text = (
        f"Against {planner_label(baseline)} it is better in {ahead} of {counted(len(found), 'cell')} "
        f"of size class and team size, clearly (the interval excludes zero) in {clear}"
    )
    text += f", and clearly worse in {behind}" if behind else ""
    if least != most:
        low, high = percent(found[least].value), percent(found[most].value)
        text += f"; from {low} ({cell_name(least)}) to {high} ({cell_name(most)})"
    return text + "."


def _published_sentences(summary: Summary, published: Published, planner: str, baselines: Sequence[str]) -> list[str]:
    pairs = [
        (estimate, printed)
        for baseline in baselines
        for cell in summary.cells
        if (printed := published.improvement_of(planner, baseline, cell)) is not None
        and (estimate := summary.improvement(cell, planner, baseline)).defined
    ]
    if not pairs:
        return []
    above = sum(estimate.value > printed for estimate, printed in pairs)
    clearly_above = sum(estimate.low > printed for estimate, printed in pairs)
    clearly_below = sum(estimate.high < printed for estimate, printed in pairs)
    ours = np.mean([estimate.value for estimate, _ in pairs])
    theirs = np.mean([printed for _, printed in pairs])
    return [
        f"Beside the published planner: of {counted(len(pairs), 'published improvement')} for these cells, ours is "
        f"above {above} (its whole interval in {clearly_above}) and below {len(pairs) - above} (whole interval in "
        f"{clearly_below}); on average {percent(float(ours))} against {percent(float(theirs))} published."
    ]


def _reference_sentences(summary: Summary, planner: str) -> list[str]:
    sentences = []
    for reference in [name for name in REFERENCES if name not in BASELINES]:
        estimate = summary.improvement(EVERYTHING, planner, reference)
        if estimate.defined:
            sentences.append(f"Its mean time is {_than(estimate, reference)} ({_interval(estimate)}).")
    gap = summary.gap(EVERYTHING, planner)
    if gap.defined:
        interval = f" (95 % interval {gap.low:.1f} to {gap.high:.1f})" if gap.has_interval else ""
        sentences.append(
            f"Of what knowing all contents would save over {INFORMED_BASELINE}, "
            f"it saves {percent(gap.value)}{interval}."
        )
    return sentences


def _warnings(summary: Summary, planner: str) -> tuple[str, ...]:
    warnings = []
    for status in ("error", "timeout"):
        counts = {name: summary.planner_cells[EVERYTHING, name].counts[status] for name in summary.planners}
        if total := sum(counts.values()):
            shares = ", ".join(f"{planner_label(name)} {count}" for name, count in counts.items() if count)
            warnings.append(f"{counted(total, 'episode')} ended with status {status} ({shares}).")
    for baseline in BASELINES:
        comparison = summary.comparisons.get((EVERYTHING, planner, baseline))
        if comparison and comparison.only_baseline:
            warnings.append(
                f"{planner_label(baseline)} finished {counted(comparison.only_baseline, 'trial')} that "
                f"{planner_label(planner)} did not: they are in no comparison, which flatters the latter."
            )
    warnings += _few_homes(summary, planner)
    pairs = {
        cell: pair.improvement.n
        for baseline in BASELINES
        for cell in summary.cells
        if (pair := summary.comparisons.get((cell, planner, baseline)))
    }
    few = [cell for cell, n in pairs.items() if n < MIN_PAIRS]
    if few:
        fewest = min(few, key=lambda cell: pairs[cell])
        warnings.append(
            f"Fewer than {MIN_PAIRS} paired trials in {len(few)} of {counted(len(pairs), 'cell')} (the fewest: "
            f"{pairs[fewest]} in {cell_name(fewest)}): intervals there are rough, "
            f"and below {MIN_TRIALS_FOR_INTERVAL} trials there are none."
        )
    return tuple(warnings)


def _few_homes(summary: Summary, planner: str) -> list[str]:
    """Warn where there are too few homes to say anything of others."""
    trials = max((summary.improvement(EVERYTHING, planner, baseline) for baseline in BASELINES), key=lambda one: one.n)
    if trials.n < MIN_TRIALS_FOR_INTERVAL or trials.homes >= min(trials.n, MIN_TRIALS_FOR_INTERVAL):
        return []
    if trials.homes == 1:
        return ["All trials are in one home: intervals are about tasks in this home and say nothing of other homes."]
    few = f"The trials are in {trials.homes} homes only"
    return [f"{few}: intervals resample homes, and below {MIN_TRIALS_FOR_INTERVAL} homes there are none."]
