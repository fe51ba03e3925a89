"""A configuration as the command line makes it, without a stage."""

import copy
import functools
from collections.abc import Sequence

from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf

from pipeline.app.main import _for_hydra
from pipeline.base.config import CONF_DIR, Config, load


def configured(*arguments: str) -> Config:
    """The checked configuration; raises `UserError` as a stage does.

    Hydra composes once for every choice of groups, which takes most of the time; other keys are set as Hydra sets them.
    """
    overrides = OverridesParser.create().parse_overrides([_for_hydra(argument) for argument in arguments])
    config = copy.deepcopy(composed(tuple(str(one.input_line) for one in overrides if _is_hydras(one))))
    for one in overrides:
        if not _is_hydras(one):
            OmegaConf.update(config, one.key_or_group, one.value(), merge=True, force_add=one.is_add())
    return load(config)


def composed_by_hydra(overrides: Sequence[str]) -> DictConfig:
    """What Hydra makes of all of them."""
    for name, value in (("default_cache_dir", "/cache"), ("stage_name", ""), ("stage_help", "")):
        OmegaConf.register_new_resolver(name, lambda value=value: value, replace=True)
    OmegaConf.register_new_resolver("sweep_dir", lambda output_dir: output_dir, replace=True)
    with initialize_config_dir(str(CONF_DIR), version_base="1.3"):
        return compose("config", list(overrides))


composed = functools.cache(composed_by_hydra)


def _is_hydras(override: Override) -> bool:
    """Whether it is more than a value for a key of the configuration: a choice of a group, or about Hydra itself."""
    key = override.key_or_group
    return (CONF_DIR / key).is_dir() or key.startswith("hydra") or override.is_delete() or "@" in key
