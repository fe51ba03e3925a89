"""Measures how far planners are from optimal, by lower bounds on what any planner can reach under its belief.

Each trial is run in worlds drawn from its own belief; see `mrtask.bounds.assess`. Leaves one row per trial in
``<output_dir>/optimality.csv``, which pipeline.report shows. Run again, it computes only the trials that are missing.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.optimality")

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pandas as pd

from mrtask.analysis.results.optimality import CellOptimality, summarise_optimality
from mrtask.analysis.results.statistics import Estimate, cell_name
from mrtask.names import counted
from pipeline import evaluate
from pipeline.app.stage import Session, Stage
from pipeline.backends.pool import ItemError, Pool
from pipeline.base import console
from pipeline.base.config import UserError, content_hash
from pipeline.base.specs import EvaluationSpec
from pipeline.base.studies import Optimality
from pipeline.episodes.plan import prepare
from pipeline.episodes.studies import assess_trial
from pipeline.episodes.worker import Context, EpisodeKey, warm
from pipeline.store.artifacts import NotMade
from pipeline.store.folder import Folder
from pipeline.store.layout import OPTIMALITY
from pipeline.store.rows import read_csv
from pipeline.store.version import source_hash

KEY = "key"
"""Column with the hash of all that decides a row."""
WRITE_EVERY_S = 10.0


@dataclass(frozen=True)
class Work:
    """The trials to assess, those of them that are done, and what they share."""

    keys: list[EpisodeKey]
    context: Context
    worlds: int
    key: str
    finished: list[dict[str, Any]]

    @property
    def missing(self) -> list[EpisodeKey]:
        """The trials that are not done yet."""
        done = {(row["trial_id"], row["planner"]) for row in self.finished}
        return [key for key in self.keys if (key.trial_id, key.planner) not in done]

    @property
    def text(self) -> str:
        """``90 trials, each in 100 worlds, model version 1``."""
        version = self.context.provenance.model_version
        return f"{counted(len(self.keys), 'trial')}, each in {self.worlds} worlds, model version {version}"


@dataclass(frozen=True)
class OptimalityJob:
    """The planners and trials, and how many of the trials are assessed in how many worlds."""

    spec: EvaluationSpec
    options: Optimality

    def run(self, session: Session) -> None:
        """Assess the trials that are missing and write the table."""
        began_s, target = time.monotonic(), Folder(self.spec.output_dir)
        work = self._work(session.pool)
        console.headline("optimality", work.text)
        if not work.missing:
            console.skipped(target / OPTIMALITY)
            return
        rows = _assess_all(work, session.pool, target)
        for cell in summarise_optimality(pd.DataFrame(rows)):
            console.line(_said(cell))
        console.result(target / OPTIMALITY, time.monotonic() - began_s)

    def outline(self, session: Session) -> Iterator[str]:
        """Say how many trials would be assessed."""
        try:
            work = self._work(session.pool)
        except NotMade as missing:
            yield f"would assess {counted(self.options.trials_per_cell, 'trial')} a cell; {missing}"
        else:
            yield f"would assess {work.text}; {len(work.finished)} are done"

    def _work(self, pool: Pool) -> Work:
        plan, worlds = prepare(self.spec, pool), self.options.worlds
        hashed = content_hash([plan.identity.content(), worlds, source_hash("mrtask/bounds")])
        keys = [key for key in plan.keys if key.number < self.options.trials_per_cell]
        return Work(keys, plan.context, worlds, hashed, _finished(Folder(self.spec.output_dir), hashed))


def _finished(folder: Folder, hashed: str) -> list[dict[str, Any]]:
    """Return the existing rows that would be the same if they were computed again."""
    rows = read_csv(folder, OPTIMALITY)
    if rows is None:
        return []
    return [{str(name): value for name, value in row.items()} for row in rows[rows[KEY] == hashed].to_dict("records")]


def _assess_all(work: Work, pool: Pool, folder: Folder) -> list[dict[str, Any]]:
    """Return all rows, which are written now and then, and also on an interrupt."""
    for key in {key.planner: key for key in work.missing}.values():
        warm(key, work.context)
    rows, written_s = list(work.finished), time.monotonic()
    try:
        for _, row in pool.values(assess_trial, work.missing, work.context, work.worlds, unit="trials"):
            rows.append({**row, KEY: work.key})
            if time.monotonic() > written_s + WRITE_EVERY_S:
                _write(folder, rows)
                written_s = time.monotonic()
    except ItemError as error:
        raise UserError(f"a bound could not be computed: {error}") from error
    finally:
        _write(folder, rows)
    return rows


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


STAGE = Stage(
    lambda config: OptimalityJob(config.evaluation_spec(config.optimality.planners), config.optimality), evaluate.check
)
