"""Sweeps (``-m``): all cells are checked before the first one starts, each has its own folder and MLflow child run.

A cell's results are in ``<output_dir>/cells/<what was swept>``; the report of ``<output_dir>`` compares the cells.
Hydra runs the cells one after the other in this process, so the state of the sweep under way is kept here.
"""

import contextlib
import hashlib
import re
import sys
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from pipeline.base import config as schema
from pipeline.base import console
from pipeline.base.config import Config, UserError

CELLS = "cells"
LONGEST_NAME = 120
CONFIG_NAME = "config"


@dataclass
class _Sweep:
    """The sweep under way."""

    swept: frozenset[str]
    config: Config
    cells: int
    cell: str = ""
    wants_report: bool = False
    started: int = 0
    failed: list[str] = field(default_factory=list)
    parent_run_id: str | None = None
    cleanup: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)


_sweep: _Sweep | None = None


def sweep_dir(output_dir: str) -> str:
    """Where Hydra leaves its record of the sweep: in a local output_dir, else out of the way."""
    return tempfile.gettempdir() if "://" in output_dir else output_dir


def cell_text() -> str:
    """What the cell under way has of the swept values: ``planner.pouct.samples=100``; empty outside sweeps."""
    return _sweep.cell if _sweep else ""


def short_cell_text() -> str:
    """The same without the keys' groups, ``samples=100``, where that is as clear: lists show names cut off."""
    if not _sweep:
        return ""
    short = {key: key.rpartition(".")[2] for key in _sweep.swept}
    if len(set(short.values())) < len(short):
        return _sweep.cell
    return re.sub(r"[\w.+]+(?==)", lambda key: short.get(key[0], key[0]), _sweep.cell)


def parent_run_id() -> str | None:
    """The MLflow run of the sweep under way."""
    return _sweep.parent_run_id if _sweep else None


def enter_cell(config: Config, overrides: Sequence[str]) -> Config:
    """The configuration of the cell that starts now, with its own output folder."""
    if _sweep is None:
        return config
    _sweep.started += 1
    _sweep.cell = _text(overrides, _sweep.swept)
    console.headline(f"cell {_sweep.started}/{_sweep.cells}", _sweep.cell)
    return config.model_copy(update={"output_dir": _cell_dir(config.output_dir, _sweep.cell)})


def want_report() -> None:
    """Said by a stage that has written episodes: at its end, the sweep compares its cells."""
    if _sweep is not None:
        _sweep.wants_report = True


def note_failure(error: Exception) -> bool:
    """In a sweep, takes note of a cell's mistake so that the others still run; else False."""
    if _sweep is None:
        return False
    _sweep.failed.append(f"{_sweep.cell}: {error}")
    print(f"error: {error}", file=sys.stderr)
    return True


class SweepCallback(Callback):
    """Hydra calls this before the first and after the last cell."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Checks every cell and opens the sweep."""
        global _sweep
        with _errors_end_the_process():
            _sweep = _open(list(config.hydra.overrides.task))

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Compares the cells."""
        if _sweep is not None:
            with _errors_end_the_process():
                _close(_sweep)


def interrupted(error: BaseException) -> None:
    """Marks the sweep's MLflow run as killed."""
    if _sweep is not None:
        _sweep.cleanup.__exit__(type(error), error, error.__traceback__)


@contextlib.contextmanager
def _errors_end_the_process() -> Iterator[None]:
    """Hydra turns a callback's exceptions into warnings and goes on; but for `SystemExit`."""
    try:
        yield
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except Exception:
        traceback.print_exc()
        sys.exit(1)


def _open(overrides: list[str]) -> _Sweep:
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
    opened = _Sweep(swept, configs[0], len(batch))
    console.headline("sweep", f"{len(batch)} cells over {', '.join(sorted(swept)) or 'nothing'}")
    if not opened.config.dry_run:
        from pipeline.backends import tracking

        store = tracking.open_tracking(opened.config.tracking.uri, opened.config.tracking.experiment_name)
        tags = {"stage": "sweep", "output_dir": opened.config.output_dir}
        run = tracking.run(store, f"sweep {', '.join(sorted(swept))}", {"overrides": " ".join(overrides)}, tags)
        opened.parent_run_id = opened.cleanup.enter_context(run).run_id
    return opened


def _close(sweep: _Sweep) -> None:
    from pipeline import report

    failed = sweep.failed
    if sweep.wants_report and len(failed) < sweep.started:
        report.report(sweep.config, sweep.parent_run_id)
    sweep.cleanup.close()
    if failed:
        print("\n".join([f"error: {len(failed)} of {sweep.cells} cells failed:", *failed]), file=sys.stderr)
        sys.exit(2)


def _text(overrides: Sequence[str], swept: frozenset[str]) -> str:
    return ",".join(one for one in overrides if one.partition("=")[0] in swept)


def _cell_dir(output_dir: str, text: str) -> str:
    name = re.sub(r"[^A-Za-z0-9=.,+-]", "_", text)
    if len(name) > LONGEST_NAME:
        name = f"{name[:LONGEST_NAME]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    return f"{output_dir.rstrip('/')}/{CELLS}/{name}" if name else output_dir
