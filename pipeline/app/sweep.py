"""Sweeps (``-m``): all cells are checked before the first one starts, each has its own folder and MLflow child run.

A cell's results are in ``<output_dir>/cells/<its values>``; the report of ``<output_dir>`` compares the cells.
Hydra runs the cells one after the other in this process.
"""

import contextlib
import hashlib
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from mrtask.errors import InputError, refuse, without_secrets
from pipeline.app.stage import Cell, Session, Stage
from pipeline.backends import runs
from pipeline.backends.pool import Pool
from pipeline.base import config as schema
from pipeline.base import console
from pipeline.base.config import Config, UserError
from pipeline.store.layout import CELLS

LONGEST_NAME = 120
CONFIG_NAME = "config"
HYDRAS_RECORD = "multirun.yaml"


@dataclass
class Sweep:
    """The sweep under way."""

    swept: frozenset[str]
    config: Config
    """The sweep's own: its output folder is that of the whole sweep."""
    cells: int
    compare: Callable[[], None] | None = None
    """What the end of the sweep calls; set by a cell that leaves something to compare."""
    started: int = 0
    failed: list[str] = field(default_factory=list)
    parent_run_id: str | None = None
    cleanup: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)

    def run_cell(self, stage: Stage, config: Config, overrides: Sequence[str], pool: Pool) -> None:
        """Run the stage in the cell's own output folder; note a user's mistake, so that the other cells still run."""
        self.started += 1
        _strip_secrets(Path(HydraConfig.get().sweep.dir) / HYDRAS_RECORD)
        text = _text(overrides, self.swept)
        console.headline(f"cell {self.started}/{self.cells}", text)
        cell = Cell(text, _without_groups(text, self.swept), self.parent_run_id)
        try:
            own_folder = {"output_dir": _cell_dir(config.output_dir, text)}
            stage.start(config.model_copy(update=own_folder), Session(pool, cell))
        except InputError as error:
            self.failed.append(f"{text}: {error}")
            refuse(error)
        else:
            if stage.compare is not None and not config.dry_run:
                whole = Session(pool, Cell(parent_run_id=self.parent_run_id))
                self.compare = partial(stage.compare.start, self.config, whole)

    def end(self) -> None:
        """Compare the cells, and say which failed."""
        if self.compare is not None:
            self.compare()
        self.cleanup.close()
        if self.failed:
            headline = f"{len(self.failed)} of {self.cells} cells failed:"
            sys.exit(refuse("\n".join([headline, *self.failed])))

    def interrupted(self, error: BaseException) -> None:
        """Mark the sweep's MLflow run as killed."""
        self.cleanup.__exit__(type(error), error, error.__traceback__)


_sweep: Sweep | None = None
"""Hydra creates the callback and calls it and the cells separately; here they find the same sweep."""


def under_way() -> Sweep | None:
    """Return the sweep that this process runs; None where it runs a stage once."""
    return _sweep


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
        sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]  # there is one
        sys.exit(1)


def _open(overrides: list[str]) -> Sweep:
    """Check every cell before any starts, and begin the MLflow run that is the parent of the cells' runs.

    Raises:
        UserError: a cell is wrong; the message says what is wrong with each.
    """
    loader = GlobalHydra.instance().config_loader()
    parsed = OverridesParser.create(config_loader=loader).parse_overrides(overrides)
    swept = frozenset(one.get_key_element() for one in parsed if one.is_sweep_override())
    [batch] = BasicSweeper.split_arguments(parsed, max_batch_size=None)
    configs, problems = [], []
    for cell in batch:
        try:
            composed = loader.load_configuration(CONFIG_NAME, cell, run_mode=RunMode.RUN)
            keys = [str(key) for key in composed if key != "hydra"]
            configs.append(schema.load(OmegaConf.masked_copy(composed, keys)))
        except Exception as error:
            problems.append(f"cell {_text(cell, swept)}: {error}")
    if problems:
        raise UserError("\n".join(["the sweep does not start:", *dict.fromkeys(problems)]))
    opened = Sweep(swept, configs[0], len(batch))
    console.headline("sweep", f"{len(batch)} cells over {', '.join(sorted(swept)) or 'nothing'}")
    if not opened.config.dry_run:
        tracking = runs.open_tracking(opened.config.tracking.uri, opened.config.tracking.experiment_name)
        tags = {"stage": "sweep", "output_dir": opened.config.output_dir}
        run = runs.run(tracking, f"sweep {', '.join(sorted(swept))}", {"overrides": " ".join(overrides)}, tags)
        opened.parent_run_id = opened.cleanup.enter_context(run).run_id
    return opened


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
