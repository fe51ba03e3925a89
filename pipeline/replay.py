"""Replays an episode in one HTML file that shows the drives, the beliefs and the reasons for each decision.

    python -m pipeline.replay trial_id=large-3-073 planners=[pouct,learned_myopic] output_dir=outputs/paper

The trial runs again with the configuration that output_dir records, and the result must be the same. The page is
``<output_dir>/replays/<trial_id>.html`` and needs no network.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.replay", {"trial_id": "replay.trial_id", "planners": "replay.planners"})

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import pandas as pd
from pydantic import ValidationError

from mrtask.analysis.drawing.replay_content import Episode, Recorder, make_replay
from mrtask.analysis.drawing.replay_page import render_replay
from mrtask.analysis.drawing.trajectories import baseline_beside
from mrtask.analysis.results.roles import main_planner
from mrtask.execution.trace import Trace
from mrtask.names import suggest
from mrtask.tasks.automaton import build_automaton
from pipeline.app.stage import Session, Stage
from pipeline.backends import runs
from pipeline.base import console
from pipeline.base.config import Config, UserError
from pipeline.base.specs import EvaluationSpec
from pipeline.base.studies import Replay
from pipeline.episodes.plan import EvaluationPlan, covering, prepare
from pipeline.episodes.worker import run_chain
from pipeline.store import layout
from pipeline.store.episode_row import TRACE, EpisodeRow
from pipeline.store.folder import Folder
from pipeline.store.layout import EPISODES, IDENTITY, MANIFEST, REPLAYS
from pipeline.store.records import EvaluationManifest, RunIdentity
from pipeline.store.rows import read_episodes, read_traces

MUST_BE_EQUAL = ("status", "cost_s", "decisions", "samples", "error", TRACE)
Row = Mapping[str, Any]
"""A row of the results with its trace."""
PLAYED = ("accepted", "failed")
"""Episodes with any other status broke off and left no trace."""


@dataclass(frozen=True)
class ReplayJob:
    """The trial to show and by which planners, the folder with its rows, and a way to read its configuration."""

    options: Replay
    folder: Folder
    recorded: Callable[[], EvaluationSpec]

    def run(self, session: Session) -> None:
        """Run the trial again and write its page."""
        began_s, folder = time.monotonic(), self.folder
        trial_id, rows, planners = self._chosen()
        console.headline("replay", f"trial {trial_id} by {', '.join(planners)}")
        plan = prepare(self.recorded(), session.pool)
        episodes = [_replayed(rows[planner], plan, folder) for planner in planners]
        row = rows[planners[0]]
        home = next(home for home in plan.context.homes if home.id == row["home_id"])
        automaton = build_automaton(row["formula"], tuple(row["objects"]))
        called = [robot.name for robot in plan.spec.team.robots]
        replay = make_replay(trial_id, row["size_class"], row["template"], automaton, home, episodes, called)
        command = f"python -m pipeline.replay trial_id={trial_id} planners=[{','.join(planners)}] output_dir={folder}"
        target, name = folder / REPLAYS, f"{trial_id}.html"
        target.write(name, render_replay(replay, command).encode())
        console.result(target / name, time.monotonic() - began_s)

    def outline(self, session: Session) -> Iterator[str]:
        """Say whose episodes of which trial would be replayed."""
        trial_id, _, planners = self._chosen()
        yield f"would replay trial {trial_id} by {', '.join(planners)} -> {self.folder / REPLAYS / f'{trial_id}.html'}"

    def _chosen(self) -> tuple[str, dict[str, Row], tuple[str, ...]]:
        """Return the trial, its rows by planner, and the planners to show."""
        trial_id = self.options.trial_id
        if trial_id is None:
            raise UserError("replay.trial_id: a value is needed, give it as trial_id=..., such as trial_id=large-3-073")
        rows = _rows(self.folder, trial_id)
        return trial_id, rows, _planners(rows, self.options.planners, trial_id)


def job(config: Config) -> ReplayJob:
    """Return what to replay."""
    folder = Folder(config.output_dir)
    here = {"output_dir": config.output_dir, "cache_dir": config.cache_dir, "draw": False, "overwrite": False}
    return ReplayJob(config.replay, folder, partial(_recorded, folder, {"replay": config.replay}, here))


def _rows(folder: Folder, trial_id: str) -> dict[str, Row]:
    """Return the trial's rows with their traces, by planner.

    Raises:
        UserError: the folder holds no finished evaluation, or the evaluation has no such trial.
    """
    if cells := layout.cells(folder):
        listed = ", ".join(str(cell) for cell in cells)
        raise UserError(f"{folder} holds a sweep; give one of its cells as output_dir: {listed}")
    rows = read_episodes(folder / EPISODES)
    trials = sorted(set(rows["trial_id"]))
    if trial_id not in trials:
        shown = f"{trials[0]} to {trials[-1]}, {len(trials)} in all"
        raise UserError(f"trial_id={trial_id}: no such trial in {folder}, which has {shown}")
    traces = read_traces(folder / EPISODES, {trial_id})
    found = rows.merge(traces, on=["trial_id", "planner"]).to_dict("records")
    return {row["planner"]: {str(name): value for name, value in row.items()} for row in found}


def _planners(rows: Mapping[str, Row], asked: tuple[str, ...], trial_id: str) -> tuple[str, ...]:
    """Return the planners to show: those asked for, or by default the main planner and its baseline."""
    played = {name: row for name, row in rows.items() if row["status"] in PLAYED}
    for name in asked:
        if name not in rows:
            raise UserError(f"planners: {name} has not run trial {trial_id}; {suggest(name, list(rows))}")
        if name not in played:
            raise UserError(
                f"planners: the episode of {name} on {trial_id} broke off with status {rows[name]['status']}, there is "
                f"nothing to watch:\n{rows[name]['error']}"
            )
    if asked:
        return asked
    main_one = main_planner(tuple(played))
    if main_one is None:
        raise UserError(f"trial_id={trial_id}: no planner finished, there is nothing to watch")
    beside = baseline_beside(list(played), main_one)
    return (main_one, beside) if beside else (main_one,)


def _recorded(folder: Folder, default: Mapping[str, Any], here: Mapping[str, Any]) -> EvaluationSpec:
    """Return the evaluation that the folder records, with all planners and trials added later and this machine's cache.

    Raises:
        UserError: the folder holds no finished evaluation, or another version of the code wrote it.
    """
    manifest = EvaluationManifest.read(folder, MANIFEST)
    if manifest is None:
        raise UserError(
            f"no finished evaluation in {folder}; run python -m pipeline.evaluate with the same output_dir first"
        )
    try:
        recorded = Config.model_validate({**default, **manifest.config, **here}).evaluation_spec()
        identity = RunIdentity.read(folder, IDENTITY)
        return recorded if identity is None else covering(recorded, identity)
    except ValidationError as error:
        first = error.errors()[0]
        raise UserError(
            f"{folder}/{MANIFEST} is of another version of the code ({'.'.join(map(str, first['loc']))}: "
            f"{first['msg']}); replay it with the version that made it: {manifest.code_version}"
        ) from error


def _replayed(row: Row, plan: EvaluationPlan, folder: Folder) -> Episode:
    """Run a row's episode again.

    Raises:
        UserError: the result differs from the row.
    """
    [key] = [key for key in plan.keys if (key.trial_id, key.planner) == (row["trial_id"], row["planner"])]
    [chain] = plan.chains([key])
    recorder = Recorder()
    again = run_chain(chain[: chain.index(key) + 1], plan.context, recorder)[-1]
    unequal = [name for name in MUST_BE_EQUAL if not _equal(row[name], getattr(again, name))]
    if unequal:
        raise UserError(_why_unequal(row, again, unequal, plan, folder))
    return Episode(
        planner=again.planner,
        status=again.status,
        cost_s=again.cost_s,
        error=again.error,
        trace=Trace.from_json(row[TRACE]),
        decisions=tuple(recorder.decisions),
    )


def _equal(stored: object, now: object) -> bool:
    return bool(pd.isna(stored)) if now is None else stored == now  # type: ignore[call-overload]


def _why_unequal(row: Row, again: EpisodeRow, unequal: list[str], plan: EvaluationPlan, folder: Folder) -> str:
    shown = ", ".join(
        "the drives differ" if name == TRACE else f"{name} was {row[name]}, is now {getattr(again, name)}"
        for name in unequal
    )
    recorded = RunIdentity.read(folder, IDENTITY)
    changed = recorded.conflicts(plan.identity) if recorded else []
    if any(line.startswith("code:") for line in changed):
        reason = f"the code has changed since: check out {row['code_version']} to replay it"
    elif changed:
        reason = f"the run's configuration has changed: {'; '.join(changed)}"
    else:
        reason = "a planner with a time_limit_s gets as far as time allows; other processors may round otherwise"
    return f"{row['planner']} on {row['trial_id']} does not replay to the stored episode ({shown}): {reason}"


STAGE = Stage(job, runs.check_store)
