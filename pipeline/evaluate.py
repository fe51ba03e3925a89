"""Runs every planner on every trial and writes one row per episode to ``<output_dir>/episodes`` (Parquet).

Interrupted or run again with the same output_dir, it continues where it stopped: finished rows are kept. Asked there
for more planners, team sizes, size classes or trials per cell, it adds their rows; asked for fewer, it removes none. A
configuration that would change existing rows is refused (overwrite=true starts anew). dry_run=true says how long it
would take.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.evaluate")

import contextlib
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import pandas as pd

from mrtask.analysis.studies.calibration import reliability_in_homes
from mrtask.names import counted
from pipeline import report
from pipeline.app.stage import Cell, Session, Stage
from pipeline.backends import registry, runs
from pipeline.base import console
from pipeline.base.config import Config, UserError, content_hash
from pipeline.base.specs import EvaluationSpec
from pipeline.episodes import outcome
from pipeline.episodes import plan as plans
from pipeline.episodes.plan import EvaluationPlan, prepare
from pipeline.episodes.runner import map_homes, pilot, run_episodes
from pipeline.episodes.worker import Context
from pipeline.inputs.training import find_record
from pipeline.store import cache, layout
from pipeline.store.artifacts import NotMade
from pipeline.store.folder import Folder
from pipeline.store.layout import EPISODES, IDENTITY, MANIFEST, RUN_ID
from pipeline.store.records import EvaluationManifest, Machine, Reach, RunIdentity
from pipeline.store.rows import EpisodeWriter, read_episodes, read_table
from pipeline.store.version import package_versions

METRICS_ARTIFACT = "metrics.json"
"""In MLflow: the table of all planners' metrics, where they are too many to be listed."""


@dataclass(frozen=True)
class EvaluateJob:
    """The evaluation."""

    spec: EvaluationSpec

    def run(self, session: Session) -> None:
        """Run the episodes that are missing, and say what all of them show.

        Raises:
            NeverSucceeded: no episode of a planner was accepted.
        """
        plan = prepare(self.spec, session.pool)
        episodes = evaluate(plan, session)
        outcome.say(episodes)
        outcome.check(episodes, plan.planners)

    def outline(self, session: Session) -> Iterator[str]:
        """Say how many episodes would run, and for how long, from a short pilot."""
        options = self.spec.options
        trials = options.trials_per_cell * len(options.size_classes) * len(options.robots)
        planners = len(self.spec.planners)
        yield f"would run {product(trials, planners)}"
        try:
            plan = prepare(self.spec, session.pool)
        except NotMade as missing:
            yield f"{missing}; then a dry run can say how long they take"
        else:
            yield from pilot(plan, session.pool)


def evaluate(plan: EvaluationPlan, session: Session) -> pd.DataFrame:
    """Run the episodes that the plan's folder lacks as one MLflow run, and leave the evaluation's manifest.

    Returns:
        All of the folder's episodes, without their traces.

    Raises:
        UserError: the run would change rows that the folder holds, or too many episodes fail.
    """
    spec, total, planners = plan.spec, len(plan.keys), len(plan.planners)
    console.headline(
        "evaluate",
        f"{product(total // planners, planners)}, model version {plan.identity.model_version}",
    )
    began_s, started, folder = time.monotonic(), datetime.now(UTC), Folder(spec.output_dir)
    unsent = spec.homes.datasets_dir / "unsent" / content_hash([folder.location, plan.identity.content(())])
    if spec.overwrite:
        session.pool.start()  # an unusable cluster must not cost what is there
        layout.forget_episodes(folder)
        shutil.rmtree(unsent, ignore_errors=True)
    cache.trim(spec.maps.cache_dir, spec.cache_limit_gb * 2**30)
    identity = _joined(folder, plan.identity)
    champion = _champion(plan)
    writer = EpisodeWriter(
        folder / EPISODES,
        spec.options.rerun,
        plan.identity.row_keys(),
        lambda: identity.write(folder, IDENTITY),
        unsent,
    )
    finished = writer.finished()
    missing = plan.missing(finished)
    if more := len(finished - plan.identity.row_keys()):
        console.line(f"the run there has {more} episodes that are not asked for now; they are kept")
    earlier = EvaluationManifest.find(folder, MANIFEST)
    if not missing and earlier is not None and earlier.expected_episodes == len(identity.row_keys()):
        writer.close()
        console.skipped(folder / EPISODES)
        return read_episodes(folder / EPISODES)
    if len(missing) < total:
        console.line(f"there already: {counted(total - len(missing), 'episode')}")
    session.pool.start()
    with _tracked(plan, folder, session.cell) as run:
        reach = map_homes(plan.context, session.pool)
        run_episodes(plan, missing, session.pool, writer, runs.LiveMetrics(run))
        manifest = _manifest(
            plan,
            identity,
            session,
            champion=champion,
            reach=reach,
            started=started,
            wall_s=time.monotonic() - began_s,
            run_id=run.run_id,
        )
        episodes = read_episodes(folder / EPISODES)
        _conclude(run, episodes)
    manifest.write(folder, MANIFEST)
    console.result(folder / EPISODES, time.monotonic() - began_s)
    return episodes


def _champion(plan: EvaluationPlan) -> str | None:
    """Return the version that is champion, and say so where planners use another."""
    tracking = runs.open_tracking(plan.spec.tracking.uri, plan.spec.tracking.experiment_name)
    champion, used = registry.champion_version(tracking), plan.identity.model_version
    if champion not in (None, used):
        console.line(f"planners use version {used} of the model; the champion is version {champion}")
    return champion


def product(trials: int, planners: int) -> str:
    """Return ``9 trials x 1 planner = 9 episodes``."""
    episodes = counted(trials * planners, "episode")
    return f"{counted(trials, 'trial')} x {counted(planners, 'planner')} = {episodes}"


def _joined(folder: Folder, identity: RunIdentity) -> RunIdentity:
    """Return the identity of a new run, or of the run in the folder grown by what is asked for now.

    Raises:
        UserError: the run would change existing rows; the message lists every difference.
    """
    recorded = RunIdentity.read(folder, IDENTITY)
    if recorded is None:
        return identity
    if changed := recorded.conflicts(identity):
        listed = "\n".join(f"  {line}" for line in changed)
        raise UserError(
            f"{folder} holds episodes of another configuration:\n{listed}\n"
            "Give another output_dir, or overwrite=true to start anew there"
        )
    joined = recorded.joined(identity)
    if joined is not recorded:
        before, after = len(recorded.row_keys()), len(joined.row_keys())
        console.line(f"the run there grows from {before} to {after} episodes: {identity.asked[0].text}")
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
        runs.SWEEP: cell.text,
    }
    if (earlier := folder.read(RUN_ID)) is not None:
        runs.end_abandoned(tracking, earlier.decode())
    name = cell.title or runs.name_of(plan.spec.output_dir)
    with runs.run(tracking, name, params, tags, cell.parent_run_id) as run:
        folder.write(RUN_ID, run.run_id.encode())
        homes = pd.DataFrame(
            [(home.id, home.size_class, len(home.containers)) for home in plan.context.homes],
            columns=["home_id", "size_class", "containers"],
        )
        model_id = registry.logged_model_id(tracking, plan.identity.model_version)
        runs.log_evaluated(run, homes, plan.homes.source, plan.identity.evaluated_homes, model_id)
        yield run


def _conclude(run: runs.Run, episodes: pd.DataFrame) -> None:
    """Log the evaluation's metrics, and its headline as the run's description."""
    # These import what draws; where every episode is there already, they are not needed.
    from mrtask.analysis.results.episodes import checked_episodes
    from mrtask.analysis.results.statistics import summarise
    from pipeline.episodes.metrics import headline_of, metrics_of, most_telling, table_of

    summary = summarise(checked_episodes(episodes))
    listed = most_telling(summary)
    runs.log_metrics(run, metrics_of(summary, listed))
    if len(listed) < len(summary.planners):
        runs.log_table(run, table_of(summary), METRICS_ARTIFACT)
    runs.describe(run, headline_of(summary))


def _manifest(
    plan: EvaluationPlan,
    identity: RunIdentity,
    session: Session,
    *,
    champion: str | None,
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
        champion_version=champion,
        rivals=plan.rivals,
        homes=plan.homes,
        true_likelihoods="drawn" if plan.contents_are_drawn else "counted",
        reach=reach,
        reliability=_reliability(plan.context),
        machine=Machine.here(session.pool.slots),
        packages=package_versions(),
        peak_memory_mb=round(float(peaks_mb.max()), 1) if peaks_mb.notna().any() else None,
        started=started.isoformat(timespec="seconds"),
        wall_s=round(wall_s, 1),
        run_id=run_id,
        sweep=session.cell.text,
    )


def _reliability(context: Context) -> tuple[dict[str, Any], ...]:
    bins = reliability_in_homes(context.homes, context.table)
    rows = bins.astype(object).where(bins.notna(), None).to_dict("records")
    return tuple({str(column): value for column, value in row.items()} for row in rows)


def check(config: Config) -> None:
    """Refuse a task that is none, homes that are not there, and a store that cannot be used."""
    plans.check(config.evaluation)
    if not runs.is_new(config.tracking.uri):  # a new one holds no model, and refusing it must not make it
        runs.check_store(config)


STAGE = Stage(lambda config: EvaluateJob(config.evaluation_spec()), check, compare=report.STAGE, side_by_side=True)
