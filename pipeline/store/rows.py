"""The episodes dataset: Parquet, one row per (trial, planner), written while episodes finish.

Rows go to small part files every second or two, so a killed run loses at most what finished since. Small parts are
merged now and then and at the end. A merge first writes ``_merge-*.parquet`` (which readers of Parquet datasets ignore)
with the names of the parts it replaces in its metadata, then removes those, then takes its final name; opening the
dataset finishes a merge that was interrupted, so no row is ever lost or doubled.
"""

import io
import json
import math
import queue
import threading
import time
import uuid
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from mrtask.names import counted
from pipeline.base import console, interrupt
from pipeline.base.config import UserError
from pipeline.store.episode_row import LATER_COLUMNS, SCHEMA, TRACE, EpisodeRow
from pipeline.store.folder import Folder

FLUSH_EVERY_S = 2.0
FLUSH_ROWS = 500
GRACE_S = 10.0
"""How long an interrupted run goes on writing; schedulers kill it after 30 s."""
WAIT_S = 0.2
MERGE_PARTS = 50
FULL_PART_ROWS = 20_000
"""Larger parts are not merged: a merge holds its rows in memory, with their traces."""

SORTED_BY = [("trial_id", "ascending"), ("planner", "ascending")]
_REPLACES = b"replaces"

Key = tuple[str, str]
"""(trial_id, planner)"""


class EpisodeWriter:
    """The one writer of a dataset.

    Opening it drops rows of a status in ``rerun``, so that they run again: only those of ``asked`` where that is given.
    ``begin`` is called once, right before the first rows are written. A store's rows are written by a thread, so that
    planning goes on while the store is slow or silent. Rows that it does not take within
    `pipeline.store.folder.PATIENCE_S` go to the local folder ``unsent``; the next writer with the same ``unsent`` sends
    them.
    """

    def __init__(
        self,
        folder: Folder,
        rerun: Collection[str] = (),
        asked: Collection[Key] | None = None,
        begin: Callable[[], None] | None = None,
        unsent: Path | None = None,
    ) -> None:
        self._folder, self._begin = folder, begin
        self._pending: list[EpisodeRow] = []
        self._flushed_s = time.monotonic()
        self._unsent = Folder(str(unsent)) if unsent is not None and not folder.is_local else None
        self._courier, self._errand = _Courier(), cast(_Errand | None, None)
        self._posted = _Errand([], lambda: None)
        self._posted.ended.set()
        self._given_up = False
        self._small = _finish_merges(folder)
        if self._unsent is not None:
            self._send(self._unsent)
        if rerun:
            self._drop(rerun, asked)

    def finished(self) -> set[Key]:
        """Return the keys of the existing rows."""
        table = read_table(self._folder, ["trial_id", "planner"])
        return set(zip(table["trial_id"].to_pylist(), table["planner"].to_pylist(), strict=True))

    def add(self, row: EpisodeRow) -> None:
        """Add a finished row; it is on disk within `FLUSH_EVERY_S` as long as `tick` is called."""
        self._pending.append(row)
        self.tick()

    def tick(self) -> None:
        """Write what is pending when it is time.

        Raises:
            UserError: the rows could not be written.
        """
        self._collect()
        due = time.monotonic() - self._flushed_s >= FLUSH_EVERY_S or len(self._pending) >= FLUSH_ROWS
        if self._pending and due and self._errand is None:
            self.flush()

    def flush(self) -> None:
        """Write what is pending, in a store by a thread."""
        rows, self._pending = self._pending, []
        self._flushed_s = time.monotonic()
        if not rows:
            return
        if self._folder.is_local:
            try:
                self._write_part(rows)
            except UserError:
                self._pending = [*rows, *self._pending]
                raise
            self._merge_if_many()
        else:
            self._errand = _Errand(rows, partial(self._store, rows))
            self._courier.send(self._errand)

    def close(self) -> None:
        """Write the rest and merge the small parts into one, sorted by trial and planner.

        Raises:
            UserError: the rows could not be written.
        """
        self.settle()
        self.flush()
        self.settle()
        if len(self._small) > 1 and not self._given_up:
            self._merge()
        self._courier.dismiss()

    def post(self, write: Callable[[], None]) -> None:
        """Write something beside the rows: at once, or in a store by the thread, unless that is busy.

        What a store does not take is left out.
        """
        if self._folder.is_local:
            write()
        elif self._errand is None and self._posted.ended.is_set():
            self._posted = _Errand([], write)
            self._courier.send(self._posted)

    def flush_soon(self) -> None:
        """Write the rest within the few seconds that a scheduler leaves; a store that is slower gets it later."""
        end_s = time.monotonic() + GRACE_S
        try:
            self.settle(end_s)
            self.flush()
            self.settle(end_s)
        except UserError as error:
            console.line(str(error))

    def settle(self, end_s: float = math.inf) -> None:
        """Wait for what is being written; what is not by ``end_s`` goes to the local folder."""
        while not self._posted.ended.wait(WAIT_S) and time.monotonic() < end_s:
            pass
        while self._errand is not None and time.monotonic() < end_s:
            self._errand.ended.wait(WAIT_S)
            self._collect()
            if end_s == math.inf:
                interrupt.check()
        if self._errand is not None:
            self._keep_here(f"cannot write {self._folder}: no answer for {console.duration(GRACE_S)}")

    def _collect(self) -> None:
        """Note that a thread has written its rows, or keep them in the local folder."""
        if self._errand is not None and self._errand.ended.is_set():
            error = self._errand.error
            if isinstance(error, UserError):
                self._keep_here(str(error))
            self._errand = None
            if error is not None:
                raise error

    def _keep_here(self, problem: str) -> None:
        """Put all rows that are not in the store into the local folder.

        Raises:
            UserError: always; it says where they are.
        """
        assert self._errand is not None
        rows, self._pending, self._errand = [*self._errand.rows, *self._pending], [], None
        self._given_up = True
        if self._unsent is None:
            raise UserError(problem)
        _write(self._unsent, "part", _table(rows))
        raise UserError(
            f"{problem}; {counted(len(rows), 'row')} that it lacks went to {self._unsent}. When the store answers "
            "again, the same command, on this machine, sends them and continues"
        )

    def _send(self, unsent: Folder) -> None:
        """Write the rows of the local folder that the store lacks; some may have arrived after all."""
        names = _part_names(unsent)
        if not names:
            return
        finished = self.finished()
        table = pa.concat_tables(_read_part(unsent, name) for name in names)
        keys = zip(table["trial_id"].to_pylist(), table["planner"].to_pylist(), strict=True)
        missing = table.filter(pa.array([key not in finished for key in keys]))
        if missing.num_rows:
            self._write_table(missing.sort_by(SORTED_BY))
        console.line(f"{counted(missing.num_rows, 'row')} sent that the store had not taken, from {unsent}")
        for name in names:
            unsent.remove(name)

    def _store(self, rows: Sequence[EpisodeRow]) -> None:
        self._write_part(rows)
        self._merge_if_many()

    def _write_part(self, rows: Sequence[EpisodeRow]) -> None:
        self._write_table(_table(rows))

    def _write_table(self, table: pa.Table) -> None:
        if self._begin is not None:
            self._begin()
            self._begin = None
        self._small.append(_write(self._folder, "part", table))

    def _merge_if_many(self) -> None:
        if len(self._small) >= MERGE_PARTS:
            self._merge()

    def _merge(self) -> None:
        table = pa.concat_tables(_read_part(self._folder, name) for name in self._small)
        name = self._replace(self._small, table.sort_by(SORTED_BY))
        self._small = [] if table.num_rows >= FULL_PART_ROWS else [name]

    def _drop(self, statuses: Collection[str], asked: Collection[Key] | None) -> None:
        for name in _part_names(self._folder):
            table = _read_part(self._folder, name)
            rows = zip(*(table[column].to_pylist() for column in ("trial_id", "planner", "status")), strict=True)
            keep = [
                status not in statuses or (asked is not None and (trial, planner) not in asked)
                for trial, planner, status in rows
            ]
            if not all(keep):
                new = self._replace([name], table.filter(pa.array(keep)))
                self._small = [new if small == name else small for small in self._small]

    def _replace(self, parts: Sequence[str], table: pa.Table) -> str:
        name = _write(self._folder, "_merge", table.replace_schema_metadata({_REPLACES: json.dumps(list(parts))}))
        return _finish_merge(self._folder, name, parts)


@dataclass(eq=False)
class _Errand:
    """Rows on their way into a store."""

    rows: Sequence[EpisodeRow]
    write: Callable[[], None]
    ended: threading.Event = field(default_factory=threading.Event)
    error: BaseException | None = None


class _Courier:
    """A thread that runs one errand after the other, started with the first; it does not keep a process alive."""

    def __init__(self) -> None:
        self._errands: queue.SimpleQueue[_Errand | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def send(self, errand: _Errand) -> None:
        """Run an errand when those before it have ended."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()
        self._errands.put(errand)

    def dismiss(self) -> None:
        """End the thread after its errands."""
        self._errands.put(None)
        self._thread = None

    def _run(self) -> None:
        while (errand := self._errands.get()) is not None:
            try:
                errand.write()
            except BaseException as error:  # raised where the rows came from
                errand.error = error
            errand.ended.set()


def read_table(folder: Folder, columns: list[str] | None = None) -> pa.Table:
    """Return all or some columns of a dataset's rows; empty where there is no dataset."""
    names = _part_names(folder)
    if not names:
        empty = SCHEMA.empty_table()
        return empty.select(columns) if columns else empty
    return pa.concat_tables(_read_part(folder, name, columns) for name in names)


def read_episodes(folder: Folder) -> pd.DataFrame:
    """Return all rows as a DataFrame, without the traces, which are most of their size.

    Raises:
        UserError: there are no rows.
    """
    table = read_table(folder, [name for name in SCHEMA.names if name != TRACE])
    if table.num_rows == 0:
        raise UserError(f"no episodes in {folder}; run python -m pipeline.evaluate with the same output_dir first")
    frame: pd.DataFrame = table.to_pandas()
    return frame


def read_traces(folder: Folder, trials: Collection[str], planners: Collection[str] | None = None) -> pd.DataFrame:
    """Return ``trial_id, planner, trace`` of these trials by these planners, by default by all."""
    wanted = pa.array(sorted(trials), pa.string())
    columns = ["trial_id", "planner", TRACE]
    found = [SCHEMA.empty_table().select(columns)]
    for name in _part_names(folder):
        part = _read_part(folder, name, columns)
        part = part.filter(pc.is_in(part["trial_id"], wanted))
        if planners is not None:
            part = part.filter(pc.is_in(part["planner"], pa.array(sorted(planners), pa.string())))
        found.append(part)
    frame: pd.DataFrame = pa.concat_tables(found).to_pandas()
    return frame


def read_csv(folder: Folder, name: str) -> pd.DataFrame | None:
    """Return a table that a stage left in the folder, None where there is no such file."""
    content = folder.read(name)
    return None if content is None else pd.read_csv(io.BytesIO(content))


def differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> Iterable[str]:
    """Yield where two nested configurations differ: ``key: was ..., now ...``."""
    for key in sorted(old.keys() | new.keys()):
        a, b = old.get(key), new.get(key)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            yield from differences(a, b, f"{prefix}{key}.")
        elif a != b:
            yield f"{prefix}{key}: was {json.dumps(a)}, now {json.dumps(b)}"


def _table(rows: Sequence[EpisodeRow]) -> pa.Table:
    return pa.Table.from_pylist([row.as_dict() for row in rows], schema=SCHEMA).sort_by(SORTED_BY)


def _part_names(folder: Folder) -> list[str]:
    return [name for name in folder.names() if name.startswith("part-") and name.endswith(".parquet")]


def _read_part(folder: Folder, name: str, columns: list[str] | None = None) -> pa.Table:
    content = folder.read(name)
    if content is None:
        raise UserError(f"{folder}/{name} was removed while it was being read; run the same command again")
    schema = SCHEMA if columns is None else pa.schema([SCHEMA.field(column) for column in columns])
    try:
        file = pq.ParquetFile(io.BytesIO(content))
        there = file.schema_arrow.names
        table = file.read(None if columns is None else [name for name in columns if name in there])
        for later in LATER_COLUMNS & {*schema.names} - {*there}:
            table = table.append_column(later, pa.nulls(table.num_rows, schema.field(later).type))
        if {*table.column_names} == {*schema.names}:
            table = table.select(schema.names)
    except (pa.ArrowInvalid, OSError) as error:
        raise UserError(
            f"{folder}/{name} is damaged ({error}); remove it and run again: only its rows are redone"
        ) from error
    try:
        return table.cast(schema).replace_schema_metadata(None)
    except (pa.ArrowInvalid, ValueError) as error:
        raise UserError(
            f"{folder}/{name} has other columns than this version writes; give another output_dir, or overwrite=true"
        ) from error


def _write(folder: Folder, kind: str, table: pa.Table) -> str:
    name = f"{kind}-{uuid.uuid4().hex[:12]}.parquet"
    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="zstd")
    folder.write(name, buffer.getvalue())
    return name


def _finish_merges(folder: Folder) -> list[str]:
    """Finish merges that an interrupted run left half done; return the parts that are not full."""
    for name in folder.names():
        content = folder.read(name) if name.startswith("_merge-") else None
        if content is not None:
            _finish_merge(folder, name, json.loads(pq.read_schema(io.BytesIO(content)).metadata[_REPLACES]))
    small = []
    for name in _part_names(folder):
        if len(_read_part(folder, name, ["robots"])) < FULL_PART_ROWS:
            small.append(name)
    return small


def _finish_merge(folder: Folder, merge: str, parts: Sequence[str]) -> str:
    for part in parts:
        folder.remove(part)
    final = merge.replace("_merge", "part")
    folder.rename(merge, final)
    return final
