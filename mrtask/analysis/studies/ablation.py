"""The page of an ablation: which protocol switch moves the improvements, and which step leads to `pouct`.

An *arm* is one protocol. Its rows are those of the compared planners on that protocol's trials, under the planners' own
names. Arms with the same trials share the rows of planners that do not differ.
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import pandas as pd

from mrtask.analysis.page.rendering import Findings, PageSection, render_page, study_section
from mrtask.analysis.page.style import NOTHING, planner_label
from mrtask.analysis.page.tables import (
    ABOVE,
    BELOW,
    LEVEL,
    Entry,
    Row,
    Table,
    block,
    cell_headings,
    estimate_entry,
    improvement_entry,
    mark,
    saved_entry,
)
from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.published import Cell, Published, load_published
from mrtask.analysis.results.roles import BASELINES, INFORMED_BASELINE, OUR_PLANNER
from mrtask.analysis.results.statistics import (
    EVERYTHING,
    PairedCosts,
    Summary,
    cell_name,
    homes_of,
    improvement_of_means,
    paired_costs,
    summarise,
)
from mrtask.arrays import Floats
from mrtask.names import counted
from mrtask.planning.planners import PAPERS_PLANNER

COMPARED = (*BASELINES, PAPERS_PLANNER, OUR_PLANNER)
"""The planners that every arm contains."""
WAITS = "waits"
"""The column with the share of the episode for which each robot waits, in ascending order."""
VERDICTS_NOTE = (
    f"{ABOVE} the whole paired 95 % interval is above the published improvement, {LEVEL} the published one lies inside "
    f'it, {BELOW} the interval is below. The first column counts the nine cells. "paper + x" adds one switch to the '
    'protocol as configured, "authors - x" takes one away from all of them.'
)
OURS_NOTE = (
    f"{VERDICTS_NOTE} Arms whose costs of this planner and the baselines equal those of an arm above are left out."
)
SWITCHES_NOTE = (
    'Improvement of the paper\'s planner with "paper + x" minus that with "paper", and with "authors - x" minus that '
    'with "authors", in percentage points, with 95 % intervals. Arms that differ only in planners share their trials; '
    "where homes, tasks or costs differ, trials are paired by number and intervals resample the arm's homes."
)
WAITING_NOTE = (
    "Share of the episode's time, over accepted episodes; within a team the robot that waits least comes first in "
    "every episode."
)


@dataclass(frozen=True, eq=False)
class ArmRows:
    """One arm's episodes: those of `COMPARED`, with a column `WAITS`."""

    name: str
    episodes: pd.DataFrame
    overrides: tuple[str, ...]
    in_detail: bool
    """Whether the arm, an end point or a step, also appears in the tables by template and of waiting."""
    is_step: bool = False
    against: str | None = None
    """The arm that differs from this one by one switch."""

    @cached_property
    def rows(self) -> pd.DataFrame:
        """Return the checked episodes."""
        return checked_episodes(self.episodes)

    @cached_property
    def summary(self) -> Summary:
        """Return the statistics of the episodes."""
        return summarise(self.rows)

    @cached_property
    def costs(self) -> pd.DataFrame:
        """Return each trial's size class and robots, and each planner's cost in seconds.

        A cost is NaN if the planner did not finish.
        """
        trials = self.rows.groupby("trial_id")[["size_class", "robots"]].first()
        return trials.join(paired_costs(self.rows).reindex(columns=list(COMPARED)))

    @cached_property
    def homes(self) -> pd.Series:
        """Return the home of each trial."""
        return homes_of(self.rows)

    def cost(self, planner: str, cell: Cell = EVERYTHING) -> pd.Series:
        """Return a planner's costs in seconds by trial, in one cell or in all."""
        costs = self.costs
        if cell != EVERYTHING:
            costs = costs[(costs["size_class"] == cell[0]) & (costs["robots"] == cell[1])]
        return costs[planner]


def waiting_shares(trace: str) -> list[float]:
    """Return the share of the episode's time for which each robot waits, in ascending order, from a trace's JSON.

    It is 0 if the episode took no time.
    """
    robots = json.loads(trace)["robots"]
    makespan_s = max((leg["t1_s"] for legs in robots for leg in legs), default=0.0)
    if makespan_s == 0.0:
        return [0.0] * len(robots)
    busy_s = [sum(leg["t1_s"] - leg["t0_s"] for leg in legs if leg["kind"] != "wait") for legs in robots]
    return sorted(1.0 - seconds / makespan_s for seconds in busy_s)


def render_ablation(arms: Sequence[ArmRows], experiment: str) -> str:
    """Return the page.

    Args:
        arms: the first arm is the protocol as configured.

    Raises:
        ValueError: the episodes are not what `checked_episodes` demands.
    """
    published = load_published()
    detailed = [arm for arm in arms if arm.in_detail]
    ours = f"{planner_label(OUR_PLANNER)} under every protocol"
    steps = f"From {PAPERS_PLANNER} to {OUR_PLANNER}"
    sections = [
        *_section("verdicts", "The paper's planner", verdict_table(arms, published, PAPERS_PLANNER), VERDICTS_NOTE),
        *_section("ours", ours, verdict_table(_unlike(arms, OUR_PLANNER), published, OUR_PLANNER), OURS_NOTE),
        *_section("switches", "What each switch moves", switch_table(arms), SWITCHES_NOTE),
        *_section("steps", steps, step_table([arm for arm in arms if arm.is_step])),
        *_section("templates", "By template", template_table(detailed), corner="template"),
        *_section("waiting", "How long robots wait", waiting_table(detailed), WAITING_NOTE),
    ]
    overrides = [(arm.name, " ".join(arm.overrides) or "as configured") for arm in arms]
    return render_page(
        f"mrtask: ablation of {experiment}",
        "Which parts of the protocol make the published improvements, and which of ours beat them?",
        findings(arms, published),
        [*sections, study_section("arms", "What each arm changes", facts=overrides)],
        episodes=sum(len(arm.rows) for arm in arms),
    )


def _section(anchor: str, title: str, table: Table | None, note: str = "", corner: str = "arm") -> list[PageSection]:
    return [study_section(anchor, title, [table], corner, note)] if table is not None else []


def findings(arms: Sequence[ArmRows], published: Published) -> Findings:
    """Say which published improvements lie inside our interval, and under which protocols."""
    sentences = []
    for (baseline, cell), value in sorted(published.improvement_percent.items()):
        estimates = {arm.name: arm.summary.improvement(cell, PAPERS_PLANNER, baseline) for arm in arms}
        if any(mark(estimate, value) == LEVEL for estimate in estimates.values()):
            continue
        near = "no arm has an interval there"
        if tried := {name: estimate for name, estimate in estimates.items() if estimate.has_interval}:
            nearest = min(tried, key=lambda name: abs(tried[name].value - value))
            near = f"the nearest is {nearest} with {tried[nearest].value:.1f} %"
        where = f"{cell_name(cell)}, over {planner_label(baseline)}"
        sentences.append(f"{where}: {value:.2f} % is in no arm's interval; {near}.")
    printed = len(published.improvement_percent)
    reached = printed - len(sentences)
    sentences += [f"{arm.name}: {_count_text(arm, published)}." for arm in arms if arm.in_detail]
    headline = (
        f"{arms[0].name}: {_count_text(arms[0], published)}. "
        f"{reached} of the {printed} lie in the interval of at least one arm."
    )
    return Findings(f"{reached} of {printed}", headline, tuple(sentences))


def verdict_table(arms: Sequence[ArmRows], published: Published, planner: str) -> Table | None:
    """Tabulate a planner's improvement over each baseline by arm and cell, beside the published one.

    The table also counts how many agree.
    """
    cells = list(dict.fromkeys(cell for arm in arms for cell in arm.summary.cells))

    def entries(arm: ArmRows, baseline: str) -> Iterable[Entry]:
        yield Entry(" ".join(map(str, _counts(arm, published, planner, [baseline]))))
        for cell in cells:
            yield improvement_entry(arm.summary, published, cell, planner, baseline)
        yield estimate_entry(arm.summary.improvement(EVERYTHING, planner, baseline))

    headings = (("", f"{ABOVE} {LEVEL} {BELOW}"), *cell_headings([*cells, EVERYTHING]))
    return Table(headings, _rows_over(BASELINES, "Improvement over", arms, entries)) if cells else None


def _rows_over(
    planners: Iterable[str],
    heading: str,
    arms: Sequence[ArmRows],
    entries: Callable[[ArmRows, str], Iterable[Entry]],
) -> tuple[Row, ...]:
    """Return, for each planner, a heading that names it and a row for each arm."""
    return tuple(
        row
        for planner in planners
        for row in block(
            f"{heading} {planner_label(planner)}".strip(), ((arm.name, entries(arm, planner)) for arm in arms)
        )
    )


def _unlike(arms: Sequence[ArmRows], planner: str) -> list[ArmRows]:
    """Return the arms without those whose costs of the planner and the baselines equal an earlier arm's."""
    compared = [planner, *BASELINES]
    kept: list[ArmRows] = []
    for arm in arms:
        if not any(arm.costs[compared].equals(other.costs[compared]) for other in kept):
            kept.append(arm)
    return kept


def switch_table(arms: Sequence[ArmRows]) -> Table | None:
    """Tabulate by how many points each switch moves the paper's planner's improvement over each baseline, by cell."""
    by_name = {arm.name: arm for arm in arms}
    switches = [arm for arm in arms if arm.against]
    cells = [*arms[0].summary.cells, EVERYTHING]

    def moved(arm: ArmRows, baseline: str) -> Iterable[Entry]:
        pair = (arm, by_name[str(arm.against)])
        for cell in cells:
            # Pair by the trials' numbers, which arms share even if their trials differ.
            costs = [one.cost(name, cell) for one in pair for name in (PAPERS_PLANNER, baseline)]
            paired = PairedCosts(pd.concat(costs, axis=1, join="inner", keys=range(4)), arm.homes)
            yield estimate_entry(paired.estimate(_difference, range(4)), unit="", sign="+", higher_is_better=True)

    rows = _rows_over(BASELINES, "Points of improvement over", switches, moved)
    return Table(cell_headings(cells), rows) if switches else None


def _difference(means: Floats) -> Floats:
    """Return the difference of two improvements, from means [..., 4] of planner and baseline in each of two arms."""
    return improvement_of_means(means[..., :2]) - improvement_of_means(means[..., 2:])


def step_table(steps: Sequence[ArmRows]) -> Table | None:
    """Tabulate what each step from the paper's planner to ours saves against the one before, and ours against each."""
    if not steps:
        return None
    cells = [*steps[-1].summary.cells, EVERYTHING]
    ours = (OUR_PLANNER, steps[-1], OUR_PLANNER)
    chain = [*((arm.name, arm, PAPERS_PLANNER) for arm in steps), ours]

    def saved(after: tuple[str, ArmRows, str], before: tuple[str, ArmRows, str]) -> Iterable[Entry]:
        _, arm, planner = after
        return (_saved(arm.cost(planner, cell), before[1].cost(before[2], cell), arm.homes) for cell in cells)

    title = f"Saved against the step before, with 95 % paired intervals ({PAPERS_PLANNER}, last {OUR_PLANNER})"
    rows = block(title, ((after[0], saved(after, before)) for before, after in pairwise(chain)))
    rows += block(f"Saved by {OUR_PLANNER} against each step", ((step[0], saved(ours, step)) for step in chain[:-1]))
    return Table(cell_headings(cells), tuple(rows))


def template_table(arms: Sequence[ArmRows]) -> Table | None:
    """Tabulate the improvement over the informed baseline by template, all cells together."""
    templates = sorted({name for arm in arms for name in arm.rows["template"].dropna()})
    rows: list[Row] = []
    for planner in (PAPERS_PLANNER, OUR_PLANNER):
        lines = []
        for arm in arms:
            cost, baseline = arm.cost(planner), arm.cost(INFORMED_BASELINE)
            template_of = arm.rows.groupby("trial_id")["template"].first().loc[cost.index]
            lines.append((arm.name, [_saved(cost[template_of == name], baseline, arm.homes) for name in templates]))
        rows += block(f"Improvement of {planner} over {INFORMED_BASELINE}", lines)
    return Table(tuple(("", name) for name in templates), tuple(rows)) if templates else None


def waiting_table(arms: Sequence[ArmRows]) -> Table | None:
    """Tabulate the mean share of the episode's time for which the robots of a team wait, in ascending order."""
    teams = sorted({int(size) for arm in arms for size in arm.rows["robots"] if size > 1})

    def entries(arm: ArmRows, planner: str) -> Iterable[Entry]:
        accepted = arm.rows[(arm.rows["planner"] == planner) & (arm.rows["status"] == "accepted")]
        for size in teams:
            waits = accepted.loc[accepted["robots"] == size, WAITS].tolist()
            means = np.mean(waits, axis=0) if waits else []
            yield from [Entry(f"{100 * mean:.0f} %") for mean in means] or [Entry(NOTHING)] * size

    columns = [(counted(size, "robot"), _waiting_heading(index, size)) for size in teams for index in range(size)]
    return Table(tuple(columns), _rows_over(COMPARED, "", arms, entries)) if teams else None


def _waiting_heading(index: int, robots: int) -> str:
    return "waits least" if index == 0 else "waits most" if index == robots - 1 else f"{index + 1}."


def _saved(after: pd.Series, before: pd.Series, homes: pd.Series) -> Entry:
    """Return what ``after`` saves on the trials that both finished, in these homes."""
    pair = pd.concat([after, before], axis=1, join="inner", keys=["after", "before"])
    return saved_entry(PairedCosts(pair, homes).improvement("after", "before"))


def _counts(arm: ArmRows, published: Published, planner: str, baselines: Sequence[str]) -> tuple[int, int, int]:
    """Return how many published improvements ours are above, around, and below."""
    marks = [
        mark(arm.summary.improvement(cell, planner, baseline), value)
        for (baseline, cell), value in published.improvement_percent.items()
        if baseline in baselines
    ]
    return marks.count(ABOVE), marks.count(LEVEL), marks.count(BELOW)


def _count_text(arm: ArmRows, published: Published) -> str:
    above, inside, below = _counts(arm, published, PAPERS_PLANNER, BASELINES)
    return f"{inside} of the published improvements lie inside our interval, ours are above {above} and below {below}"
