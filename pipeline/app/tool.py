"""Makes a tool runnable: ``python -m pipeline.<tool> key=value ...``, without Hydra, Ray or MLflow, to start soon.

Unlike a stage's overrides, a task is taken literally: ``task="laptop or wallet, then remote"`` needs no more quotes.
A user's mistake ends in one message on stderr and exit code 2, an interrupt in 130, as with stages.
"""

import sys
import warnings
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import BaseModel, ValidationError

from mrtask.errors import INTERRUPT_EXIT, InputError, refuse
from mrtask.names import suggest
from pipeline.base.config import CONF_DIR, UserError, explain_error

_Options = TypeVar("_Options", bound=BaseModel)


def main(run: Callable[[Sequence[str]], None], help_text: str) -> None:
    """Run ``run(arguments)`` with the command line's arguments; ``--help`` prints ``help_text``."""
    if not sys.warnoptions:
        warnings.filterwarnings("ignore")
    if {"--help", "-h"} & set(sys.argv[1:]):
        print(help_text)
        return
    try:
        run(sys.argv[1:])
    except InputError as error:
        sys.exit(refuse(error))
    except KeyboardInterrupt:
        sys.exit(INTERRUPT_EXIT)


def overrides(arguments: Sequence[str], verbatim: Collection[str] = ()) -> dict[str, Any]:
    """Return ``key=value`` arguments as a dictionary; values are YAML, except those of the ``verbatim`` keys.

    Raises:
        UserError: an argument is no ``key=value``, or its value no YAML.
    """
    given = {}
    for argument in arguments:
        key, equals, text = argument.partition("=")
        if not equals or not key.strip():
            raise UserError(f"{argument!r} is no key=value")
        try:
            given[key.strip()] = text if key in verbatim else yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise UserError(f"{key}: {text!r} cannot be read ({error})") from None
    return given


def load_options(model: type[_Options], files: Sequence[Path], given: dict[str, Any]) -> _Options:
    """Return the checked options: each YAML file overrides those before it, and the command line overrides all.

    Keys that the model does not have are ignored in all files but the first: several tools read them.

    Raises:
        UserError: every mistake, with what is allowed.
    """
    planners = OmegaConf.create({})
    if "planner" in model.model_fields:
        planners.planner = OmegaConf.load(CONF_DIR / "planner" / "default.yaml")
    try:
        first, *others = (cast(DictConfig, OmegaConf.load(path)) for path in files)
        known = [{key: one[key] for key in map(str, one) if key in model.model_fields} for one in others]
        merged = OmegaConf.merge(planners, first, *known)
        for key, value in given.items():
            OmegaConf.update(merged, key, value, force_add=True)
        plain = OmegaConf.to_container(merged, resolve=True)
    except OmegaConfBaseException as error:
        raise UserError(str(error)) from error
    try:
        return model.model_validate(plain)
    except ValidationError as error:
        raise UserError("\n".join(_explain(item, model) for item in error.errors())) from error


def _explain(item: Any, model: type[BaseModel]) -> str:
    if not item["loc"]:  # it concerns several keys, which the message names
        return str(item["msg"]).removeprefix("Value error, ")
    if item["type"] == "extra_forbidden" and len(item["loc"]) == 1:
        key = str(item["loc"][0])
        return f"{key}: no such key; {suggest(key, list(model.model_fields))}"
    return explain_error(item)
