"""Runs every planner on every trial and writes one row per episode to ``<output_dir>/episodes`` (Parquet).

Interrupted or run again with the same output_dir, it continues where it stopped: finished rows are kept. Asked there
for more planners, team sizes, size classes or trials per cell, it adds their rows; asked for fewer, it removes none. A
configuration that would change existing rows is refused (overwrite=true starts anew). dry_run=true says how long it
would take.
"""

import contextlib
import math
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

from mrtask.analysis.page.style import planner_label
from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.roles import BASELINES
from mrtask.analysis.results.statistics import summarise
from pipeline import report
from pipeline.app.main import main
from pipeline.app.stage import Cell, Session, Stage
from pipeline.backends import registry, runs
from pipeline.base import console
from pipeline.base.config import UserError, content_hash
from pipeline.base.specs import EvaluationSpec
from pipeline.episodes.plan import EvaluationPlan, check, prepare
from pipeline.episodes.runner import map_homes, pilot, run_episodes
from pipeline.inputs.training import find_record
from pipeline.store import cache, layout
from pipeline.store.artifacts import NotMade
from pipeline.store.folder import Folder
from pipeline.store.layout import EPISODES, IDENTITY, MANIFEST, RUN_ID
from pipeline.store.records import EvaluationManifest, Machine, Reach, RunIdentity
from pipeline.store.rows import EpisodeWriter, read_episodes, read_table
from pipeline.store.version import package_versions


@dataclass(frozen=True)
class EvaluateJob:
    """The evaluation."""

    spec: EvaluationSpec

    def run(self, session: Session) -> None:
        """Run the episodes that are missing."""
        evaluate(prepare(self.spec, session.pool), session)

    def outline(self, session: Session) -> Iterator[str]:
        """Say how many episodes would run, and for how long, from a short pilot."""
        options = self.spec.options
        check(options)
        trials = options.trials_per_cell * len(options.size_classes) * len(options.robots)
        planners = len(self.spec.planners)
        yield f"would run {trials} trials x {planners} planners = {trials * planners} episodes"
        try:
            plan = prepare(self.spec, session.pool)
        except NotMade as missing:
            yield f"{missing}; then a dry run can say how long they take"
        else:
            yield from pilot(plan, session.pool)


def evaluate(plan: EvaluationPlan, session: Session) -> None:
    """Run the episodes that the plan's folder lacks as one MLflow run, and leave the evaluation's manifest.

    Raises:
        UserError: the run would change rows that the folder holds, or too many episodes fail.
    """
    spec, total, planners = plan.spec, len(plan.keys), len(plan.planners)
    console.headline(
        "evaluate",
        f"{total // planners} trials x {planners} planners = {total} episodes, "
        f"model version {plan.identity.model_version}",
    )
    began_s, started, folder = time.monotonic(), datetime.now(UTC), Folder(spec.output_dir)
    unsent = spec.homes.datasets_dir / "unsent" / content_hash([folder.location, plan.identity.content(())])
    if spec.overwrite:
        layout.forget_episodes(folder)
        shutil.rmtree(unsent, ignore_errors=True)
    cache.trim(spec.maps.cache_dir, spec.cache_limit_gb * 2**30)
    identity = _join(folder, plan.identity)
    writer = EpisodeWriter(folder / EPISODES, spec.options.rerun, plan.identity.row_keys(), unsent)
    missing = plan.missing(writer.finished())
    earlier = EvaluationManifest.find(folder, MANIFEST)
    if not missing and earlier is not None and earlier.expected_episodes == len(identity.row_keys()):
        writer.close()
        console.skipped(folder / EPISODES)
        return
    if len(missing) < total:
        console.line(f"{total - len(missing)} episodes are there already")
    session.pool.start()
    with _tracked(plan, folder, session.cell) as run:
        reach = map_homes(plan.context, session.pool)
        run_episodes(plan, missing, session.pool, writer, runs.LiveMetrics(run))
        manifest = _manifest(
            plan, identity, session, reach=reach, started=started, wall_s=time.monotonic() - began_s, run_id=run.run_id
        )
        runs.log_metrics(run, _metrics(folder / EPISODES))
    manifest.write(folder, MANIFEST)
    console.result(folder / EPISODES, time.monotonic() - began_s)


def _join(folder: Folder, identity: RunIdentity) -> RunIdentity:
    """Write and return the identity of a new run, or of the run in the folder grown by what is asked for now.

    Raises:
        UserError: the run would change existing rows; the message lists every difference.
    """
    recorded = RunIdentity.read(folder, IDENTITY)
    if recorded is None:
        identity.write(folder, IDENTITY)
        return identity
    if changed := recorded.conflicts(identity):
        listed = "\n".join(f"  {line}" for line in changed)
        raise UserError(
            f"{folder} holds episodes of another configuration:\n{listed}\n"
            "Give another output_dir, or overwrite=true to start anew there"
        )
    joined, now = recorded.joined(identity), identity.row_keys()
    if joined is not recorded:
        before, after = len(recorded.row_keys()), len(joined.row_keys())
        console.line(f"the run there grows from {before} to {after} episodes: {identity.asked[0].text}")
        joined.write(folder, IDENTITY)
    if more := len(joined.row_keys() - now):
        console.line(f"the run there has {more} episodes that are not asked for now; they are kept")
    return joined


@contextlib.contextmanager
def _tracked(plan: EvaluationPlan, folder: Folder, cell: Cell) -> Iterator[runs.Run]:
    """Begin the MLflow run, and end one that a killed driver has left open."""
    tracking = runs.open_tracking(plan.spec.tracking.uri, plan.spec.tracking.experiment_name)
    params = {key: value for key, value in plan.spec.record.items() if key not in ("cluster", "tracking")}
    tags = {
        "stage": "evaluate",
        "model_version": plan.identity.model_version,
        "output_dir": folder.location,
        "code_version": plan.context.provenance.code_version,
        "sweep": cell.text,
    }
    if (earlier := folder.read(RUN_ID)) is not None:
        runs.end_abandoned(tracking, earlier.decode())
    name = cell.title or f"evaluate {plan.spec.experiment}"
    with runs.run(tracking, name, params, tags, cell.parent_run_id) as run:
        folder.write(RUN_ID, run.run_id.encode())
        yield run


def _metrics(episodes: Folder) -> dict[str, float]:
    """Return for MLflow each planner's accepted share, mean cost and improvements in each cell, with 95 % intervals."""
    summary = summarise(checked_episodes(read_episodes(episodes)))
    metrics = {}
    for cell in summary.cells:
        for planner in summary.planners:
            if (found := summary.planner_cells.get((cell, planner))) is None:
                continue
            name = f"{planner_label(planner)}/{cell[0]}_{cell[1]}"
            metrics[f"{name}/accepted"] = found.accepted / found.episodes
            estimates = {"cost_cells": found.cost_cells} | {
                f"percent_better_than_{baseline}": summary.improvement(cell, planner, baseline)
                for baseline in BASELINES
            }
            for what, estimate in estimates.items():
                values = {"": estimate.value, "_low": estimate.low, "_high": estimate.high}
                metrics |= {f"{name}/{what}{end}": value for end, value in values.items() if math.isfinite(value)}
    return metrics


def _manifest(
    plan: EvaluationPlan,
    identity: RunIdentity,
    session: Session,
    *,
    reach: Reach,
    started: datetime,
    wall_s: float,
    run_id: str,
) -> EvaluationManifest:
    spec, made_by = plan.spec, plan.context.provenance
    episodes = Folder(spec.output_dir) / EPISODES
    peaks_mb = read_table(episodes, ["peak_memory_mb"]).to_pandas()["peak_memory_mb"]
    return EvaluationManifest(
        experiment=spec.experiment,
        seed=spec.seed,
        output_dir=spec.output_dir,
        planners=tuple(identity.planner),
        planner_options=identity.planner,
        expected_episodes=len(identity.row_keys()),
        config=spec.record,
        model_version=made_by.model_version,
        config_hash=identity.config_hash(),
        code_version=made_by.code_version,
        model=find_record(spec.homes.datasets_dir, spec.tracking.uri, made_by.model_version),
        model_name=registry.MODEL_NAME,
        homes=plan.homes,
        true_likelihoods="drawn" if plan.contents_are_drawn else "counted",
        reach=reach,
        machine=Machine.here(session.pool.slots),
        packages=package_versions(),
        peak_memory_mb=round(float(peaks_mb.max()), 1) if peaks_mb.notna().any() else None,
        started=started.isoformat(timespec="seconds"),
        wall_s=round(wall_s, 1),
        run_id=run_id,
        sweep=session.cell.text,
    )


STAGE = Stage(lambda config: EvaluateJob(config.evaluation_spec()), compare=report.STAGE)

if __name__ == "__main__":
    main("pipeline.evaluate")
