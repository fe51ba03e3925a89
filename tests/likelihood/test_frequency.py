"""The frequency table against hand-computed estimates."""

import pandas as pd
import pytest

from mrtask.likelihood.frequency import FrequencyModel

TRAINING = pd.DataFrame(
    [
        ("Mug", "Desk", "Bedroom", 6, 10),
        ("Mug", "Desk", "LivingRoom", 1, 10),
        ("Pen", "Desk", "Bedroom", 2, 10),
    ],
    columns=["object", "container", "room", "positives", "count"],
)


def predict(*names, strength=5.0, triples=TRAINING):
    frame = pd.DataFrame([names], columns=["object", "container", "room"])
    return FrequencyModel(triples, strength).predict(frame)[0]


def shrink(positives, count, prior, strength=5.0):
    return (positives + strength * prior) / (count + strength)


OVERALL = 9.5 / 31


def test_each_estimate_is_shrunk_to_the_coarser_one():
    kind = shrink(8, 20, OVERALL)
    mug = shrink(7, 20, kind)
    assert predict("Mug", "Desk", "Bedroom") == pytest.approx(shrink(6, 10, shrink(7, 20, mug)))


def test_unseen_names_back_off():
    assert predict("Cup", "Desk", "Bedroom") == pytest.approx(shrink(8, 20, OVERALL))
    assert predict("Cup", "Shelf", "Attic") == pytest.approx(OVERALL)
    assert predict("Mug", "Shelf", "Attic") == pytest.approx(shrink(7, 20, OVERALL))


def test_much_data_is_believed():
    many = TRAINING.assign(positives=TRAINING["positives"] * 10_000, count=TRAINING["count"] * 10_000)
    assert predict("Mug", "Desk", "Bedroom", triples=many) == pytest.approx(0.6, abs=1e-3)
