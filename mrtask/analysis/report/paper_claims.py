"""The paper's claims, each judged on a run's rows: does it hold here, and which number shows it?

A claim about every cell holds only where each cell's 95 % interval is above zero, which needs no correction for the
number of cells. One cell whose whole interval is below zero contradicts it; with nine cells this happens a little more
often by chance, so the cell is named.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np

from mrtask.analysis.page.style import planner_label
from mrtask.analysis.page.tables import Entry, Row, Table
from mrtask.analysis.report.coordination import Coordination
from mrtask.analysis.report.real_world import scenario_name, simulated_trials
from mrtask.analysis.report.report_data import ReportData
from mrtask.analysis.report.wins import share
from mrtask.analysis.results.published import Cell, Published, RealWorldTrial
from mrtask.analysis.results.roles import BASELINES, REFERENCES
from mrtask.analysis.results.statistics import (
    CONFIDENCE,
    SEED,
    Bootstrap,
    Estimate,
    Summary,
    cell_name,
    homes_of,
    improvement_of_means,
    paired_costs,
)
from mrtask.homes.home import SIZE_CLASSES
from mrtask.names import counted

MYOPIC = "nonlearned_myopic"
"""The planner that the paper's robots ran in the apartments for comparison."""


class Verdict(Enum):
    """The verdict of a run on a claim."""

    HOLDS = "yes"
    NOT_SHOWN = "not shown"
    CONTRADICTED = "contradicted"
    NOT_IN_RUN = "not in this run"


TONES = {Verdict.HOLDS: "good", Verdict.CONTRADICTED: "bad"}


@dataclass(frozen=True)
class Judged:
    """A verdict and the number that decides it."""

    verdict: Verdict
    because: tuple[str, ...]
    """The reasons, one per line."""


@dataclass(frozen=True)
class Evidence:
    """A place on the page or beside it, or a command that shows the evidence."""

    label: str
    href: str | None = None
    """None: the label is a command."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper with a verdict on each planner it is judged on."""

    text: str
    judged: Mapping[str, Judged]
    evidence: tuple[Evidence, ...]


def judge_claims(data: ReportData) -> list[Claim]:
    """All claims in the paper's order."""
    planners = data.judged
    return [
        *(_better_in_every_cell(data, planners, baseline) for baseline in BASELINES),
        _grows_with_size(data, planners),
        _waits_and_goes_on(data, planners),
        *(_apartment(data, planners, trial) for trial in data.published.real_world),
    ]


def count_verdicts(claims: Sequence[Claim], planner: str) -> str:
    """``3 yes, 1 not shown``"""
    found = [claim.judged[planner].verdict for claim in claims]
    return ", ".join(f"{found.count(verdict)} {verdict.value}" for verdict in Verdict if verdict in found)


def claims_table(claims: Sequence[Claim], planners: Sequence[str]) -> Table:
    """The verdicts side by side, each with the number that decides it."""
    return Table(
        tuple(("", planner_label(name)) for name in planners),
        tuple(Row(claim.text, tuple(_entry(claim.judged[name]) for name in planners)) for claim in claims),
    )


def _entry(judged: Judged) -> Entry:
    return Entry(judged.verdict.value, judged.because, TONES.get(judged.verdict, ""))


def _better_in_every_cell(data: ReportData, planners: Sequence[str], baseline: str) -> Claim:
    compared = data.planner is not None and any(data.summary.compared(data.planner, name) for name in REFERENCES)
    printed = [value for (name, _), value in data.published.improvement_percent.items() if name == baseline]
    return Claim(
        f"It needs less time than {planner_label(baseline)} in every cell of home size and team size (the paper: by "
        f"{min(printed):.1f} to {max(printed):.1f} %)",
        {name: judge_cells(data.summary, data.published, name, baseline) for name in planners},
        (Evidence("the table", "#table"), *((Evidence("wins and tests", "#wins"),) if compared else ())),
    )


def judge_cells(summary: Summary, published: Published, planner: str, baseline: str) -> Judged:
    """Whether a planner is clearly better than a baseline in every cell of the paper."""
    cells = [cell for name, cell in published.improvement_percent if name == baseline]
    found = {cell: estimate for cell in cells if (estimate := summary.improvement(cell, planner, baseline)).defined}
    if not found:
        return _not_run(summary, planner, baseline)
    clear = [cell for cell, estimate in found.items() if estimate.low > 0]
    worse = [cell for cell, estimate in found.items() if estimate.high < 0]
    least = min(found, key=lambda cell: (found[cell].low if found[cell].has_interval else -np.inf, found[cell].value))
    parts = [f"clearly less in {len(clear)} of {counted(len(cells), 'cell')}"]
    parts += [f"clearly more in {_named(worse)}"] if worse else []
    parts += [f"{counted(len(cells) - len(found), 'cell')} not run"] if len(found) < len(cells) else []
    parts.append(f"least sure in {cell_name(least)}: {_percent(found[least])}")
    lost = sum(summary.comparisons[cell, planner, baseline].only_baseline for cell in found)
    parts += [f"{counted(lost, 'trial')} that only {planner_label(baseline)} finished left out"] if lost else []
    holds = len(clear) == len(cells) and not lost
    verdict = Verdict.CONTRADICTED if worse else Verdict.HOLDS if holds else Verdict.NOT_SHOWN
    return Judged(verdict, tuple(parts))


def _grows_with_size(data: ReportData, planners: Sequence[str]) -> Claim:
    return Claim(
        "What it saves grows with the size of the home, against both baselines",
        {name: judge_growth(data, name) for name in planners},
        (Evidence("improvement by home size", "#figures"), Evidence("the table", "#table")),
    )


def judge_growth(data: ReportData, planner: str) -> Judged:
    """Whether a planner's improvement over both baselines is clearly larger in each next size class."""
    summary = data.summary
    if missing := [name for name in (planner, *BASELINES) if name not in summary.planners]:
        return Judged(Verdict.NOT_IN_RUN, (f"{_named_planners(missing)} did not run",))
    classes = [name for name in SIZE_CLASSES if name in summary.size_classes]
    draws = {}
    for number, name in enumerate(classes):
        # Trials that the planner and both baselines finished, in this order of columns.
        rows = data.rows[data.rows["size_class"] == name]
        costs = paired_costs(rows).reindex(columns=[planner, *BASELINES]).dropna()
        if len(costs):
            draws[name] = Bootstrap(costs.to_numpy(), homes_of(rows)[costs.index].to_numpy(), seed=SEED + number)
    if len(draws) < 2:
        return Judged(Verdict.NOT_IN_RUN, ("homes of fewer than two size classes",))
    steps: list[Estimate] = []
    parts = []
    for column, baseline in enumerate(BASELINES, 1):
        texts = []
        for (small, first), (large, second) in pairwise(draws.items()):
            step = improvement_growth(first, second, column)
            steps.append(step)
            texts.append(f"{small} to {large} {step.value:+.1f} points {_interval(step)}")
        parts.append(f"over {planner_label(baseline)}: {', '.join(texts)}")
    parts += [f"only {' and '.join(draws)} homes ran"] if len(draws) < len(SIZE_CLASSES) else []
    shrinks = any(step.high < 0 for step in steps)
    holds = all(step.low > 0 for step in steps) and len(draws) == len(SIZE_CLASSES)
    verdict = Verdict.CONTRADICTED if shrinks else Verdict.HOLDS if holds else Verdict.NOT_SHOWN
    return Judged(verdict, tuple(parts))


def improvement_growth(first: Bootstrap, second: Bootstrap, column: int) -> Estimate:
    """By how many points the improvement is larger in the second group of trials than in the first.

    The groups share no home, so each is resampled by itself; the interval is the plain one of percentiles.

    Args:
        column: the baseline's column; the planner's is 0.
    """
    n, homes = min(len(first.costs), len(second.costs)), min(first.homes, second.homes)
    values = [float(improvement_of_means(group.costs[:, [0, column]].mean(axis=0))) for group in (first, second)]
    drawn = [group.resampled(improvement_of_means, [0, column]) for group in (first, second)]
    value, differences = values[1] - values[0], drawn[1] - drawn[0]
    if not np.isfinite(value) or not np.isfinite(differences).all():
        return Estimate(value, np.nan, np.nan, n, homes)
    low, high = np.quantile(differences, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(value, float(low), float(high), n, homes)


def _waits_and_goes_on(data: ReportData, planners: Sequence[str]) -> Claim:
    found = {name: data.coordination.get(name) for name in planners}
    shown = found.get(data.planner or "") or next((one for one in found.values() if one), None)
    seen = (("waits", shown.waits), ("goes on", shown.goes_on)) if shown else ()
    evidence = tuple(_trial_evidence(data, what, trials) for what, trials in seen if trials)
    return Claim(
        "Where a task has an order, a robot waits at what it found until a teammate has done what comes first, or goes "
        "on searching elsewhere before what it found is needed (the paper's Figs. 4 to 6)",
        {name: judge_coordination(one) for name, one in found.items()},
        evidence,
    )


def judge_coordination(found: Coordination | None) -> Judged:
    """Whether a planner's traces show robots that wait and robots that go on."""
    if found is None:
        return Judged(Verdict.NOT_IN_RUN, ("no trace of an ordered task with several robots",))
    waits, goes_on = (share(len(trials), found.episodes) for trials in (found.waits, found.goes_on))
    both = bool(found.waits and found.goes_on)
    read = "" if found.episodes == found.eligible else f" whose traces were read, of {found.eligible}"
    return Judged(
        Verdict.HOLDS if both else Verdict.NOT_SHOWN,
        (
            f"{counted(found.episodes, 'such episode')}{read}",
            f"a robot waits in {_percent(waits)} of them",
            f"one goes on in {_percent(goes_on)}",
        ),
    )


def _trial_evidence(data: ReportData, what: str, trials: Sequence[str]) -> Evidence:
    """A trial whose replay lies beside the page; without one, the command that replays the first trial."""
    for trial in trials:
        if trial in data.replays:
            return Evidence(f"{what}: {trial}", data.replays[trial])
    output = f" output_dir={data.manifest['output_dir']}" if data.manifest.get("output_dir") else ""
    return Evidence(f"python -m pipeline.replay trial_id={trials[0]}{output}")


def _apartment(data: ReportData, planners: Sequence[str], trial: RealWorldTrial) -> Claim:
    simulated = simulated_trials(data.manifest, trial)
    output = f" output_dir={data.manifest['output_dir']}/scenario" if data.manifest.get("output_dir") else ""
    command = Evidence(f"python -m pipeline.scenario name={scenario_name(trial)}{output}")
    judged = {}
    for name in planners:
        own, myopic = simulated.get(name), simulated.get(MYOPIC)
        if own is None or myopic is None or not myopic.finished:
            because = ("no simulated run of both planners", "no real robot has run this code")
            judged[name] = Judged(Verdict.NOT_IN_RUN, because)
            continue
        shorter = own.finished and own.metres < myopic.metres
        outcome = f"{own.metres:.2f} m" if own.finished else "not finished"
        judged[name] = Judged(
            Verdict.HOLDS if shorter else Verdict.CONTRADICTED,
            (
                f"{outcome} against {myopic.metres:.2f} m of {planner_label(MYOPIC)}",
                "one simulated run, on a floor plan of ours",
            ),
        )
    return Claim(
        f"In {trial.name} ({trial.task}) two robots drive less than myopic ones (the paper, real robots: "
        f"{trial.planner_m:.2f} against {trial.myopic_m:.2f} m)",
        judged,
        (Evidence("the paper's trials", "#method"), command),
    )


def _not_run(summary: Summary, planner: str, baseline: str) -> Judged:
    if missing := [name for name in (planner, baseline) if name not in summary.planners]:
        return Judged(Verdict.NOT_IN_RUN, (f"{_named_planners(missing)} did not run",))
    return Judged(Verdict.NOT_IN_RUN, ("no trial of the paper's cells was finished by both",))


def _named(cells: Sequence[Cell]) -> str:
    return " and ".join(map(cell_name, cells))


def _named_planners(names: Sequence[str]) -> str:
    return " and ".join(map(planner_label, names))


def _percent(estimate: Estimate) -> str:
    return f"{estimate.value:.1f} % {_interval(estimate)}"


def _interval(estimate: Estimate) -> str:
    return f"[{estimate.low:.1f}, {estimate.high:.1f}]" if estimate.has_interval else f"(n = {estimate.n})"
