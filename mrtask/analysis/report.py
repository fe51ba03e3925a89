"""The report: one ``index.html`` that holds everything it shows and needs no network, and ``table.csv`` beside it.

It opens with the answer, in words computed from the data; the sections below are listed in `mrtask.analysis.sections`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd
from markupsafe import Markup

from mrtask.analysis.episodes import checked_episodes
from mrtask.analysis.findings import main_planner
from mrtask.analysis.replay import Episode, make_replay
from mrtask.analysis.replay_page import render_replay
from mrtask.analysis.report_data import ReportData, collect_report_data, rows_of, variants_of
from mrtask.analysis.result_table import result_table
from mrtask.analysis.sections import SECTIONS
from mrtask.analysis.style import planner_label
from mrtask.analysis.templating import render_fragment, script_digest, template_text
from mrtask.analysis.trajectories import task_objects
from mrtask.analysis.trial_browser import compared_planners, mapped_trials, notable_trials
from mrtask.execution.trace import Trace
from mrtask.files import replacing
from mrtask.homes.home import Home
from mrtask.tasks.automaton import build_automaton

REPORT_FILE, TABLE_FILE, REPLAYS = "index.html", "table.csv", "replays"
SAFE_NAME = re.compile(r"[\w-]+")
"""Trial ids that can name a file."""


@dataclass(frozen=True)
class TrialsToDraw:
    """The trials whose traces the report needs, of these planners, and the homes that they are in."""

    trial_ids: frozenset[str]
    home_ids: frozenset[str]
    planners: tuple[str, ...]


@dataclass(frozen=True)
class Report:
    """The content of the files."""

    page: str
    table: str
    extras: Mapping[str, str] = field(default_factory=dict)
    """Relative path -> content of what stands beside the page: ``replays/<trial>.html``."""


def render_report(
    episodes: pd.DataFrame,
    manifest: Mapping[str, Any],
    homes: Mapping[str, Home],
    optimality: pd.DataFrame | None = None,
) -> Report:
    """The report of a run, or of a sweep.

    Args:
        episodes: one row per (trial, planner); see `mrtask.analysis.episodes.REQUIRED_COLUMNS`. A ``sweep`` column
            tells a sweep's variants apart.
        manifest: what the run left as JSON: ``experiment, seed, planners, model {...}, homes {...}, wall_s, config,
            ...``; `mrtask.analysis.facts` reads it, and all of it is optional.
        homes: home id -> home, for drawing; trials in other homes are not drawn. `trials_to_draw` names those needed.
        optimality: one row per trial whose lower bound was computed; see `mrtask.analysis.bounds.assess`.

    Raises:
        ValueError: a column is missing, or the episodes contradict each other.
    """
    data = collect_report_data(episodes, manifest, homes, optimality)
    replays, unplayable = replays_of(data)
    links = {trial_id: f"{REPLAYS}/{trial_id}.html" for trial_id in replays}
    data = replace(data, replays=links, unplayable=tuple(unplayable))
    table = result_table(data.summaries, data.published)
    return Report(
        render_page(data),
        table.to_csv(index=False, float_format="%.6g", lineterminator="\n"),
        {data.replays[trial_id]: page for trial_id, page in replays.items()},
    )


def replays_of(data: ReportData) -> tuple[dict[str, str], list[str]]:
    """Trial id -> page, for the notable trials whose home and traces are there. Reasons would take a run.

    Also why any of them cannot be played: their rows hold a formula, or name an object or container, that is none.
    """
    if not {"trace", "template", "formula", "objects"} <= set(data.rows.columns):
        return {}, []
    pages, unplayable = {}, []
    for pick in notable_trials(data.rows, data.planner):
        home = data.homes.get(pick.home_id)
        rows = data.rows[(data.rows["trial_id"] == pick.trial_id) & data.rows["trace"].notna()]
        shown = [name for name in compared_planners(data.rows, data.planner) if name in set(rows["planner"])]
        if home is None or not shown or not SAFE_NAME.fullmatch(pick.trial_id):
            continue
        by_planner = {row["planner"]: row for row in rows.to_dict("records")}
        first = by_planner[shown[0]]
        try:
            automaton = build_automaton(first["formula"], task_objects(first["objects"]))
            played = [_episode(by_planner[name]) for name in shown]
            replay = make_replay(pick.trial_id, first["size_class"], first["template"], automaton, home, played)
        except ValueError as error:
            unplayable.append(f"Trial {pick.trial_id} cannot be replayed: {error}")
            continue
        pages[pick.trial_id] = render_replay(replay)
    return pages, unplayable


def _episode(row: Mapping[Any, Any]) -> Episode:
    accepted = row["status"] == "accepted"
    return Episode(
        planner=row["planner"],
        status=row["status"],
        cost_s=row["cost_s"] if accepted else None,
        error=None if accepted else str(row.get("error") or ""),
        trace=Trace.from_json(row["trace"]),
    )


def write_report(report: Report, out_dir: Path) -> Path:
    """Writes ``table.csv`` and ``index.html`` into ``out_dir`` and returns the path of the latter.

    An earlier file is replaced only by a whole new one.

    Raises:
        OSError: a file cannot be written.
    """
    for name, text in (*report.extras.items(), (TABLE_FILE, report.table), (REPORT_FILE, report.page)):
        (out_dir / name).parent.mkdir(parents=True, exist_ok=True)
        with replacing(out_dir / name) as path:
            path.write_text(text, encoding="utf-8", newline="\n")
    return out_dir / REPORT_FILE


def render_page(data: ReportData) -> str:
    """The HTML page: the answer, then all sections that have something to show."""
    experiment = data.manifest.get("experiment")
    sections = []
    for section in SECTIONS:
        body = section.fragment(data)
        if body is not None:
            sections.append({"anchor": section.anchor, "link": section.link, "title": section.title, "body": body})
    script = template_text("report.js")
    return render_fragment(
        "page",
        script=Markup(script),
        script_digest=script_digest(script),
        title=f"mrtask: experiment {experiment}" if experiment else "mrtask: report",
        question=_question(data.planner),
        findings=data.findings,
        warnings=data.warnings,
        variants=len(data.summaries),
        shown=data.shown,
        sections=sections,
        episodes=len(data.episodes),
    )


def trials_to_draw(episodes: pd.DataFrame, manifest: Mapping[str, Any]) -> TrialsToDraw:
    """What the report of these episodes draws, so that no other home or trace needs to be loaded."""
    checked = checked_episodes(episodes)
    rows = rows_of(checked, variants_of(checked)[-1])
    planner = main_planner(tuple(rows["planner"].unique()), manifest.get("main_planner"))
    if planner is None or "home_id" not in rows.columns:
        return TrialsToDraw(frozenset(), frozenset(), ())
    trials = mapped_trials(rows, planner)
    homes = rows.loc[rows["trial_id"].isin(trials), "home_id"].dropna().astype(str)
    return TrialsToDraw(frozenset(trials), frozenset(homes), compared_planners(rows, planner))


def _question(planner: str | None) -> str:
    who = f"the planner {planner_label(planner)}" if planner else "the learning-informed planner"
    return f"Does {who} beat the baselines, by how much, and how does that compare with the published results?"
