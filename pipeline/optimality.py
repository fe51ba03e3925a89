"""Measures how far planners are from optimal, by lower bounds on what any planner can reach under its belief.

Each trial is run in worlds drawn from its own belief; see `mrtask.bounds.assess`. Leaves one row per trial in
``<output_dir>/optimality.csv``, which pipeline.report shows. Run again, it computes only the trials that are missing.
"""

import time
from collections.abc import Mapping
from typing import Any

import pandas as pd

from mrtask.analysis.results.optimality import CellOptimality, summarise_optimality
from mrtask.analysis.results.statistics import Estimate, cell_name
from pipeline import homes
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.backends import tracking
from pipeline.backends.pool import Outcome, Pool
from pipeline.base import console
from pipeline.base.config import Config, UserError, content_hash
from pipeline.episodes.plan import check, plan_evaluation
from pipeline.episodes.studies import assess_trial
from pipeline.episodes.worker import Context, EpisodeKey, warm
from pipeline.evaluate import load_model
from pipeline.store.folder import Folder, locked
from pipeline.store.layout import OPTIMALITY
from pipeline.store.rows import read_csv
from pipeline.store.version import source_hash

KEY = "key"
"""Column with the hash of all that decides a row."""
WRITE_EVERY_S = 10.0


def run(config: Config, session: Session) -> None:
    """The stage."""
    check(config.evaluation)
    store = tracking.open_tracking(config.tracking.uri, config.tracking.experiment_name)
    folder, options, began_s = Folder(config.output_dir), config.optimality, time.monotonic()
    with locked(folder, config.cache_dir):
        model = load_model(config, store)
        measured = config.evaluation.model_copy(update={"planners": options.planners})
        plan = plan_evaluation(config.model_copy(update={"evaluation": measured}), homes.run(config, session), model)
        keys = [key for key in plan.keys if key.number < options.trials_per_cell]
        sources = source_hash("mrtask/bounds")
        hashed = content_hash([plan.identity.content(), options.worlds, sources])
        console.headline(
            "optimality", f"{len(keys)} trials, each in {options.worlds} worlds, model version {model.version}"
        )
        rows = _finished(folder, hashed)
        done = {(row["trial_id"], row["planner"]) for row in rows}
        missing = [key for key in keys if (key.trial_id, key.planner) not in done]
        if not missing:
            console.skipped(folder / OPTIMALITY)
            return
        _assess_all(missing, plan.context, options.worlds, session.pool, folder, rows, hashed)
        for cell in summarise_optimality(pd.DataFrame(rows)):
            console.line(_said(cell))
        console.result(folder / OPTIMALITY, time.monotonic() - began_s)


def _finished(folder: Folder, hashed: str) -> list[dict[str, Any]]:
    """The rows that are there and would come out the same."""
    rows = read_csv(folder, OPTIMALITY)
    if rows is None:
        return []
    return [{str(name): value for name, value in row.items()} for row in rows[rows[KEY] == hashed].to_dict("records")]


def _assess_all(
    missing: list[EpisodeKey],
    context: Context,
    worlds: int,
    pool: Pool,
    folder: Folder,
    rows: list[dict[str, Any]],
    hashed: str,
) -> None:
    """Adds to ``rows`` and writes them now and then."""
    for key in {key.planner: key for key in missing}.values():
        warm(key, context)
    written_s = time.monotonic()
    try:
        with console.Progress(len(missing), "trials") as progress:
            for outcome in pool.run(assess_trial, missing, context, worlds):
                if outcome is None:
                    progress.update(0)
                    continue
                rows.append({**_row(outcome), KEY: hashed})
                progress.update()
                if time.monotonic() > written_s + WRITE_EVERY_S:
                    _write(folder, rows)
                    written_s = time.monotonic()
    finally:
        # Also on an interrupt: what is finished stays.
        _write(folder, rows)


def _row(outcome: Outcome[EpisodeKey, dict[str, Any]]) -> Mapping[str, Any]:
    if outcome.value is None:
        raise UserError(f"the bound of trial {outcome.item.trial_id} could not be computed: {outcome.failure}")
    return outcome.value


def _write(folder: Folder, rows: list[dict[str, Any]]) -> None:
    if rows:
        ordered = pd.DataFrame(rows).sort_values(["trial_id", "planner"])
        folder.write(OPTIMALITY, ordered.to_csv(index=False, lineterminator="\n").encode())


def _said(cell: CellOptimality) -> str:
    return (
        f"{cell_name(cell.cell):18} {cell.planner}: bound {cell.bound_s.value:.2f} s, cost {cell.cost_s.value:.2f} s, "
        f"above it {_percent(cell.gap_percent)}, median {_percent(cell.median_gap_percent)}, "
        f"exact {cell.exact_share:.0%}, clairvoyant {cell.clairvoyant_s.value:.2f} s, {cell.bound_seconds:.2f} CPU s"
    )


def _percent(estimate: Estimate) -> str:
    interval = f" [{estimate.low:.1f}, {estimate.high:.1f}]" if estimate.has_interval else ""
    return f"{estimate.value:.1f} %{interval}"


STAGE = Stage(run)

if __name__ == "__main__":
    main("pipeline.optimality")
