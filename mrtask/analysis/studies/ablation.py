"""The report of an ablation: which switch of the protocol moves the improvements, and which step leads to `pouct`.

An *arm* is one protocol: its rows are the compared planners' on that protocol's trials, under the planners' own names.
Arms whose trials are the same share the rows of planners that do not differ.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import pandas as pd
from markupsafe import Markup

from mrtask.analysis.page.columns import Entry, Row, Table, interval_text
from mrtask.analysis.page.entries import ABOVE, BELOW, LEVEL, cell_headings, improvement_entry, percent_entry
from mrtask.analysis.page.findings import Findings
from mrtask.analysis.page.style import NOTHING, planner_label
from mrtask.analysis.page.templating import render_fragment, script_digest
from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.published import Cell, Published, load_published
from mrtask.analysis.results.statistics import (
    BASELINES,
    EVERYTHING,
    INFORMED_BASELINE,
    Bootstrap,
    Estimate,
    Summary,
    cell_name,
    improvement_of_means,
    improvement_percent,
    paired_costs,
    summarise,
)
from mrtask.arrays import Floats
from mrtask.names import counted
from mrtask.planning.planners import PAPERS_PLANNER, Role, planners_with_role

OUR_PLANNER = planners_with_role(Role.OURS)[0]
COMPARED = (*BASELINES, PAPERS_PLANNER, OUR_PLANNER)
"""The planners that every arm has."""
WAITS = "waits"
"""Column with the share of the episode that each robot waits, least first."""


@dataclass(frozen=True)
class ArmRows:
    """One arm's episodes: those of `COMPARED`, with a column `WAITS`."""

    name: str
    episodes: pd.DataFrame
    overrides: tuple[str, ...]
    in_detail: bool
    """Whether the arm also appears in the tables by template and of waiting: end points and steps."""
    is_step: bool = False
    against: str | None = None
    """The arm that this one differs from by one switch."""


@dataclass(frozen=True)
class _Arm:
    rows: ArmRows
    episodes: pd.DataFrame
    summary: Summary

    @cached_property
    def costs(self) -> pd.DataFrame:
        """Each trial's size class and robots, and each planner's cost in seconds; NaN where it did not finish."""
        trials = self.episodes.groupby("trial_id")[["size_class", "robots"]].first()
        return trials.join(paired_costs(self.episodes).reindex(columns=list(COMPARED)))


def waiting_shares(trace: str) -> list[float]:
    """The share of the episode's time that each robot waits, least first; from a trace's JSON. 0 without any time."""
    robots = json.loads(trace)["robots"]
    makespan_s = max((leg["t1_s"] for legs in robots for leg in legs), default=0.0)
    if makespan_s == 0.0:
        return [0.0] * len(robots)
    busy_s = [sum(leg["t1_s"] - leg["t0_s"] for leg in legs if leg["kind"] != "wait") for legs in robots]
    return sorted(1.0 - seconds / makespan_s for seconds in busy_s)


def render_ablation(arms: Sequence[ArmRows], experiment: str) -> str:
    """The page.

    Args:
        arms: the first is the protocol as configured.

    Raises:
        ValueError: the episodes are not what `checked_episodes` demands.
    """
    published = load_published()
    checked = [(rows, checked_episodes(rows.episodes)) for rows in arms]
    found = [_Arm(rows, episodes, summarise(episodes)) for rows, episodes in checked]
    marks = {"above": ABOVE, "level": LEVEL, "below": BELOW}
    parts: list[tuple[str, str, Table | None]] = [
        ("verdicts", "The paper's planner", verdict_table(found, published, PAPERS_PLANNER)),
        (
            "ours",
            f"{planner_label(OUR_PLANNER)} under every protocol",
            verdict_table(_unlike(found, OUR_PLANNER), published, OUR_PLANNER),
        ),
        ("switches", "What each switch moves", switch_table(found)),
        ("steps", f"From {PAPERS_PLANNER} to {OUR_PLANNER}", step_table([a for a in found if a.rows.is_step])),
        ("templates", "By template", template_table([arm for arm in found if arm.rows.in_detail])),
        ("waiting", "How long robots wait", waiting_table([arm for arm in found if arm.rows.in_detail])),
    ]
    sections = [
        {"anchor": anchor, "link": title, "title": title, "body": _body(anchor, table, marks)}
        for anchor, title, table in parts
        if table is not None
    ]
    overrides = [(arm.rows.name, " ".join(arm.rows.overrides) or "as configured") for arm in found]
    body = render_fragment("ablation_arms", arms=overrides)
    sections.append({"anchor": "arms", "link": "Arms", "title": "What each arm changes", "body": body})
    return render_fragment(
        "page",
        title=f"mrtask: ablation of {experiment}",
        script="",
        script_digest=script_digest(""),
        question="Which parts of the protocol make the published improvements, and which of ours beat them?",
        findings=findings(found, published),
        warnings=[],
        variants=1,
        shown="",
        sections=sections,
        episodes=sum(len(arm.episodes) for arm in found),
    )


def _body(anchor: str, table: Table, marks: dict[str, str]) -> Markup:
    return render_fragment("ablation", anchor=anchor, table=table, marks=marks)


def findings(arms: Sequence[_Arm], published: Published) -> Findings:
    """Which published improvements lie inside our interval, under which protocols."""
    sentences, reached = [], 0
    printed = sorted(published.improvement_percent.items())
    for (baseline, cell), value in printed:
        estimates = {arm.rows.name: arm.summary.improvement(cell, PAPERS_PLANNER, baseline) for arm in arms}
        inside = [name for name, estimate in estimates.items() if _mark(estimate, value) == LEVEL]
        reached += bool(inside)
        if not inside:
            tried = {name: e for name, e in estimates.items() if e.has_interval}
            if tried:
                nearest = min(tried, key=lambda name: abs(tried[name].value - value))
                near = f"nearest is {nearest} with {tried[nearest].value:.1f} %"
            else:
                near = "no arm has an interval there"
            where = f"{cell_name(cell)}, over {planner_label(baseline)}"
            sentences.append(f"{where}: {value:.2f} % is in no arm's interval; {near}.")
    for arm in arms:
        if arm.rows.in_detail:
            sentences.append(f"{arm.rows.name}: {_count_text(arm, published, PAPERS_PLANNER)}.")
    first = arms[0]
    headline = (
        f"{first.rows.name}: {_count_text(first, published, PAPERS_PLANNER)}. "
        f"{reached} of the {len(printed)} lie in the interval of at least one arm."
    )
    return Findings(f"{reached} of {len(printed)}", headline, tuple(sentences), ())


def verdict_table(arms: Sequence[_Arm], published: Published, planner: str) -> Table | None:
    """A planner's improvement over each baseline by arm and cell, beside the published one, and how many agree."""
    cells = list(dict.fromkeys(cell for arm in arms for cell in arm.summary.cells))
    rows: list[Row] = []
    for baseline in BASELINES:
        rows.append(Row(f"Improvement over {planner_label(baseline)}", heading=True))
        for arm in arms:
            entries = [improvement_entry(arm.summary, published, cell, planner, baseline) for cell in cells]
            entries.append(percent_entry(arm.summary.improvement(EVERYTHING, planner, baseline)))
            rows.append(Row(arm.rows.name, (Entry(_counts(arm, published, planner, [baseline])), *entries)))
    headings = (("", f"{ABOVE} {LEVEL} {BELOW}"), *cell_headings(cells), ("all", "all teams"))
    return Table(headings, tuple(rows)) if cells else None


def _unlike(arms: Sequence[_Arm], planner: str) -> list[_Arm]:
    """The arms without those in which the planner and the baselines have the costs that they have in an earlier one."""
    compared = [planner, *BASELINES]
    kept: list[_Arm] = []
    for arm in arms:
        if not any(arm.costs[compared].equals(other.costs[compared]) for other in kept):
            kept.append(arm)
    return kept


def switch_table(arms: Sequence[_Arm]) -> Table | None:
    """By how many points each switch moves the paper's planner's improvement over each baseline, by cell."""
    by_name = {arm.rows.name: arm for arm in arms}
    pairs = [(arm, by_name[arm.rows.against]) for arm in arms if arm.rows.against]
    if not pairs:
        return None
    cells = [*arms[0].summary.cells, EVERYTHING]
    rows: list[Row] = []
    for baseline in BASELINES:
        rows.append(Row(f"Points of improvement over {planner_label(baseline)}", heading=True))
        rows += [
            Row(arm.rows.name, tuple(_moved(arm, other, baseline, cell) for cell in cells)) for arm, other in pairs
        ]
    return Table((*cell_headings(cells[:-1]), ("all", "all teams")), tuple(rows))


def _moved(arm: _Arm, against: _Arm, baseline: str, cell: Cell) -> Entry:
    """The difference of two arms' improvements, resampled by the trials' numbers, which planner switches share."""
    series = [_costs(one, name, cell) for one in (arm, against) for name in (PAPERS_PLANNER, baseline)]
    estimate = Bootstrap(pd.concat(series, axis=1, join="inner").to_numpy()).estimate(_difference)
    if not estimate.defined:
        return Entry(NOTHING)
    tone = "good" if estimate.low > 0 else "bad" if estimate.high < 0 else ""
    return Entry(f"{estimate.value:+.1f}", (interval_text(estimate),), tone)


def _difference(means: Floats) -> Floats:
    """From means [..., 4] of planner and baseline in one arm and in another."""
    return improvement_of_means(means[..., :2]) - improvement_of_means(means[..., 2:])


def step_table(steps: Sequence[_Arm]) -> Table | None:
    """What each step from the paper's planner to ours saves against the one before, and ours against each."""
    if not steps:
        return None
    cells = [*steps[-1].summary.cells, EVERYTHING]
    chain = [(arm.rows.name, arm, PAPERS_PLANNER) for arm in steps]
    chain.append((OUR_PLANNER, steps[-1], OUR_PLANNER))

    def row(name: str, after: tuple[str, _Arm, str], before: tuple[str, _Arm, str]) -> Row:
        costs = [(_costs(after[1], after[2], cell), _costs(before[1], before[2], cell)) for cell in cells]
        return Row(name, tuple(_saved(*pair) for pair in costs))

    title = f"Saved against the step before, with 95 % paired intervals ({PAPERS_PLANNER}, last {OUR_PLANNER})"
    rows = [Row(title, heading=True), *(row(after[0], after, before) for before, after in pairwise(chain))]
    rows.append(Row(f"Saved by {OUR_PLANNER} against each step", heading=True))
    rows += [row(step[0], chain[-1], step) for step in chain[:-1]]
    return Table((*cell_headings(cells[:-1]), ("all", "all teams")), tuple(rows))


def template_table(arms: Sequence[_Arm]) -> Table | None:
    """The improvement over the informed baseline by template, all cells together."""
    templates = sorted({name for arm in arms for name in arm.episodes["template"].dropna()})
    rows: list[Row] = []
    for planner in (PAPERS_PLANNER, OUR_PLANNER):
        rows.append(Row(f"Improvement of {planner} over {INFORMED_BASELINE}", heading=True))
        for arm in arms:
            cost, baseline = (_costs(arm, name) for name in (planner, INFORMED_BASELINE))
            template_of = arm.episodes.groupby("trial_id")["template"].first()
            of_template = (cost[template_of.loc[cost.index] == name] for name in templates)
            rows.append(Row(arm.rows.name, tuple(_saved(part, baseline) for part in of_template)))
    return Table(tuple(("", name) for name in templates), tuple(rows)) if templates else None


def waiting_table(arms: Sequence[_Arm]) -> Table | None:
    """The mean share of the episode's time that the robots of a team wait, the one that waits least first."""
    teams = sorted({int(size) for arm in arms for size in arm.episodes["robots"] if size > 1})
    if not teams:
        return None
    rows: list[Row] = []
    for planner in COMPARED:
        rows.append(Row(planner_label(planner), heading=True))
        for arm in arms:
            of_planner = arm.episodes[(arm.episodes["planner"] == planner) & (arm.episodes["status"] == "accepted")]
            entries: list[Entry] = []
            for size in teams:
                waits = of_planner.loc[of_planner["robots"] == size, WAITS]
                means = np.mean(np.array(waits.tolist()), axis=0) if len(waits) else np.full(size, np.nan)
                entries += [Entry(f"{100 * mean:.0f} %" if np.isfinite(mean) else NOTHING) for mean in means]
            rows.append(Row(arm.rows.name, tuple(entries)))
    columns = [(counted(size, "robot"), _waiting_heading(index, size)) for size in teams for index in range(size)]
    return Table(tuple(columns), tuple(rows))


def _waiting_heading(index: int, robots: int) -> str:
    return "waits least" if index == 0 else "waits most" if index == robots - 1 else f"{index + 1}."


def _costs(arm: _Arm, planner: str, cell: Cell = EVERYTHING) -> pd.Series:
    """A planner's costs in seconds by trial, of those of a cell that it finished."""
    costs = arm.costs
    if cell != EVERYTHING:
        costs = costs[(costs["size_class"] == cell[0]) & (costs["robots"] == cell[1])]
    return costs[planner].dropna()


def _saved(after: pd.Series, before: pd.Series) -> Entry:
    """What ``after`` saves on the trials that both finished."""
    trials = after.index.intersection(before.index)
    estimate = improvement_percent(after.loc[trials].to_numpy(), before.loc[trials].to_numpy())
    entry = percent_entry(estimate)
    return Entry(entry.value, entry.details, "good" if estimate.low > 0 else "bad" if estimate.high < 0 else "")


def _mark(estimate: Estimate, printed: float) -> str:
    if not estimate.has_interval:
        return ""
    return ABOVE if estimate.low > printed else BELOW if estimate.high < printed else LEVEL


def _counts(arm: _Arm, published: Published, planner: str, baselines: Sequence[str]) -> str:
    """How many published improvements ours are above, around, and below: ``3 5 1``."""
    marks = [
        _mark(arm.summary.improvement(cell, planner, baseline), value)
        for (baseline, cell), value in published.improvement_percent.items()
        if baseline in baselines
    ]
    return " ".join(str(marks.count(mark)) for mark in (ABOVE, LEVEL, BELOW))


def _count_text(arm: _Arm, published: Published, planner: str) -> str:
    above, inside, below = _counts(arm, published, planner, BASELINES).split()
    return f"{inside} of the published improvements lie inside our interval, ours are above {above} and below {below}"
