"""The row of an episode in the results, declared once for those who write it, those who read it and the files."""

from dataclasses import asdict, dataclass, fields
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import pyarrow as pa

Int32 = Annotated[int, pa.int32()]
Int64 = Annotated[int, pa.int64()]


@dataclass(frozen=True, kw_only=True)
class EpisodeRow:
    """One planner's episode on one trial. None: an episode that broke off did not get that far."""

    trial_id: str
    home_id: str | None = None
    home_source: str | None = None
    size_class: str
    robots: Int32
    team: str | None = None
    """The team's name; None in rows of earlier versions."""
    template: str | None = None
    formula: str | None = None
    objects: tuple[str, ...] | None = None
    planner: str
    status: str
    """One of `mrtask.analysis.results.episodes.STATUSES`."""
    cost_s: float | None = None
    cost_cells: float | None = None
    decisions: Int32 | None = None
    planning_s: float | None = None
    samples: Int64 | None = None
    seed: Int64 | None = None
    model_version: str
    config_hash: str
    code_version: str
    error: str | None = None
    start_x_m: float | None = None
    start_y_m: float | None = None
    attempt: Int32 = 1
    """How often it was sent to a worker."""
    wall_s: float | None = None
    peak_memory_mb: float | None = None
    trace: str | None = None
    node: str | None = None
    """The name of the machine that ran it."""

    def as_dict(self) -> dict[str, Any]:
        """Column -> value."""
        return asdict(self)


_ARROW = {str: pa.string(), float: pa.float64(), tuple: pa.list_(pa.string())}


def _column(hint: Any) -> pa.DataType:
    """Return the Parquet type of an annotation: the one it carries, else that of its Python type."""
    [kind] = [part for part in get_args(hint) if part is not NoneType] if NoneType in get_args(hint) else [hint]
    return kind.__metadata__[0] if hasattr(kind, "__metadata__") else _ARROW[get_origin(kind) or kind]


_HINTS = get_type_hints(EpisodeRow, include_extras=True)
SCHEMA = pa.schema([(field.name, _column(_HINTS[field.name])) for field in fields(EpisodeRow)])
"""The columns of the Parquet files, in their order."""
LATER_COLUMNS = frozenset({"node", "team"})
"""Columns that rows of earlier versions lack; they are read as null."""
TRACE = "trace"
"""The column with most of a row's size; only the episodes that are drawn need it."""
