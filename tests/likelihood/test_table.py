"""The lookup table that evaluations take instead of the model."""

import pickle

import numpy as np
import pandas as pd
import pytest

from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.table import build_table


class CountingModel:
    """A model that counts its calls; wraps another."""

    kind = "counting"

    def __init__(self, model):
        self.model, self.calls = model, 0

    def predict(self, names):
        self.calls += 1
        return self.model.predict(names)

    def save(self, folder):
        raise NotImplementedError


@pytest.fixture
def model(made_up_dataset):
    return CountingModel(FrequencyModel(made_up_dataset.triples("train")))


def test_matrix_is_what_the_model_says_in_one_prediction(model, made_up_homes):
    homes = made_up_homes["test"]
    table = build_table(model, homes)
    assert model.calls == 1
    objects = ["Mug", "Apple"]
    for home in homes[:5]:
        matrix = table.matrix(home, objects)
        assert matrix.shape == (len(home.containers), 2) and matrix.dtype == np.float64
        for row, (container, room) in enumerate(home.container_kinds()):
            names = pd.DataFrame({"object": objects, "container": container, "room": room})
            assert np.array_equal(matrix[row], model.model.predict(names))


def test_objects_of_tasks_that_are_in_no_home(model, made_up_homes):
    home = made_up_homes["test"][0]
    table = build_table(model, [home], extra_objects=["Unicorn"])
    assert table.matrix(home, ["Unicorn"]).shape == (5, 1)
    with pytest.raises(KeyError, match="no likelihood for the object 'Dragon'"):
        table.matrix(home, ["Dragon"])


def test_container_of_a_home_not_built_for(model, made_up_homes, home_of):
    table = build_table(model, made_up_homes["test"])
    with pytest.raises(KeyError, match=r"no likelihood for the \(container, room\) \('Safe', 'Bedroom'\)"):
        table.matrix(home_of(1, [("Safe", "Bedroom", [])]), ["Mug"])


def test_small_when_sent_to_workers_and_the_same_there(model, made_up_homes):
    table = build_table(model, made_up_homes["test"])
    table.matrix(made_up_homes["test"][0], ["Mug"])
    sent = pickle.dumps(table)
    assert len(sent) < 5_000
    home = made_up_homes["test"][1]
    assert np.array_equal(pickle.loads(sent).matrix(home, ["Mug"]), table.matrix(home, ["Mug"]))
