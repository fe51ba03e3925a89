"""How well robots see, as the configuration has it."""

import pytest

from mrtask.execution.perception import Perception, Rates
from pipeline.base.config import UserError
from tests.pipeline.configured import configured


def test_robots_see_all_there_is_unless_the_configuration_says_otherwise() -> None:
    assert configured().perception.perception() == Perception()
    assert configured().perception.perception().sees_all
    given = configured(
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
        (["perception.true_positive_prob=0.9", "belief.adapt=true"], "belief.adapt=true: takes what searches"),
    ],
)
def test_mistakes_are_refused(overrides: list[str], said: str) -> None:
    with pytest.raises(UserError) as refused:
        configured(*overrides)
    assert said in str(refused.value)
