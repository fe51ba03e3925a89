"""Likelihoods for programs that use the library: a function of names, and models learned from homes."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mrtask.errors import InputError
from mrtask.homes.home import Home
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.function import FunctionModel
from mrtask.likelihood.model import PROB_FLOOR
from mrtask.likelihood.options import TrainingOptions
from mrtask.likelihood.rows import TRIPLE, distinct_triples, label_rows, vocabulary
from mrtask.likelihood.training import fit_on_homes


def test_a_function_is_asked_once_for_each_triple() -> None:
    asked = []

    def function(*names: str) -> float:
        asked.append(names)
        return {"Egg": 0.25, "Mug": 0.0}[names[0]]

    egg, mug = ("Egg", "Fridge", "Kitchen"), ("Mug", "Fridge", "Kitchen")
    names = pd.DataFrame([egg, mug, egg, egg], columns=TRIPLE, dtype="str")
    assert FunctionModel(function).predict(names).tolist() == [0.25, PROB_FLOOR, 0.25, 0.25]
    assert asked == [egg, mug]


@pytest.mark.parametrize("prob", [-0.1, 1.5, float("nan")])
def test_what_is_no_probability_is_refused(prob: float, tmp_path: Path) -> None:
    names = pd.DataFrame([("Egg", "Fridge", "Kitchen")], columns=TRIPLE, dtype="str")
    with pytest.raises(InputError, match=r"Egg in Fridge in Kitchen must lie in \[0, 1\]"):
        FunctionModel(lambda *_: prob).predict(names)
    with pytest.raises(InputError, match="cannot be saved"):
        FunctionModel(lambda *_: 0.5).save(tmp_path)


def test_learning_from_homes_is_learning_from_their_rows(two_room_home: Home) -> None:
    objects = vocabulary([two_room_home])
    triples = distinct_triples(label_rows(two_room_home, objects))
    names = triples[TRIPLE]
    learned = fit_on_homes([two_room_home]).predict(names)
    assert np.array_equal(learned, FrequencyModel(triples).predict(names))


def test_what_cannot_be_learned_is_told(two_room_home: Home, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="nothing to learn from"):
        fit_on_homes([])
    monkeypatch.setattr("mrtask.likelihood.training.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"'similarity' needs more packages: pip install 'mrtask\[train\]'"):
        fit_on_homes([two_room_home], options=TrainingOptions(kind="similarity"))
