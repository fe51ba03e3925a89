"""Makes a stage module runnable: ``python -m pipeline.<stage>`` as a Hydra app that reports mistakes in one way.

A user's mistake (wrong key, missing file, no champion, ...) ends in one message on stderr and exit code 2, an interrupt
in exit code 130; anything else is a bug and keeps its traceback.

What stages work with takes seconds to import. So a stage's module calls `main` before its other imports, and what this
module imports knows nothing of them: ``--help`` and mistakes in the configuration are answered at once.
"""

import atexit
import importlib
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import groupby
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import NoReturn

import hydra
from hydra import compose, initialize_config_dir
from hydra._internal.hydra import Hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from mrtask.errors import INTERRUPT_EXIT, InputError, refuse, without_secrets
from mrtask.files import default_cache_dir
from mrtask.names import suggest
from pipeline.app import sweep
from pipeline.app.stage import Session, Stage
from pipeline.backends.pool import Pool
from pipeline.base import config as schema
from pipeline.base import interrupt
from pipeline.base.config import CONF_DIR
from pipeline.base.sections import Cluster

_QUOTED_FOR_HYDRA = re.compile(r"""'.*'|"[^"]*"(,"[^"]*")*""")
"""What already has Hydra's quotes. Double ones may also begin a formula, around the name of an object."""
_COMMA = re.compile(r',(?=(?:[^"]*"[^"]*")*[^"]*$)')
"""A comma with an even number of double quotes after it: it stands outside of them."""
FORMULA_KEY, TASK_KEY = "evaluation.formula", "evaluation.task"


def main(module_name: str, shorthands: Mapping[str, str] = MappingProxyType({})) -> NoReturn:
    """Run the module's ``STAGE`` with the configuration from the command line, and end the process.

    Args:
        module_name: the stage's module.
        shorthands: keys that the stage also takes without their group: ``trial_id`` -> ``replay.trial_id``.
    """
    _prepare_process(module_name, shorthands)
    try:
        _check_groups(sys.argv[1:])
        if {"--help", "-h"} & set(sys.argv[1:]):
            print(help_text(module_name, sys.argv[1:]))
            sys.exit()
        with interrupt.remembered(), sweep.recorded():
            hydra.main(version_base="1.3", config_path=str(CONF_DIR), config_name="config")(_task(module_name))()
    except (HydraException, OmegaConfBaseException, InputError) as error:
        sys.exit(refuse(_friendly(str(error))))
    except KeyboardInterrupt:
        print(interrupt.MESSAGE, file=sys.stderr)
        sys.exit(INTERRUPT_EXIT)
    sys.exit()


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
            with interrupt.importing():
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


def _prepare_process(module_name: str, shorthands: Mapping[str, str]) -> None:
    # Exceptions reach `main` instead of being printed by Hydra.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    sys.excepthook = _print_exception
    sys.argv[1:] = [_for_hydra(argument) for argument in _flags_first(sys.argv[1:])]
    if not any(argument.startswith("hydra.mode=") for argument in sys.argv):
        # Hydra would compose the whole configuration twice, first only to look for this key, which ours does not set.
        Hydra.get_mode = lambda *_, **__: None  # type: ignore[method-assign]
    if not sys.warnoptions:
        warnings.filterwarnings("ignore")
    sys.argv[1:] = [_written_out(argument, shorthands) for argument in sys.argv[1:]]
    OmegaConf.register_new_resolver("default_cache_dir", lambda: str(default_cache_dir()), replace=True)
    OmegaConf.register_new_resolver("sweep_dir", sweep.sweep_dir, replace=True)


def _print_exception(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print a bug's traceback as Python does, but for the secrets of addresses in it."""
    print(without_secrets("".join(traceback.format_exception(kind, error, trace))), end="", file=sys.stderr)


def help_text(module_name: str, arguments: Sequence[str]) -> str:
    """Return what ``--help`` says: the stage, the groups of the configuration, and all keys with these overrides.

    Hydra's own help takes as long again as everything before it, since it reads the whole configuration for each group.
    """
    with initialize_config_dir(str(CONF_DIR), version_base="1.3"):
        composed = compose("config", [one for one in arguments if not one.startswith("-")])
    presets = sorted(CONF_DIR.glob("*/*.yaml"))
    groups = [f"{name}: {', '.join(path.stem for path in of_group)}" for name, of_group in _by_folder(presets)]
    command = command_of(module_name)
    return "\n".join(
        [
            (sys.modules["__main__"].__doc__ or "").strip(),
            "",
            f"Usage: {command} [KEY=VALUE ...]",
            "  experiment=smoke              a preset from conf/experiment",
            "  evaluation.robots=[1,2]       any key below",
            "  -m planner.pouct.samples=100,1000   one run for each value (sweep)",
            "",
            "== Groups (group=option) ==",
            *groups,
            "",
            "== Configuration (override any of it by key=value) ==",
            OmegaConf.to_yaml(composed),
        ]
    )


def _by_folder(paths: Sequence[Path]) -> Iterator[tuple[str, list[Path]]]:
    for folder, inside in groupby(paths, key=lambda path: path.parent):
        yield folder.name, list(inside)


def command_of(module_name: str) -> str:
    """Return how a stage is started: ``python -m pipeline.<name>`` in a checkout, ``mrtask <name>`` installed."""
    package, _, name = module_name.rpartition(".")
    return f"mrtask {name}" if package.startswith("mrtask") else f"python -m {module_name}"


def _check_groups(arguments: Sequence[str]) -> None:
    """Raise `InputError` where a group is given a number or the like; Hydra would end in a bare ValueError."""
    for argument in arguments:
        group, equals, option = argument.partition("=")
        if equals and re.fullmatch(r"\w+", group) and re.fullmatch(r"[\d.+-]+|null|true|false", option):
            options = sorted(path.stem for path in (CONF_DIR / group).glob("*.yaml"))
            if options and option not in options:
                raise InputError(f"{group}={option}: no such option of the group; {suggest(option, options)}")


def _flags_first(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with ``-m`` first: Hydra's parser reads no override after one that stands in the middle."""
    return sorted(arguments, key=lambda argument: argument not in ("-m", "--multirun"))


def _for_hydra(argument: str) -> str:
    """Return an argument in Hydra's grammar: formulas and tasks in quotes, which the shell has removed."""
    if argument == "--dry-run":
        return "dry_run=true"
    key, equals, text = argument.partition("=")
    name = key.lstrip("+")
    if name not in (FORMULA_KEY, TASK_KEY) or not equals or text == "null" or _QUOTED_FOR_HYDRA.fullmatch(text):
        return argument
    # In a formula, unlike in words, a comma outside of a name in quotes can only separate the values of a sweep.
    values = [text] if name == TASK_KEY else _COMMA.split(text)
    return f"{key}=" + ",".join(_quoted(value.strip()) for value in values)


def _quoted(value: str) -> str:
    escaped = value.replace("'", r"\'")
    return f"'{escaped}'"


def _written_out(argument: str, shorthands: Mapping[str, str]) -> str:
    """Return an override with its key's group."""
    key, equals, value = argument.partition("=")
    return f"{shorthands.get(key, key)}{equals}{value}"


def _friendly(message: str) -> str:
    """Return a message; if Hydra refuses an unknown key, with the keys that exist."""
    unknown = re.search(r"Could not override '([^']+)'", message)
    return schema.explain_unknown_key(unknown[1]) if unknown else message.partition("\n\nConfig search path")[0]
