"""The episodes dataset: Parquet, one row per (trial, planner), written while episodes finish.

Rows go to small part files every second or two, so a killed run loses at most what finished since. Small parts are
merged now and then and at the end. A merge first writes ``_merge-*.parquet`` (which readers of Parquet datasets ignore)
with the names of the parts it replaces in its metadata, then removes those, then takes its final name; opening the
dataset finishes a merge that was interrupted, so no row is ever lost or doubled.
"""

import io
import json
import time
import uuid
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from pipeline.base.config import UserError
from pipeline.store.episode_row import ADDED_LATER, SCHEMA, TRACE, EpisodeRow
from pipeline.store.folder import Folder

FLUSH_EVERY_S = 2.0
FLUSH_ROWS = 500
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
    ``begin`` is called once, right before the first rows are written.
    """

    def __init__(
        self,
        folder: Folder,
        rerun: Collection[str] = (),
        asked: Collection[Key] | None = None,
        begin: Callable[[], None] | None = None,
    ) -> None:
        self._folder, self._begin = folder, begin
        self._pending: list[EpisodeRow] = []
        self._flushed_s = time.monotonic()
        self._small = _finish_merges(folder)
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
        """Write what is pending when it is time."""
        due = time.monotonic() - self._flushed_s >= FLUSH_EVERY_S or len(self._pending) >= FLUSH_ROWS
        if self._pending and due:
            self.flush()

    def flush(self) -> None:
        """Write what is pending."""
        if self._pending:
            if self._begin is not None:
                self._begin()
                self._begin = None
            table = pa.Table.from_pylist([row.as_dict() for row in self._pending], schema=SCHEMA).sort_by(SORTED_BY)
            self._small.append(_write(self._folder, "part", table))
            self._pending = []
        self._flushed_s = time.monotonic()
        if len(self._small) >= MERGE_PARTS:
            self._merge()

    def close(self) -> None:
        """Write the rest and merge the small parts into one, sorted by trial and planner."""
        self.flush()
        if len(self._small) > 1:
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
        for later in ADDED_LATER & {*schema.names} - {*there}:
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
