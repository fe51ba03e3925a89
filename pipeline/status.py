"""Says how far an evaluation is: mrtask status OUTPUT_DIR

OUTPUT_DIR is a path or a URL (s3://bucket/run), of a run under way, a finished or a killed one, or of a sweep. This
reads the run's folder only, so it works on any machine that can read it.
"""

import time
from collections.abc import Iterator, Sequence
from datetime import datetime

import pandas as pd

from mrtask.errors import without_secrets
from mrtask.names import counted
from pipeline.app import tool
from pipeline.base import console
from pipeline.base.config import UserError
from pipeline.base.values import absolute_unless_url
from pipeline.store import layout
from pipeline.store.folder import LEASE_S, Folder
from pipeline.store.layout import EPISODES, IDENTITY, PROGRESS
from pipeline.store.records import RunIdentity, RunProgress
from pipeline.store.rows import read_table

COLUMNS = ["trial_id", "planner", "status", "error"]
FAILED = ("error", "timeout")
SILENT_S = LEASE_S
"""A run that has recorded nothing for this long has died."""


def main(arguments: Sequence[str]) -> None:
    """Print the status of the run, or of each cell of the sweep, in the folder on the command line."""
    if len(arguments) != 1:
        raise UserError("give one folder: mrtask status outputs/paper, or mrtask status s3://bucket/run")
    folder = Folder(absolute_unless_url(arguments[0]))
    for one in layout.cells(folder) or [folder]:
        for line in status(one, time.time()):
            print(without_secrets(line), flush=True)


def status(folder: Folder, now: float) -> Iterator[str]:
    """Yield the lines on a run, as of this Unix time.

    Raises:
        UserError: no run has begun there.
    """
    identity = RunIdentity.read(folder, IDENTITY)
    if identity is None:
        raise UserError(f"no run has begun in {folder}; python -m pipeline.evaluate starts one")
    progress = RunProgress.read(folder, PROGRESS)
    yield f"{folder}: {_state(progress, now)}"
    rows = read_table(folder / EPISODES, COLUMNS).to_pandas()
    asked = pd.Series([planner for _, planner in identity.row_keys()]).value_counts()
    yield f"  {len(rows)} of {asked.sum()} episodes{_pace(progress, now)}"
    for planner in identity.planner:
        its = rows[rows["planner"] == planner]
        failed = its["status"].isin(FAILED).sum()
        yield f"  {planner:20} {len(its)} of {asked[planner]}{f', {failed} failed' if failed else ''}"
    if progress is not None and progress.note:
        yield f"  {progress.note}"
    if (error := _last_error(progress, rows)) is not None:
        yield f"  last error: {error}"


def _state(progress: RunProgress | None, now: float) -> str:
    if progress is None:
        return "no episode has run yet"
    ago = console.duration(max(now - progress.updated, 0))
    if progress.state != "running":
        reason = f": {progress.message.splitlines()[0]}" if progress.message else ""
        return f"{progress.state} {ago} ago{reason}"
    if now - progress.updated > SILENT_S:
        return f"silent for {ago}, so it was killed ({progress.by}); the same command continues it"
    return f"running, heard of {ago} ago ({progress.by})"


def _pace(progress: RunProgress | None, now: float) -> str:
    if progress is None or not _is_running(progress, now):
        return ""
    workers = counted(progress.workers, "worker")
    if not progress.per_s:
        return f", {workers}"
    left_s = (progress.total - progress.done) / progress.per_s
    until = datetime.fromtimestamp(now + left_s).astimezone().strftime("%a %H:%M")
    return f", {progress.per_s:.2g}/s, {console.duration(left_s)} left (until {until}), {workers}"


def _is_running(progress: RunProgress, now: float) -> bool:
    return progress.state == "running" and now - progress.updated <= SILENT_S


def _last_error(progress: RunProgress | None, rows: pd.DataFrame) -> str | None:
    if progress is not None and progress.last_error:
        return progress.last_error
    failed = rows[rows["status"].isin(FAILED)]
    if failed.empty:
        return None
    row = failed.iloc[-1]
    return f"{row['trial_id']} by {row['planner']}: {(row['error'] or row['status']).strip().splitlines()[-1]}"


if __name__ == "__main__":
    tool.main(main, __doc__)
