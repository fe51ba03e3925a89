"""Writes the report of a run: ``<output_dir>/report/index.html``, one file that needs no network.

Beside it lie ``table.csv``, replays, tables as LaTeX and Markdown, and figures as SVG (with ``pdf=true``, also as PDF).

On the output_dir of a sweep it compares the sweep's cells.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.report")

import tempfile
import time
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from mrtask.analysis.report.real_world import APARTMENTS, scenario_name, simulated_trial
from mrtask.analysis.results.episodes import BUDGET
from mrtask.analysis.results.published import load_published
from mrtask.execution.trace import Trace
from mrtask.homes.home import Home
from mrtask.names import counted
from pipeline.app.stage import Session, Stage
from pipeline.backends import runs
from pipeline.base import console
from pipeline.base.config import UserError, content_hash
from pipeline.base.sections import Tracking
from pipeline.episodes import outcome
from pipeline.store import layout
from pipeline.store.episode_row import TRACE
from pipeline.store.folder import Folder
from pipeline.store.layout import (
    EPISODES,
    IDENTITY,
    MANIFEST,
    OPTIMALITY,
    REPORT,
    REPORT_INDEX,
    REPORT_KEY,
    SCENARIO,
    STAGES,
)
from pipeline.store.records import EvaluatedHomes, EvaluationManifest, ReportKey, RunIdentity, StageTimes
from pipeline.store.rows import read_csv, read_episodes, read_traces
from pipeline.store.version import source_hash

if TYPE_CHECKING:
    from mrtask.analysis.report.report_page import TrialsToDraw

TABLE_ARTIFACT = "table.json"
"""In MLflow, whose page on several runs shows it side by side."""
JUDGED_COLUMNS = ["trial_id", "planner", "status", "cost_s"]


@dataclass(frozen=True)
class Collected:
    """The finished evaluations below an output folder: one, or those of a sweep's cells."""

    evaluations: tuple[tuple[Folder, EvaluationManifest], ...]
    episodes: pd.DataFrame
    """Of all of them; of a sweep with a column ``sweep``."""
    facts: Mapping[str, Any]
    """What the report says about the run; of a sweep, about its last cell."""
    optimality: pd.DataFrame | None
    """What pipeline.optimality left in the folder."""

    @property
    def manifest(self) -> EvaluationManifest:
        """That of the last evaluation."""
        return self.evaluations[-1][1]

    def key(self, pdf: bool) -> ReportKey:
        """Return the hash of all that the report depends on."""
        judged = sorted(map(str, self.episodes[JUDGED_COLUMNS].itertuples(index=False, name=None)))
        optimality = None if self.optimality is None else self.optimality.to_csv(index=False)
        return ReportKey(key=content_hash([judged, self.facts, optimality, source_hash("mrtask/analysis"), pdf]))

    def with_traces(self, wanted: "TrialsToDraw") -> pd.DataFrame:
        """The episodes with a column ``trace``, filled where it is drawn."""
        keys = [name for name in ("sweep", "trial_id", "planner") if name in self.episodes.columns]
        traces = [
            read_traces(folder / EPISODES, wanted.trial_ids, wanted.planners).assign(sweep=manifest.sweep)
            for folder, manifest in self.evaluations
        ]
        return self.episodes.merge(pd.concat(traces)[[*keys, TRACE]], how="left", on=keys)


@dataclass(frozen=True)
class ReportJob:
    """The folder whose episodes are reported, and the MLflow store that gets a copy of the report."""

    folder: Folder
    tracking: Tracking
    pdf: bool = False
    """Whether figures are drawn as PDF, too."""

    @property
    def target(self) -> Folder:
        """The report's folder."""
        return self.folder / REPORT

    def run(self, session: Session) -> None:
        """Write the report on what the folder holds, and say in short what it shows.

        Raises:
            NeverSucceeded: no episode of a planner was accepted.
        """
        episodes = self.write(session)
        outcome.say(episodes)
        outcome.check(episodes)

    def write(self, session: Session) -> pd.DataFrame:
        """Write the report unless it is up to date; return the episodes that it is about.

        The MLflow run of the evaluation, or of the sweep whose cells are compared, gets a copy if the store has it.
        """
        began_s = time.monotonic()
        collected = collect(self.folder)
        console.headline("report", counted(len(collected.episodes), "episode"))
        if self._is_current(collected):
            console.skipped(self.target / REPORT_INDEX)
            return collected.episodes
        of_sweep = session.cell.parent_run_id if not session.cell.text else None
        with tempfile.TemporaryDirectory() as temporary:
            table = _render(collected, Path(temporary), self.pdf)
            self.target.upload(Path(temporary))
            self._keep(of_sweep or collected.manifest.run_id, Path(temporary), table)
        collected.key(self.pdf).write(self.target, REPORT_KEY)
        console.result(self.target / REPORT_INDEX, time.monotonic() - began_s)
        return collected.episodes

    def _is_current(self, collected: Collected) -> bool:
        """Return whether the report is there as it would be written; one with PDF is not written again without."""
        there = self.target.read(REPORT_KEY)
        return there in {collected.key(pdf).to_json() for pdf in (True, self.pdf)}

    def _keep(self, run_id: str, rendered: Path, table: pd.DataFrame) -> None:
        tracking = runs.open_tracking(self.tracking.uri, self.tracking.experiment_name)
        kept_with = runs.Run(tracking, run_id)
        if runs.has_run(tracking, kept_with.run_id):
            runs.log_artifact(kept_with, rendered, REPORT)
            runs.log_table(kept_with, table, TABLE_ARTIFACT)
        else:
            uri = self.tracking.uri
            console.line(f"tracking.uri={uri} does not hold this evaluation: MLflow gets no copy of the report")

    def outline(self, session: Session) -> Iterator[str]:
        """Say on how many episodes the report would be."""
        collected = collect(self.folder)
        what = "is up to date" if self._is_current(collected) else "would be written"
        yield f"the report on {counted(len(collected.episodes), 'episode')} {what}: {self.target / REPORT_INDEX}"


def collect(folder: Folder) -> Collected:
    """Return what a run, or all finished cells of a sweep, have left.

    Raises:
        UserError: no evaluation has finished there.
    """
    cells = _finished(layout.cells(folder))
    if cells:
        frames = [_episodes(cell, manifest).assign(sweep=manifest.sweep) for cell, manifest in cells]
        expected = sum(manifest.expected_episodes for _, manifest in cells)
        of_sweep = {"output_dir": folder.location, "expected_episodes": expected}
        facts = cells[-1][1].facts() | of_sweep | {APARTMENTS: _apartments(folder)}
        return Collected(cells, pd.concat(frames, ignore_index=True), facts, read_csv(folder, OPTIMALITY))
    of_run = _finished([folder])
    if not of_run:
        raise UserError(
            f"no finished evaluation in {folder}; run python -m pipeline.evaluate with the same output_dir first"
        )
    [(_, manifest)] = of_run
    facts_of_run = manifest.facts(StageTimes.find(folder, STAGES)) | _asked(folder)
    facts_of_run |= {APARTMENTS: _apartments(folder)}
    return Collected(of_run, _episodes(folder, manifest), facts_of_run, read_csv(folder, OPTIMALITY))


def _asked(folder: Folder) -> dict[str, Any]:
    """Return what the run was asked for, command by command; the manifest knows only what has finished."""
    identity = RunIdentity.find(folder, IDENTITY)
    if identity is None:
        return {}
    grown = [f"{one.since}: {one.text}" for one in identity.asked]
    of_planners = {
        "planner_options": dict(identity.planner),
        "behind": dict(identity.behind),
        "likelihood": {name: dict(identity.likelihood_of(name)) for name in identity.planner},
    }
    return of_planners | {"expected_episodes": len(identity.row_keys()), "grown": grown if len(grown) > 1 else []}


def _finished(folders: list[Folder]) -> tuple[tuple[Folder, EvaluationManifest], ...]:
    found = ((folder, EvaluationManifest.read(folder, MANIFEST)) for folder in folders)
    return tuple((folder, manifest) for folder, manifest in found if manifest is not None)


def _episodes(folder: Folder, manifest: EvaluationManifest) -> pd.DataFrame:
    """A run's episodes with how many samples a decision each planner was given."""
    rows = read_episodes(folder / EPISODES)
    budgets = {name: options.get("samples") for name, options in manifest.planner_options.items()}
    return rows.assign(**{BUDGET: rows["planner"].map(budgets).astype("float64")})


def _apartments(folder: Folder) -> dict[str, dict[str, Any]]:
    """Apartment -> planner -> what ``pipeline.scenario`` left of the paper's trial there.

    Raises:
        UserError: a file of these is damaged.
    """
    found: dict[str, dict[str, Any]] = {}
    for trial in load_published().real_world:
        traces = folder / SCENARIO / scenario_name(trial) / "traces"
        for name in traces.names():
            try:
                trace = Trace.from_json((traces.read(name) or b"").decode())
            except (ValueError, KeyError, TypeError) as error:
                raise UserError(
                    f"{traces / name} is no trace of an episode ({error}); remove it, or run python -m "
                    f"pipeline.scenario name={scenario_name(trial)} output_dir={folder / SCENARIO} again"
                ) from error
            found.setdefault(trial.name, {})[name.removesuffix(".json")] = simulated_trial(trial, trace).as_dict()
    return found


def _render(collected: Collected, target: Path, pdf: bool) -> pd.DataFrame:
    """Write the report's files, draw the most telling episodes, and return the table for machines."""
    # Drawing takes seconds to import; a report that is up to date draws nothing.
    from mrtask.analysis.report.report_page import render_report, trials_to_draw, write_report

    wanted = trials_to_draw(collected.episodes, collected.facts)
    drawn = _homes(collected.manifest.homes, wanted.home_ids)
    episodes = collected.with_traces(wanted)
    rendered = render_report(episodes, collected.facts, drawn, collected.optimality, pdf=pdf)
    write_report(rendered, target / REPORT_INDEX)
    return rendered.table


def _homes(evaluated: EvaluatedHomes, ids: Collection[str]) -> dict[str, Home]:
    """Return the homes to draw, none where their files are gone."""
    source = evaluated.read_from
    if not all(path.is_file() for path in source.paths):
        console.line("the homes' files are gone: no episode is drawn")
        return {}
    return {home.id: home for home in source.read() if home.id in ids}


STAGE = Stage(lambda config: ReportJob(Folder(config.output_dir), config.tracking, config.pdf), runs.check_store)
