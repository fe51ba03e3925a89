"""The report of an ablation: which switch of the protocol moves the improvements, and which step leads to `pouct`.

An *arm* is one protocol: its rows are the compared planners' on that protocol's trials, under the planners' own names.
Arms whose trials are the same share the rows of planners that do not differ.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
from markupsafe import Markup

from mrtask.analysis.columns import Entry, Row, Table
from mrtask.analysis.episodes import checked_episodes
from mrtask.analysis.findings import Findings
from mrtask.analysis.published import Cell, Published, load_published
from mrtask.analysis.sections import render_fragment
from mrtask.analysis.statistics import (
    ALL_TEAMS,
    BASELINES,
    EVERYTHING,
    INFORMED_BASELINE,
    Estimate,
    Summary,
    cell_name,
    improvement_percent,
    paired_costs,
    summarise,
)
from mrtask.analysis.style import NOTHING, counted, planner_label
from mrtask.analysis.tables import ABOVE, BELOW, LEVEL, improvement_entry, percent_entry
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


@dataclass(frozen=True)
class _Arm:
    rows: ArmRows
    episodes: pd.DataFrame
    summary: Summary


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
    protocols = [arm for arm in found if not arm.rows.is_step]
    marks = {"above": ABOVE, "level": LEVEL, "below": BELOW}
    parts: list[tuple[str, str, Table | None]] = [
        ("verdicts", "The paper's planner", verdict_table(protocols, published, PAPERS_PLANNER)),
        (
            "ours",
            f"{planner_label(OUR_PLANNER)} under every protocol",
            verdict_table(protocols, published, OUR_PLANNER),
        ),
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
        question="Which parts of the protocol make the published improvements, and which of ours beat them?",
        findings=findings(protocols, published),
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
    headline = f"{reached} of the {len(printed)} published improvements lie in the 95 % interval of at least one arm."
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
    headings = (("", f"{ABOVE} {LEVEL} {BELOW}"), *_cell_headings(cells), ("all", "all teams"))
    return Table(headings, tuple(rows)) if cells else None


def step_table(steps: Sequence[_Arm]) -> Table | None:
    """Mean costs along the steps from the paper's planner to ours, and what each saves against the one before."""
    if not steps:
        return None
    last = steps[-1]
    cells = [*last.summary.cells, EVERYTHING]
    chain = [(arm.rows.name, _costs(arm.episodes, PAPERS_PLANNER)) for arm in steps]
    chain.append((OUR_PLANNER, _costs(last.episodes, OUR_PLANNER)))
    title = f"Saved against the step before, with 95 % paired intervals ({PAPERS_PLANNER}, last {OUR_PLANNER})"
    rows = [Row(title, heading=True)]
    for (_, before), (name, after) in pairwise(chain):
        rows.append(Row(name, tuple(_saved(after, before, cell) for cell in cells)))
    rows.append(Row(f"Saved by {OUR_PLANNER} against each step", heading=True))
    for name, before in chain[:-1]:
        rows.append(Row(name, tuple(_saved(chain[-1][1], before, cell) for cell in cells)))
    return Table((*_cell_headings(cells[:-1]), ("all", "all teams")), tuple(rows))


def template_table(arms: Sequence[_Arm]) -> Table | None:
    """The improvement over the informed baseline by template, all cells together."""
    templates = sorted({name for arm in arms for name in arm.episodes.get("template", pd.Series(dtype=str)).dropna()})
    rows: list[Row] = []
    for planner in (PAPERS_PLANNER, OUR_PLANNER):
        rows.append(Row(f"Improvement of {planner} over {INFORMED_BASELINE}", heading=True))
        for arm in arms:
            cost, baseline = (_costs(arm.episodes, name) for name in (planner, INFORMED_BASELINE))
            of_template = [set(arm.episodes.loc[arm.episodes["template"] == name, "trial_id"]) for name in templates]
            entries = (_saved(cost[cost.index.isin(t)], baseline, EVERYTHING) for t in of_template)
            rows.append(Row(arm.rows.name, tuple(entries)))
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


def _cell_headings(cells: Sequence[Cell]) -> tuple[tuple[str, str], ...]:
    return tuple((name, counted(robots, "robot") if robots != ALL_TEAMS else "all teams") for name, robots in cells)


def _costs(episodes: pd.DataFrame, planner: str) -> pd.Series:
    """A planner's costs in seconds by trial, of those it finished."""
    costs: pd.Series = paired_costs(episodes[episodes["planner"] == planner])[planner].dropna()
    return costs


def _saved(after: pd.Series, before: pd.Series, cell: Cell) -> Entry:
    """What ``after`` saves on the trials of a cell that both finished."""
    trials = after.index.intersection(before.index)
    if cell != EVERYTHING:
        trials = trials[trials.str.startswith(f"{cell[0]}-{cell[1]}-")]
    estimate = improvement_percent(after.loc[trials].to_numpy(), before.loc[trials].to_numpy())
    entry = percent_entry(estimate)
    tone = "good" if estimate.low > 0 else "bad" if estimate.high < 0 else ""
    return Entry(entry.value, entry.details, tone)


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
