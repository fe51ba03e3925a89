"""Runs every planner on every trial and writes one row per episode to ``<output_dir>/episodes`` (Parquet).

Interrupted or run again with the same output_dir, it goes on where it stopped: finished rows are kept. A changed
configuration is refused there (overwrite=true starts anew). dry_run=true says how long it would take.
"""

import json
import platform
import statistics
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import psutil

from mrtask.planning.planners import PLANNERS
from pipeline import homes
from pipeline.app import sweep
from pipeline.app.main import main
from pipeline.backends import tracking
from pipeline.backends.pool import Outcome, Pool
from pipeline.backends.tracking import RegisteredModel
from pipeline.base import console
from pipeline.base.config import Config, UserError
from pipeline.episodes.plan import EPISODES, IDENTITY, MANIFEST, Evaluation, check, prepare
from pipeline.episodes.tally import Tally
from pipeline.episodes.worker import Context, EpisodeKey, failed_row, map_home, run_one, warm
from pipeline.store import cache
from pipeline.store.folder import Folder, locked
from pipeline.store.home_set import HomeSet
from pipeline.store.rows import EpisodeWriter, differences, read_table
from pipeline.store.version import code_version
from pipeline.train import find_record

RUN_ID = "mlflow_run_id"
"""File in the output folder that names the MLflow run under way, or the last one."""
PILOT_S = 20.0


def run(config: Config, pool: Pool) -> None:
    """The stage."""
    check(config)
    store = tracking.open_tracking(config.tracking.uri, config.tracking.experiment_name)
    with locked(Folder(config.output_dir), config.cache_dir):
        model = load_model(config, store)
        evaluate(config, pool, homes.run(config, pool), store, model)


def evaluate(config: Config, pool: Pool, home_set: HomeSet, store: tracking.Tracking, model: RegisteredModel) -> None:
    """Runs the episodes that are missing in the output folder, which the caller has locked."""
    folder, began_s, started = Folder(config.output_dir), time.monotonic(), datetime.now(UTC)
    evaluation = prepare(config, home_set, model)
    total, planners = len(evaluation.keys), len(config.evaluation.planners)
    console.headline(
        "evaluate",
        f"{total // planners} trials x {planners} planners = {total} episodes, model version {model.version}",
    )
    if config.dry_run:
        _pilot(config, pool, evaluation)
        return
    sweep.want_report()
    if config.overwrite:
        for name in (EPISODES, IDENTITY, MANIFEST, "report", "stages.json"):
            folder.remove(name)
    _check_identity(folder, evaluation.identity)
    writer = EpisodeWriter(folder / EPISODES, config.evaluation.rerun)
    done = writer.finished()
    missing = [key for key in evaluation.keys if (key.trial_id, key.planner) not in done]
    if not missing and folder.read(MANIFEST) is not None:
        writer.close()
        console.skipped(folder / EPISODES)
        return
    if done:
        console.line(f"{total - len(missing)} episodes are there already")
    pool.start()
    cache.trim(config.cache_dir, config.cache_limit_gb * 2**30)
    params = config.model_dump(mode="json", exclude={"cluster", "tracking"})
    tags = {
        "stage": "evaluate",
        "model_version": model.version,
        "output_dir": config.output_dir,
        "code_version": code_version(),
        "sweep": sweep.cell_text(),
    }
    name = sweep.short_cell_text() or f"evaluate {config.experiment}"
    if (earlier := folder.read(RUN_ID)) is not None:
        tracking.end_abandoned(store, earlier.decode())
    with tracking.run(store, name, params, tags, sweep.parent_run_id()) as tracked:
        folder.write(RUN_ID, tracked.run_id.encode())
        reach = _map_homes(evaluation.context, pool)
        _run_episodes(config, pool, evaluation, missing, writer)
        manifest = _manifest(config, evaluation, reach, pool) | {
            "started": started.isoformat(timespec="seconds"),
            "wall_s": round(time.monotonic() - began_s, 1),
            "run_id": tracked.run_id,
            "sweep": sweep.cell_text(),
        }
        tracking.log_metrics(tracked, _metrics(folder))
    folder.write(MANIFEST, json.dumps(manifest, indent=1, default=str).encode())
    console.result(folder / EPISODES, time.monotonic() - began_s)


def load_model(config: Config, store: tracking.Tracking) -> RegisteredModel:
    """The configured model; for a run that is continued, the version it began with."""
    uri = config.evaluation.model_uri
    recorded = Folder(config.output_dir).read(IDENTITY)
    if recorded is not None and uri == tracking.CHAMPION_URI and not config.overwrite:
        uri = f"models:/{tracking.MODEL_NAME}/{json.loads(recorded)['model_version']}"
    return tracking.load_registered(store, uri, config.cache_dir)


def row_of(outcome: Outcome[EpisodeKey, dict[str, Any]], context: Context) -> dict[str, Any]:
    """An episode's row, whatever became of it."""
    if outcome.value is not None:
        return outcome.value | {"attempt": outcome.attempt}
    if outcome.failure is None:
        raise ValueError(f"{outcome.item} has neither a value nor a failure")
    status = "timeout" if outcome.failure.kind == "timeout" else "error"
    return failed_row(outcome.item, context, status, outcome.failure.message) | {"attempt": outcome.attempt}


def _check_identity(folder: Folder, identity: Mapping[str, Any]) -> None:
    recorded = folder.read(IDENTITY)
    if recorded is None:
        folder.write(IDENTITY, json.dumps(identity, indent=1).encode())
        return
    changed = list(differences(json.loads(recorded), json.loads(json.dumps(identity))))
    if changed:
        listed = "\n".join(f"  {line}" for line in changed)
        raise UserError(
            f"{folder} holds episodes of another configuration:\n{listed}\n"
            "Give another output_dir, or overwrite=true to start anew there"
        )


def _map_homes(context: Context, pool: Pool) -> dict[str, int]:
    """Maps all homes into the cache; returns how many containers there are and how many can be reached."""
    # Compiled once here, so that the workers find the kernels in numba's cache.
    context.maps.map_of(context.homes[0])
    reach: defaultdict[str, int] = defaultdict(int)
    with console.Progress(len(context.homes), "homes mapped") as progress:
        for outcome in pool.run(map_home, range(len(context.homes)), context):
            if outcome is None:
                continue
            if outcome.value is None:
                raise RuntimeError(f"home {context.homes[outcome.item].id} could not be mapped: {outcome.failure}")
            reach["containers"] += outcome.value.containers
            reach["reachable"] += outcome.value.reachable
            progress.update()
    share = reach["reachable"] / reach["containers"]
    console.line(f"{len(context.homes)} homes mapped, {share:.2%} of their containers reachable")
    return dict(reach)


def _run_episodes(
    config: Config, pool: Pool, evaluation: Evaluation, missing: Sequence[EpisodeKey], writer: EpisodeWriter
) -> None:
    tally = Tally(config.evaluation.planners, config.evaluation.max_failed_fraction)
    _warm_kernels(evaluation.context, missing)
    done = len(evaluation.keys) - len(missing)
    try:
        with console.Progress(len(evaluation.keys), "episodes", done) as progress:
            for outcome in pool.run(
                run_one, missing, evaluation.context, timeout_s=config.evaluation.episode_timeout_s
            ):
                if outcome is None:
                    writer.tick()
                    progress.update(0)
                    continue
                row = row_of(outcome, evaluation.context)
                writer.add(row)
                tally.add(row)
                progress.update(note=tally.note())
    finally:
        # Also on an interrupt: what is finished stays.
        writer.close()


def _warm_kernels(context: Context, missing: Sequence[EpisodeKey]) -> None:
    """Compiles the planners' kernels in the driver, once for all workers. A user's own planner runs in workers only."""
    for name, key in {key.planner: key for key in reversed(missing)}.items():
        if name in PLANNERS:
            try:
                warm(key, context)
            except Exception as error:  # the run goes on: its episodes will be rows of status error
                console.line(f"{name} failed on {key.trial_id} already in the driver: {error}")


def _pilot(config: Config, pool: Pool, evaluation: Evaluation) -> None:
    """Times some episodes and says how long all of them would take."""
    _warm_kernels(evaluation.context, evaluation.keys)
    spent_s: defaultdict[str, list[tuple[float, float]]] = defaultdict(list)
    end_s = time.monotonic() + PILOT_S
    for outcome in pool.run(
        run_one, evaluation.keys, evaluation.context, timeout_s=config.evaluation.episode_timeout_s
    ):
        if outcome is not None and outcome.value is not None:
            row = outcome.value
            spent_s[outcome.item.planner].append((row["planning_s"], row["wall_s"] - row["planning_s"]))
        if time.monotonic() > end_s and len(spent_s) == len(config.evaluation.planners):
            break
    episodes = len(evaluation.keys) // len(config.evaluation.planners)
    total_s = 0.0
    for planner, pairs in spent_s.items():
        planning_s, other_s = zip(*pairs, strict=True)
        # The first to come to a home map it, which is no part of what most episodes take: hence the median.
        mean_s = statistics.fmean(planning_s) + statistics.median(other_s)
        total_s += mean_s * episodes / pool.slots
        console.line(f"{planner:20} {mean_s:8.3f} s an episode, from {len(pairs)}")
    console.line(f"about {console.duration(total_s)} on {pool.slots} workers; no episode was written (dry_run)")


def _metrics(folder: Folder) -> dict[str, float]:
    """Mean cost and accepted share by planner and cell, for MLflow."""
    rows = read_table(folder / EPISODES, ["planner", "size_class", "robots", "status", "cost_cells"]).to_pandas()
    metrics = {}
    for (planner, size_class, robots), cell in rows.groupby(["planner", "size_class", "robots"]):
        name = f"{planner.rsplit('.', 1)[-1]}/{size_class}_{robots}"
        metrics[f"{name}/cost_cells"] = cell["cost_cells"].mean()
        metrics[f"{name}/accepted"] = (cell["status"] == "accepted").mean()
    return metrics


def _manifest(config: Config, evaluation: Evaluation, reach: Mapping[str, int], pool: Pool) -> dict[str, Any]:
    """What the report needs to know about the run."""
    context = evaluation.context
    version = context.provenance["model_version"]
    trained = find_record(config.datasets_dir, config.tracking.uri, version)
    peaks_mb = read_table(Folder(config.output_dir) / EPISODES, ["peak_memory_mb"]).to_pandas()["peak_memory_mb"]
    return {
        "experiment": config.experiment,
        "seed": config.seed,
        "output_dir": config.output_dir,
        "planners": list(config.evaluation.planners),
        "planner_options": context.planner_options,
        "expected_episodes": len(evaluation.keys),
        "config": config.model_dump(mode="json"),
        **context.provenance,
        "model": trained.facts() if trained else {"name": tracking.MODEL_NAME, "version": version},
        "homes": {
            **evaluation.homes_facts,
            "training": trained.training_homes if trained else None,
            "containers": reach["containers"],
            "reachable_share": reach["reachable"] / reach["containers"],
        },
        "machine": {
            "cpus": pool.slots,
            "memory_gb": round(psutil.virtual_memory().total / 2**30, 1),
            "platform": platform.platform(),
            "python": platform.python_version(),
        },
        "peak_memory_mb": round(float(peaks_mb.max()), 1) if peaks_mb.notna().any() else None,
    }


if __name__ == "__main__":
    main("pipeline.evaluate")
