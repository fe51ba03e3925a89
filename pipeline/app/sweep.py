"""Sweeps (``-m``): all cells are checked before the first one starts, each has its own folder and MLflow child run.

A cell's results are in ``<output_dir>/cells/<its values>``; the report of ``<output_dir>`` compares the cells.
The first cell makes what all share: homes, model, maps, compiled kernels. Then, where the stage allows it, cells run
side by side, in threads of this process, over the same workers.
"""

import contextlib
import hashlib
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from mrtask.errors import InputError, refuse, without_secrets
from mrtask.names import counted
from pipeline.app.stage import Cell, Session, Stage
from pipeline.backends.pool import Pool
from pipeline.base import config as schema
from pipeline.base import console, interrupt
from pipeline.base.config import Config, UserError
from pipeline.store.layout import CELLS

if TYPE_CHECKING:
    from pipeline.backends.runs import SweepRecord

LONGEST_NAME = 120
CONFIG_NAME = "config"
HYDRAS_RECORD = "multirun.yaml"
REFUSAL = "the sweep does not start:"
MOST_AT_ONCE = 8
"""How many cells run side by side at most: each takes memory, here and in workers."""
WAIT_S = 1.0


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
    failed: dict[str, str] = field(default_factory=dict)
    """The cells that failed, and why."""
    record: "SweepRecord | None" = None
    """Where MLflow keeps the sweep; begun before the first cell starts."""
    _threads: ThreadPoolExecutor | None = None
    _side_by_side: set[Future[None]] = field(default_factory=set)

    @property
    def whole(self) -> Config:
        """The configuration of what concerns all cells."""
        return next(iter(self.cells.values()))

    def run_cell(self, stage: Stage, config: Config, overrides: Sequence[str], pool: Pool) -> None:
        """Run the stage in the cell's own output folder, or begin to, beside other cells."""
        if self.started == 0:
            self._begin(stage)
        self.started += 1
        text = _text(overrides, self.swept)
        cell = Cell(text, _without_groups(text, self.swept), self.record.run_id if self.record else None)
        run = partial(self._run, stage, config, Session(pool, cell), f"cell {self.started}/{len(self.cells)}")
        if self.started == 1 or not stage.side_by_side or config.dry_run:
            run()
            return
        if self._threads is None:
            self._threads = ThreadPoolExecutor(max(1, min(pool.slots, MOST_AT_ONCE)))
        self._side_by_side.add(self._threads.submit(console.labelled, cell.title, run))

    def _run(self, stage: Stage, config: Config, session: Session, place: str) -> None:
        """Run the stage for a cell; note a user's mistake, so that the other cells still run."""
        cell = session.cell
        console.headline(place, cell.text)
        try:
            own_folder = {"output_dir": _cell_dir(config.output_dir, cell.text)}
            stage.start(config.model_copy(update=own_folder), session)
        except InputError as error:
            self.failed[cell.text] = str(error)
            if self.record is not None:
                self.record.note_failure(cell.text, cell.title, str(error))
            refuse(error)
        else:
            if stage.compare is not None and not config.dry_run:
                whole = Session(session.pool, Cell(parent_run_id=cell.parent_run_id))
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
        """Wait for the cells that run side by side, compare all, and say which failed."""
        if self._threads is not None:
            with self._threads as threads:
                try:
                    self._wait()
                except BaseException:
                    threads.shutdown(wait=False, cancel_futures=True)
                    raise
        if self.compare is not None:
            self.compare()
        if self.failed:
            headline = f"{len(self.failed)} of {counted(len(self.cells), 'cell')} failed:"
            reasons = (f"{cell}: {self.failed[cell]}" for cell in self.cells if cell in self.failed)
            sys.exit(refuse("\n".join([headline, *reasons])))
        if self.record is not None:
            self.record.end(None)

    def _wait(self) -> None:
        """Wait until the cells have ended, with one progress line for all.

        Raises:
            Exception: what a cell raised that is no mistake of the user's; no further cell starts then.
        """
        waiting = self._side_by_side
        with console.Progress(len(self.cells), "cells", len(self.cells) - len(waiting)) as progress:
            while waiting:
                ended, waiting = wait(waiting, WAIT_S, FIRST_COMPLETED)
                for one in ended:
                    one.result()
                progress.update(len(ended), console.under_way())
                interrupt.check()


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
    """Hydra calls this before the first cell, before each, and after the last one."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Check every cell and open the sweep."""
        global _sweep
        with _errors_end_the_process():
            _sweep = _open(list(config.hydra.overrides.task))

    def on_job_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Take the secrets out of Hydra's record of the sweep, which it has written by now."""
        if _sweep is not None:
            _strip_secrets(Path(config.hydra.sweep.dir) / HYDRAS_RECORD)

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
    """Rewrite a file without the secrets of addresses in it."""
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
