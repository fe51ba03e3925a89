"""The data behind every section of the report: a run's checked episodes, their statistics and the answer."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from mrtask.analysis.drawing.replay_content import Episode, make_replay
from mrtask.analysis.drawing.replay_page import render_replay
from mrtask.analysis.drawing.trajectories import Pick, task_objects
from mrtask.analysis.page.rendering import Findings
from mrtask.analysis.report.answer import find, mixture_warnings
from mrtask.analysis.report.coordination import Coordination, coordination
from mrtask.analysis.report.run_facts import missing_episodes, model_warning, without_folders
from mrtask.analysis.report.trial_browser import compared_planners, notable_trials
from mrtask.analysis.results.episodes import Variant, checked_episodes, variants_in_order, without_cells
from mrtask.analysis.results.manifest import Manifest, part
from mrtask.analysis.results.optimality import CellOptimality, summarise_optimality
from mrtask.analysis.results.published import Published, load_published
from mrtask.analysis.results.roles import main_planner
from mrtask.analysis.results.statistics import Summary, summarise
from mrtask.execution.trace import Trace
from mrtask.homes.home import Home
from mrtask.planning.planners import PAPERS_PLANNER, Role, planner_role
from mrtask.tasks.automaton import build_automaton

REPLAYS = "replays"
SAFE_NAME = re.compile(r"[\w-]+")
"""Trial ids that can name a file."""


@dataclass(frozen=True)
class ReportData:
    """A run; of a sweep, all its variants, of which the last is shown in full."""

    episodes: pd.DataFrame
    """The checked episodes of all variants; see `mrtask.analysis.results.episodes.checked_episodes`."""
    manifest: Manifest
    homes: Mapping[str, Home]
    """Home id -> home, of those to be drawn."""
    summaries: Mapping[Variant, Summary]
    """By variant, in order; one, named by the empty text, without a sweep."""
    published: Published
    optimality: Sequence[CellOptimality] = ()
    """How far planners are from optimal, where that was measured."""

    @property
    def shown(self) -> Variant:
        """The variant that is shown in full."""
        return list(self.summaries)[-1]

    @property
    def summary(self) -> Summary:
        """The statistics of the variant shown."""
        return self.summaries[self.shown]

    @cached_property
    def rows(self) -> pd.DataFrame:
        """The episodes of the variant shown."""
        return rows_of(self.episodes, self.shown)

    @property
    def planner(self) -> str | None:
        """The planner that the report is about; None without episodes."""
        return main_planner(self.summary.planners, self.manifest.get("main_planner"))

    @property
    def judged(self) -> tuple[str, ...]:
        """The planners that the paper's claims are judged on: the paper's, and the main one if it is under study."""
        main = self.planner
        ours = main is not None and main != PAPERS_PLANNER and planner_role(main) is Role.OURS
        return (PAPERS_PLANNER, main) if main is not None and ours else (PAPERS_PLANNER,)

    @cached_property
    def coordination(self) -> dict[str, Coordination]:
        """How the judged planners' robots wait and go on, for those whose traces can show it."""
        found = {name: coordination(self.rows, name) for name in self.judged}
        return {name: one for name, one in found.items() if one is not None}

    @cached_property
    def picks(self) -> list[Pick]:
        """The trials worth a look, each with a reason: representative, failed, lost, or showing how robots wait."""
        picks = notable_trials(self.rows, self.planner)
        shown = self.coordination.get(self.planner or "")
        if shown is None or "home_id" not in self.rows.columns:
            return picks
        home_of = dict(zip(self.rows["trial_id"], self.rows["home_id"].astype(str), strict=True))
        for what, trials in (("a robot waits", shown.waits), ("a robot goes on", shown.goes_on)):
            picked = {pick.trial_id for pick in picks}
            picks += [Pick(trial, home_of[trial], what) for trial in trials if trial not in picked][:1]
        return picks

    @cached_property
    def _played(self) -> tuple[dict[str, str], list[str]]:
        """Trial id -> the page of its replay, and for each pick that cannot be replayed why."""
        pages: dict[str, str] = {}
        unplayable: list[str] = []
        if not {"trace", "template", "formula", "objects"} <= set(self.rows.columns):
            return pages, unplayable
        planners = compared_planners(self.rows, self.planner)
        for pick in self.picks:
            if pick.home_id not in self.homes or not SAFE_NAME.fullmatch(pick.trial_id):
                continue
            rows = self.rows[(self.rows["trial_id"] == pick.trial_id) & self.rows["trace"].notna()]
            found = {row["planner"]: row for row in rows.to_dict("records")}
            try:
                shown = [found[name] for name in planners if name in found]
                pages |= _replay(pick, shown, self.homes[pick.home_id], self.called)
            except ValueError as error:
                unplayable.append(f"Trial {pick.trial_id} cannot be replayed: {error}")
        return pages, unplayable

    @property
    def pages(self) -> dict[str, bytes]:
        """Path beside the report -> the page of a replay."""
        return {self.replays[trial_id]: page.encode() for trial_id, page in self._played[0].items()}

    @property
    def replays(self) -> dict[str, str]:
        """Trial id -> the path of its replay beside the report."""
        return {trial_id: f"{REPLAYS}/{trial_id}.html" for trial_id in self._played[0]}

    @cached_property
    def findings(self) -> Findings:
        """The answer for the variant shown."""
        return find(self.summary, self.published, self.planner)

    @property
    def called(self) -> tuple[str, ...]:
        """The robots' names, empty for one without."""
        robots = part(part(self.manifest, "config"), "team").get("robots") or ()
        return tuple(str(robot.get("name") or "") for robot in robots)

    @property
    def _no_cells(self) -> str | None:
        """Why some costs are not in grid cells."""
        if not without_cells(self.rows):
            return None
        return (
            "Robots of the team differ in speed, so a second is not one number of grid cells: where they do, costs are "
            "in seconds only, and no cost stands beside those published for robots that are all alike."
        )

    @property
    def warnings(self) -> list[str]:
        """All warnings that a reader should see before trusting the answer."""
        of_run = (missing_episodes(self.manifest, self.episodes), model_warning(self.manifest), self._no_cells)
        found = [*self.findings.warnings, *mixture_warnings(self.rows), *of_run, *self._played[1]]
        return [text for text in found if text]


def _replay(pick: Pick, rows: Sequence[Mapping[Any, Any]], home: Home, called: Sequence[str]) -> dict[str, str]:
    """The page of a trial from the rows of the planners to be shown; empty without rows.

    It has no reasons for the decisions, since those would take another run.

    Raises:
        ValueError: a row holds no formula, or names a place that the home lacks.
    """
    if not rows:
        return {}
    first = rows[0]
    automaton = build_automaton(first["formula"], task_objects(first["objects"]))
    episodes = []
    for row in rows:
        accepted, trace = row["status"] == "accepted", Trace.from_json(row["trace"])
        cost_s, error = (row["cost_s"], None) if accepted else (None, str(row.get("error") or ""))
        episodes.append(Episode(row["planner"], row["status"], cost_s, error, trace))
    replay = make_replay(pick.trial_id, first["size_class"], first["template"], automaton, home, episodes, called)
    return {pick.trial_id: render_replay(replay)}


def collect_report_data(
    episodes: pd.DataFrame, manifest: Manifest, homes: Mapping[str, Home], optimality: pd.DataFrame | None = None
) -> ReportData:
    """Checks the episodes and computes their statistics.

    Args:
        optimality: the rows of `mrtask.bounds.assess`, where there are any.

    Raises:
        ValueError: the episodes are not what `checked_episodes` demands.
    """
    checked = checked_episodes(episodes)
    if "error" in checked.columns:
        checked = checked.assign(error=[without_folders(text, Path.cwd()) for text in checked["error"]])
    summaries = {variant: summarise(rows_of(checked, variant)) for variant in variants_of(checked)}
    from_optimal = summarise_optimality(optimality) if optimality is not None else ()
    shown = without_folders(manifest, Path.cwd())
    return ReportData(checked, shown, homes, summaries, load_published(), from_optimal)


def variants_of(episodes: pd.DataFrame) -> list[Variant]:
    """The variants of checked episodes in order; the one unnamed variant where there are no episodes."""
    return variants_in_order(episodes) or [""]


def rows_of(episodes: pd.DataFrame, variant: Variant) -> pd.DataFrame:
    """The checked episodes of one variant."""
    return episodes[episodes["variant"] == variant]
