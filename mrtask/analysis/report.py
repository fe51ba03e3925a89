"""The report: one ``index.html`` that holds everything it shows and needs no network, and ``table.csv`` beside it.

It opens with the answer, in words computed from the data; the sections below are listed in `mrtask.analysis.sections`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from mrtask.analysis.episodes import checked_episodes
from mrtask.analysis.findings import main_planner
from mrtask.analysis.report_data import ReportData, collect_report_data, rows_of, variants_of
from mrtask.analysis.result_table import result_table
from mrtask.analysis.sections import SECTIONS
from mrtask.analysis.style import planner_label
from mrtask.analysis.templating import render_fragment
from mrtask.analysis.trajectories import Pick, baseline_beside, instructive_trials
from mrtask.files import replacing
from mrtask.homes.home import Home

REPORT_FILE, TABLE_FILE = "index.html", "table.csv"


@dataclass(frozen=True)
class Report:
    """The content of the two files."""

    page: str
    table: str


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
    table = result_table(data.summaries, data.published)
    return Report(render_page(data), table.to_csv(index=False, float_format="%.6g", lineterminator="\n"))


def write_report(report: Report, out_dir: Path) -> Path:
    """Writes ``table.csv`` and ``index.html`` into ``out_dir`` and returns the path of the latter.

    An earlier file is replaced only by a whole new one.

    Raises:
        OSError: a file cannot be written.
    """
    for name, text in ((TABLE_FILE, report.table), (REPORT_FILE, report.page)):
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
    return render_fragment(
        "page",
        title=f"mrtask: experiment {experiment}" if experiment else "mrtask: report",
        question=_question(data.planner),
        findings=data.findings,
        warnings=data.warnings,
        variants=len(data.summaries),
        shown=data.shown,
        sections=sections,
        episodes=len(data.episodes),
    )


def trials_to_draw(episodes: pd.DataFrame, manifest: Mapping[str, Any]) -> list[Pick]:
    """The trials that the report of these episodes draws, so that no other home or trace needs to be loaded."""
    checked = checked_episodes(episodes)
    rows = rows_of(checked, variants_of(checked)[-1])
    planner = main_planner(tuple(rows["planner"].unique()), manifest.get("main_planner"))
    if planner is None:
        return []
    return instructive_trials(rows, planner, baseline_beside(rows["planner"], planner))


def _question(planner: str | None) -> str:
    who = f"the planner {planner_label(planner)}" if planner else "the learning-informed planner"
    return f"Does {who} beat the baselines, by how much, and how does that compare with the published results?"
