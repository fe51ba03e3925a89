"""How well robots see, as the configuration has it."""

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from mrtask.execution.perception import Perception, Rates
from pipeline.app.main import CONF_DIR
from pipeline.base.config import Config, UserError, load


def make(*overrides: str) -> Config:
    for name in ("default_cache_dir", "stage_name", "stage_help"):
        OmegaConf.register_new_resolver(name, lambda: "/none", replace=True)
    OmegaConf.register_new_resolver("sweep_dir", lambda output_dir: output_dir, replace=True)
    with initialize_config_dir(str(CONF_DIR), version_base="1.3"):
        return load(compose("config", list(overrides)))


def test_robots_see_all_there_is_unless_the_configuration_says_otherwise() -> None:
    assert make().perception.perception() == Perception()
    assert make().perception.perception().sees_all
    given = make(
        "perception.true_positive_prob=0.9",
        "+perception.objects.Mug={true_positive_prob: 0.7, false_positive_prob: 0.1}",
    )
    assert given.perception.perception() == Perception(Rates(0.9, 0.0), {"Mug": Rates(0.7, 0.1)})


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["perception.true_positive_prob=1.5"], "perception.true_positive_prob=1.5: must be at most 1"),
        (["perception.false_positive_prob=1.0"], "a detection says nothing"),
        (["+perception.objects.Mug={true_positive_prob: 0.0, false_positive_prob: 0.0}"], "a detection says nothing"),
        (["+perception.objects.Mug={hits: 0.5}"], "perception.objects.Mug.true_positive_prob: a value is needed"),
        (["perception.true_positive_prob=0.9", "belief.adapt=true"], "belief.adapt=true: learns from what searches"),
    ],
)
def test_mistakes_are_refused(overrides: list[str], said: str) -> None:
    with pytest.raises(UserError) as refused:
        make(*overrides)
    assert said in str(refused.value)
