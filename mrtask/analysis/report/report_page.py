"""The report: one page that contains everything it shows and needs no network, with files for other uses beside it.

It opens with the answer in words, computed from the data; the sections below it are listed in
`mrtask.analysis.report.sections`. Beside it lie ``table.csv``, replays, and all tables and figures as files for papers.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from mrtask.analysis.page.exhibits import Content
from mrtask.analysis.page.rendering import PageSection, render_page, template_text
from mrtask.analysis.page.style import planner_label
from mrtask.analysis.report.for_papers import paper_files
from mrtask.analysis.report.planner_table import result_table
from mrtask.analysis.report.report_data import ReportData, collect_report_data, rows_of, variants_of
from mrtask.analysis.report.sections import SECTIONS, Section
from mrtask.analysis.report.trial_browser import compared_planners, mapped_trials
from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.roles import main_planner
from mrtask.files import replacing
from mrtask.homes.home import Home
from mrtask.planning.planners import PAPERS_PLANNER

TABLE_FILE = "table.csv"


@dataclass(frozen=True)
class TrialsToDraw:
    """The trials and planners whose traces the report needs, and the homes of these trials."""

    trial_ids: frozenset[str]
    home_ids: frozenset[str]
    planners: tuple[str, ...]


@dataclass(frozen=True)
class Report:
    """The content of the files."""

    page: str
    table: pd.DataFrame
    """The rows of `mrtask.analysis.report.planner_table.result_table`."""
    extras: Mapping[str, bytes] = field(default_factory=dict)
    """Relative path -> content of the files beside the page: ``replays/<trial>.html``, ``tables/``, ``figures/``."""


def render_report(
    episodes: pd.DataFrame,
    manifest: Mapping[str, Any],
    homes: Mapping[str, Home],
    optimality: pd.DataFrame | None = None,
    *,
    pdf: bool = False,
) -> Report:
    """The report of a run, or of a sweep.

    Args:
        episodes: one row per (trial, planner); see `mrtask.analysis.results.episodes.REQUIRED_COLUMNS`. A ``sweep``
            column tells a sweep's variants apart.
        manifest: what the run left as JSON: ``experiment, seed, planners, model {...}, homes {...}, wall_s, config,
            ...``; `mrtask.analysis.report.run_facts` reads it, and all of it is optional.
        homes: home id -> home, for drawing; trials in other homes are not drawn. `trials_to_draw` names those needed.
        pdf: whether figures are drawn as PDF, too.
        optimality: one row per trial whose lower bound was computed; see `mrtask.bounds.assess`.

    Raises:
        ValueError: a column is missing, or the episodes contradict each other.
    """
    data = collect_report_data(episodes, manifest, homes, optimality)
    contents = {section: content for section in SECTIONS if (content := section.content(data)) is not None}
    return Report(
        _page(data, contents),
        result_table(data.summaries, data.published),
        data.pages | paper_files(list(contents.values()), pdf),
    )


def write_report(report: Report, page: Path) -> None:
    """Write the page to ``page``, and ``table.csv`` and all other files beside it.

    An earlier file is replaced only by a whole new one.

    Raises:
        OSError: a file cannot be written.
    """
    table = report.table.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    for name, content in (*report.extras.items(), (TABLE_FILE, table.encode()), (page.name, report.page.encode())):
        with replacing(page.parent / name) as path:
            path.write_bytes(content)


def _page(data: ReportData, contents: Mapping[Section, Content]) -> str:
    """The HTML page: the answer, then the sections."""
    experiment = data.manifest.get("experiment")
    who = f"the planner {planner_label(data.planner)}" if data.planner else "the learning-informed planner"
    return render_page(
        f"mrtask: experiment {experiment}" if experiment else "mrtask: report",
        f"Does {who} beat the baselines, by how much, and how does that compare with the published results?",
        data.findings,
        [
            PageSection(section.anchor, section.title, content.html, section.link, content.in_short)
            for section, content in contents.items()
        ],
        episodes=len(data.episodes),
        warnings=data.warnings,
        variants=list(data.summaries),
        script=template_text("report.js"),
    )


def trials_to_draw(episodes: pd.DataFrame, manifest: Mapping[str, Any]) -> TrialsToDraw:
    """The trials that the report of these episodes draws, so that no other home or trace need be loaded."""
    checked = checked_episodes(episodes)
    rows = rows_of(checked, variants_of(checked)[-1])
    planner = main_planner(tuple(rows["planner"].unique()), manifest.get("main_planner"))
    if planner is None or "home_id" not in rows.columns:
        return TrialsToDraw(frozenset(), frozenset(), ())
    trials = mapped_trials(rows, planner)
    homes = rows.loc[rows["trial_id"].isin(trials), "home_id"].dropna().astype(str)
    papers = [PAPERS_PLANNER] if (rows["planner"] == PAPERS_PLANNER).any() else []
    planners = dict.fromkeys((*compared_planners(rows, planner), *papers))
    return TrialsToDraw(frozenset(trials), frozenset(homes), tuple(planners))
