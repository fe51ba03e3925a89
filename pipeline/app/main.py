"""Makes a stage module runnable: ``python -m pipeline.<stage>`` as a Hydra app that reports mistakes in one way.

A user's mistake (wrong key, missing file, no champion, ...) ends in one message on stderr and exit code 2, an interrupt
in exit code 130; anything else is a bug and keeps its traceback.
"""

import atexit
import importlib
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from types import TracebackType

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from mrtask.errors import INTERRUPT_EXIT, InputError, refuse, without_secrets
from mrtask.files import default_cache_dir
from pipeline.app import sweep
from pipeline.app.stage import Session, Stage
from pipeline.backends.pool import Pool
from pipeline.base import config as schema
from pipeline.base import interrupt
from pipeline.base.config import CONF_DIR
from pipeline.base.sections import Cluster

FORMULA_KEY, TASK_KEY = "evaluation.formula", "evaluation.task"


def main(module_name: str) -> None:
    """Run the module's ``STAGE`` with the configuration from the command line."""
    _prepare_process(module_name)
    try:
        with interrupt.remembered():
            hydra.main(version_base="1.3", config_path=str(CONF_DIR), config_name="config")(_task(module_name))()
    except (HydraException, OmegaConfBaseException) as error:
        sys.exit(refuse(_friendly(str(error))))
    except KeyboardInterrupt as stop:
        if running := sweep.under_way():
            running.interrupted(stop)
        print(interrupt.MESSAGE, file=sys.stderr)
        sys.exit(INTERRUPT_EXIT)


class _Workers:
    """Keeps the pool of the cluster in use; the cells of a sweep share it, and it ends with the process."""

    def __init__(self) -> None:
        self._cluster: Cluster | None = None
        self._open = ExitStack()
        atexit.register(self._open.close)

    def of(self, cluster: Cluster) -> Pool:
        """Return the workers of this cluster, after closing those of another."""
        if cluster != self._cluster:
            self._open.close()
            self._cluster, self._pool = cluster, self._open.enter_context(Pool(cluster))
        return self._pool


def _task(module_name: str) -> Callable[[DictConfig], None]:
    workers = _Workers()

    def task(composed: DictConfig) -> None:
        try:
            config = schema.load(composed)
            # Imported by name even when it is __main__, so that workers find what it sends them.
            stage: Stage = importlib.import_module(module_name).STAGE
            pool = workers.of(config.cluster)
            if running := sweep.under_way():
                running.run_cell(stage, config, HydraConfig.get().overrides.task, pool)
            else:
                stage.start(config, Session(pool))
        except InputError as error:
            sys.exit(refuse(_friendly(str(error))))

    return task


def _prepare_process(module_name: str) -> None:
    # Exceptions reach `main` instead of being printed by Hydra.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    sys.excepthook = _print_exception
    sys.argv = [_for_hydra(argument) for argument in sys.argv]
    if not sys.warnoptions:
        warnings.filterwarnings("ignore")
    module = importlib.import_module(module_name)
    sys.argv[1:] = [_written_out(argument, module.STAGE.shorthands) for argument in sys.argv[1:]]
    stage_help = module.__doc__ if "--help" in sys.argv else ""
    for name, value in (
        ("stage_name", module_name),
        ("stage_help", stage_help),
        ("default_cache_dir", str(default_cache_dir())),
    ):
        OmegaConf.register_new_resolver(name, lambda value=value: value, replace=True)
    OmegaConf.register_new_resolver("sweep_dir", sweep.sweep_dir, replace=True)


def _print_exception(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print a bug's traceback as Python does, but for the secrets of addresses in it."""
    print(without_secrets("".join(traceback.format_exception(kind, error, trace))), end="", file=sys.stderr)


def _for_hydra(argument: str) -> str:
    """Return an argument in Hydra's grammar: formulas and tasks in quotes, which the shell has removed."""
    if argument == "--dry-run":
        return "dry_run=true"
    key, equals, text = argument.partition("=")
    name = key.lstrip("+")
    if name not in (FORMULA_KEY, TASK_KEY) or not equals or text == "null" or text.startswith(("'", '"')):
        return argument
    if name == TASK_KEY:
        return f"{key}='{text.strip()}'"
    # In a formula, unlike in words, a comma can only separate the values of a sweep.
    return f"{key}=" + ",".join(f"'{formula.strip()}'" for formula in text.split(","))


def _written_out(argument: str, shorthands: Mapping[str, str]) -> str:
    """Return an override with its key's group."""
    key, equals, value = argument.partition("=")
    return f"{shorthands.get(key, key)}{equals}{value}"


def _friendly(message: str) -> str:
    """Return a message; if Hydra refuses an unknown key, with the keys that exist."""
    unknown = re.search(r"Could not override '([^']+)'", message)
    return schema.explain_unknown_key(unknown[1]) if unknown else message.partition("\n\nConfig search path")[0]
