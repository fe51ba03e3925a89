"""Sweeps (``-m``): all cells are checked before the first one starts, each has its own folder and MLflow child run.

A cell's results are in ``<output_dir>/cells/<its values>``; the report of ``<output_dir>`` compares the cells.
Hydra runs the cells one after the other in this process.
"""

import contextlib
import hashlib
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from mrtask.errors import InputError, refuse, without_secrets
from mrtask.names import counted
from pipeline.app.stage import Cell, Session, Stage
from pipeline.backends.pool import Pool
from pipeline.base import config as schema
from pipeline.base import console
from pipeline.base.config import Config, UserError
from pipeline.store.layout import CELLS

if TYPE_CHECKING:
    from pipeline.backends.runs import SweepRecord

LONGEST_NAME = 120
CONFIG_NAME = "config"
HYDRAS_RECORD = "multirun.yaml"
REFUSAL = "the sweep does not start:"


@dataclass
class Sweep:
    """The sweep under way."""

    swept: frozenset[str]
    cells: Mapping[str, Config]
    """Each cell's values of the swept keys, with its configuration; the output folder is that of the whole sweep."""
    overrides: Sequence[str] = ()
    """The command line's."""
    compare: Callable[[], None] | None = None
    """What the end of the sweep calls; set by a cell that leaves something to compare."""
    started: int = 0
    failed: list[str] = field(default_factory=list)
    record: "SweepRecord | None" = None
    """Where MLflow keeps the sweep; begun before the first cell starts."""

    @property
    def whole(self) -> Config:
        """The configuration of what concerns all cells."""
        return next(iter(self.cells.values()))

    def run_cell(self, stage: Stage, config: Config, overrides: Sequence[str], pool: Pool) -> None:
        """Run the stage in the cell's own output folder; note a user's mistake, so that the other cells still run."""
        if self.started == 0:
            self._begin(stage)
        self.started += 1
        _strip_secrets(Path(HydraConfig.get().sweep.dir) / HYDRAS_RECORD)
        text = _text(overrides, self.swept)
        console.headline(f"cell {self.started}/{len(self.cells)}", text)
        cell = Cell(text, _without_groups(text, self.swept), self.record.run_id if self.record else None)
        try:
            own_folder = {"output_dir": _cell_dir(config.output_dir, text)}
            stage.start(config.model_copy(update=own_folder), Session(pool, cell))
        except InputError as error:
            self.failed.append(f"{text}: {error}")
            if self.record is not None:
                self.record.note_failure(cell.text, cell.title, str(error))
            refuse(error)
        else:
            if stage.compare is not None and not config.dry_run:
                whole = Session(pool, Cell(parent_run_id=cell.parent_run_id))
                self.compare = partial(stage.compare.start, self.whole, whole)

    def _begin(self, stage: Stage) -> None:
        """Check what the stage can check of every cell, and begin the sweep in MLflow.

        Raises:
            UserError: a cell is wrong; the message says what is wrong with each.
        """
        problems = []
        for text, config in self.cells.items():
            try:
                stage.check(config)
            except InputError as error:
                problems.append(f"cell {text}: {error}")
        if problems:
            raise UserError("\n".join([REFUSAL, *dict.fromkeys(problems)]))
        if not self.whole.dry_run:
            self.record = _record(self.whole, self.overrides)

    def end(self) -> None:
        """Compare the cells, and say which failed."""
        if self.compare is not None:
            self.compare()
        if self.failed:
            headline = f"{len(self.failed)} of {counted(len(self.cells), 'cell')} failed:"
            sys.exit(refuse("\n".join([headline, *self.failed])))
        if self.record is not None:
            self.record.end(None)


_sweep: Sweep | None = None
"""Hydra creates the callback and calls it and the cells separately; here they find the same sweep."""


def under_way() -> Sweep | None:
    """Return the sweep that this process runs; None where it runs a stage once."""
    return _sweep


@contextlib.contextmanager
def recorded() -> Iterator[None]:
    """Let what ends the process early, failed cells too, end the sweep's MLflow run as FAILED or KILLED."""
    try:
        yield
    except BaseException as error:
        if _sweep is not None and _sweep.record is not None:
            _sweep.record.end(error)
        raise


def sweep_dir(output_dir: str) -> str:
    """Return where Hydra leaves its record of the sweep: in a local output_dir, else out of the way."""
    return tempfile.gettempdir() if "://" in output_dir else output_dir


class SweepCallback(Callback):
    """Hydra calls this before the first and after the last cell."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Check every cell and open the sweep."""
        global _sweep
        with _errors_end_the_process():
            _sweep = _open(list(config.hydra.overrides.task))

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Compare the cells."""
        if _sweep is not None:
            with _errors_end_the_process():
                _sweep.end()


@contextlib.contextmanager
def _errors_end_the_process() -> Iterator[None]:
    """End the process on errors: Hydra turns a callback's exceptions, except `SystemExit`, into warnings."""
    try:
        yield
    except InputError as error:
        sys.exit(refuse(error))
    except Exception:
        sys.excepthook(*sys.exc_info())
        sys.exit(1)


def _open(overrides: list[str]) -> Sweep:
    """Check the configuration of every cell before any starts.

    Raises:
        UserError: a cell is wrong; the message says what is wrong with each.
    """
    loader = GlobalHydra.instance().config_loader()
    parsed = OverridesParser.create(config_loader=loader).parse_overrides(overrides)
    swept = frozenset(one.get_key_element() for one in parsed if one.is_sweep_override())
    [batch] = BasicSweeper.split_arguments(parsed, max_batch_size=None)
    cells, problems = {}, []
    for cell in batch:
        try:
            composed = loader.load_configuration(CONFIG_NAME, cell, run_mode=RunMode.RUN)
            keys = [str(key) for key in composed if key != "hydra"]
            cells[_text(cell, swept)] = schema.load(OmegaConf.masked_copy(composed, keys))
        except Exception as error:
            problems.append(f"cell {_text(cell, swept)}: {error}")
    if problems:
        raise UserError("\n".join([REFUSAL, *dict.fromkeys(problems)]))
    console.headline("sweep", f"{counted(len(batch), 'cell')} over {', '.join(sorted(swept)) or 'nothing'}")
    return Sweep(swept, cells, overrides)


def _record(config: Config, overrides: Sequence[str]) -> "SweepRecord":
    from pipeline.backends.runs import SweepRecord  # MLflow takes seconds to import

    return SweepRecord(config.tracking.uri, config.tracking.experiment_name, config.output_dir, overrides)


def _strip_secrets(record: Path) -> None:
    """Rewrite Hydra's record of the sweep, which it has just written, without the secrets of addresses."""
    if record.is_file() and (text := record.read_text()) != (stripped := without_secrets(text)):
        record.write_text(stripped)


def _text(overrides: Sequence[str], swept: frozenset[str]) -> str:
    return ",".join(one for one in overrides if one.partition("=")[0] in swept)


def _without_groups(text: str, swept: frozenset[str]) -> str:
    short = {key: key.rpartition(".")[2] for key in swept}
    if len(set(short.values())) < len(short):
        return text
    return re.sub(r"[\w.+]+(?==)", lambda key: short.get(key[0], key[0]), text)


def _cell_dir(output_dir: str, text: str) -> str:
    name = re.sub(r"[^A-Za-z0-9=.,+-]", "_", text)
    if len(name) > LONGEST_NAME:
        name = f"{name[:LONGEST_NAME]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    return f"{output_dir.rstrip('/')}/{CELLS}/{name}" if name else output_dir
