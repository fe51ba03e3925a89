"""What a run ends with in a terminal: a line for each planner, the headline, and what failed and why."""

from collections.abc import Iterator

import pandas as pd

from mrtask.analysis.page.style import NOTHING, planner_label
from mrtask.analysis.page.tables import interval_text
from mrtask.analysis.report.answer import headline, trial_by_trial
from mrtask.analysis.report.run_facts import reason_of
from mrtask.analysis.results.episodes import checked_episodes, size_classes_in_order, variants_in_order
from mrtask.analysis.results.roles import BASELINES, main_planner
from mrtask.analysis.results.statistics import EVERYTHING, Estimate, Summary, summarise_parts
from mrtask.names import counted


def result_lines(episodes: pd.DataFrame) -> list[str]:
    """Return the results over all cells as lines of text, of a sweep for each variant; see `checked_episodes`."""
    checked = checked_episodes(episodes)
    lines: list[str] = []
    for variant in variants_in_order(checked):
        rows = checked[checked["variant"] == variant]
        summary = _pooled(rows)
        lines += [*([variant] if variant else []), *planner_lines(summary), *_answer(summary)]
    return lines + failure_lines(checked)


def planner_lines(summary: Summary) -> list[str]:
    """Return a table: each planner's accepted episodes, mean time, and saving over the baselines with its interval."""
    rows = {planner_label(planner): dict(_row(summary, planner)) for planner in summary.planners}
    return pd.DataFrame.from_dict(rows, orient="index").to_string().splitlines()


def _row(summary: Summary, planner: str) -> Iterator[tuple[str, str]]:
    found = summary.planner_cells[EVERYTHING, planner]
    yield "accepted", f"{found.accepted}/{found.episodes}"
    yield "mean (s)", f"{found.cost_s:.2f}" if found.accepted else NOTHING
    for baseline in (name for name in BASELINES if name in summary.planners):
        yield f"saves of {baseline} (%)", _saved(summary.improvement(EVERYTHING, planner, baseline))


def _saved(estimate: Estimate) -> str:
    return f"{estimate.value:.1f} {interval_text(estimate)}" if estimate.defined else NOTHING


def _answer(summary: Summary) -> list[str]:
    """Return the headline on the main planner, and what its mean hides, trial by trial."""
    planner = main_planner(summary.planners)
    said = None if planner is None else headline(summary, planner)
    if planner is None or said is None:
        return []
    shown = [name for name in reversed(BASELINES) if summary.improvement(EVERYTHING, planner, name).defined]
    return [said, *(trial_by_trial(summary, planner, baseline) for baseline in shown)]


def failure_lines(episodes: pd.DataFrame) -> list[str]:
    """Return how many episodes have no result and the commonest reason of each status; nothing where all have one."""
    lost = episodes[episodes["status"] != "accepted"]
    if lost.empty:
        return []
    parts = []
    for status, rows in lost.groupby("status"):
        reasons = rows["error"].map(reason_of).value_counts()
        parts.append(f"{len(rows)} {status} (mostly: {reasons.index[0] or 'no reason given'})")
    return [f"{len(lost)} of {counted(len(episodes), 'episode')} without a result: {'; '.join(parts)}"]


def never_succeeded(episodes: pd.DataFrame) -> dict[str, int]:
    """Return the planners without an accepted episode, each with the number of its episodes."""
    accepted = (episodes["status"] == "accepted").groupby(episodes["planner"]).agg(["sum", "size"])
    return {str(name): int(row["size"]) for name, row in accepted.iterrows() if not row["sum"]}


def _pooled(rows: pd.DataFrame) -> Summary:
    """Return the statistics over all cells together."""
    classes, teams = size_classes_in_order(rows["size_class"]), sorted(map(int, rows["robots"].unique()))
    return summarise_parts(rows, classes, teams, {EVERYTHING: rows})
