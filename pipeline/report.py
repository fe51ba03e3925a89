"""Writes the report of a run: ``<output_dir>/report/index.html``, one file that needs no network.

Beside it lie ``table.csv``, replays, every table as LaTeX and Markdown, every figure as PDF and SVG.

On the output_dir of a sweep it compares the sweep's cells.
"""

import tempfile
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from mrtask.analysis.report.real_world import APARTMENTS, scenario_name, simulated_trial
from mrtask.analysis.report.report_page import TrialsToDraw, render_report, trials_to_draw, write_report
from mrtask.analysis.report.search_curves import BUDGET
from mrtask.analysis.results.published import load_published
from mrtask.execution.trace import Trace
from mrtask.homes.home import Home
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.backends import tracking
from pipeline.base import console
from pipeline.base.config import Config, UserError, content_hash
from pipeline.base.sections import Tracking
from pipeline.store import layout
from pipeline.store.episode_row import TRACE
from pipeline.store.folder import Folder, locked
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

    def with_traces(self, wanted: TrialsToDraw) -> pd.DataFrame:
        """The episodes with a column ``trace``, filled where it is drawn."""
        keys = [name for name in ("sweep", "trial_id", "planner") if name in self.episodes.columns]
        traces = [
            read_traces(folder / EPISODES, wanted.trial_ids, wanted.planners).assign(sweep=manifest.sweep)
            for folder, manifest in self.evaluations
        ]
        return self.episodes.merge(pd.concat(traces)[[*keys, TRACE]], how="left", on=keys)


def run(config: Config, session: Session) -> None:
    """The stage."""
    folder = Folder(config.output_dir)
    with locked(folder, config.cache_dir):
        report(folder, config.tracking)


def compare_cells(config: Config, run_id: str | None) -> None:
    """The report of a sweep, kept with the sweep's MLflow run."""
    report(Folder(config.output_dir), config.tracking, run_id)


def report(folder: Folder, registry: Tracking, run_id: str | None = None) -> Folder:
    """The folder of the report on what an output folder holds; the report is written unless it is there already.

    It is kept with the MLflow run ``run_id`` too, if the store has it; by default with that of the evaluation.
    """
    began_s = time.monotonic()
    collected = collect(folder)
    console.headline("report", f"{len(collected.episodes)} episodes")
    target = folder / REPORT
    digest = content_hash(
        [_digest(collected.episodes), collected.facts, _as_text(collected.optimality), source_hash("mrtask/analysis")]
    )
    key = ReportKey(key=digest)
    if target.read(REPORT_KEY) == key.to_json():
        console.skipped(target / REPORT_INDEX)
        return target
    with tempfile.TemporaryDirectory() as temporary:
        table = _render(collected, Path(temporary))
        target.upload(Path(temporary))
        store = tracking.open_tracking(registry.uri, registry.experiment_name)
        kept_with = tracking.Run(store, run_id or collected.manifest.run_id)
        if tracking.has_run(store, kept_with.run_id):
            tracking.log_artifact(kept_with, Path(temporary), REPORT)
            tracking.log_table(kept_with, table, TABLE_ARTIFACT)
        else:
            console.line(
                f"tracking.uri={registry.uri} does not hold this evaluation: MLflow gets no copy of the report"
            )
    key.write(target, REPORT_KEY)
    console.result(target / REPORT_INDEX, time.monotonic() - began_s)
    return target


def collect(folder: Folder) -> Collected:
    """What a run, or all finished cells of a sweep, have left.

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
    """What the run was asked for, bit by bit, which may be more than the manifest of its last end knows of."""
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


def _render(collected: Collected, target: Path) -> pd.DataFrame:
    """Writes the report's files, with those episodes drawn that show most, and returns its table for machines."""
    wanted = trials_to_draw(collected.episodes, collected.facts)
    drawn = _homes(collected.manifest.homes, wanted.home_ids)
    episodes = collected.with_traces(wanted)
    rendered = render_report(episodes, collected.facts, drawn, collected.optimality)
    write_report(rendered, target / REPORT_INDEX)
    return rendered.table


def _digest(episodes: pd.DataFrame) -> str:
    return content_hash(sorted(map(str, episodes[JUDGED_COLUMNS].itertuples(index=False, name=None))))


def _as_text(rows: pd.DataFrame | None) -> str | None:
    return None if rows is None else rows.to_csv(index=False)


def _homes(evaluated: EvaluatedHomes, ids: Collection[str]) -> dict[str, Home]:
    """The homes to be drawn; those whose files are gone are left out."""
    source = evaluated.read_from
    if not all(path.is_file() for path in source.paths):
        console.line("the homes' files are gone: no episode is drawn")
        return {}
    return {home.id: home for home in source.read() if home.id in ids}


STAGE = Stage(run)

if __name__ == "__main__":
    main("pipeline.report")
