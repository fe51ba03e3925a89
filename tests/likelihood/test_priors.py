"""Priors that no model was trained for."""

import numpy as np
import pandas as pd
import pytest

from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.priors import count_triples, prior_table
from mrtask.likelihood.rows import distinct_triples, label_rows, vocabulary

NOBODY = FrequencyModel(pd.DataFrame())


def test_counts_are_those_of_the_labelled_rows(generated_homes):
    objects = vocabulary(generated_homes)
    rows = pd.concat([label_rows(home, objects) for home in generated_homes], ignore_index=True)
    pd.testing.assert_frame_equal(
        count_triples(generated_homes).sort_values(["object", "container", "room"], ignore_index=True),
        distinct_triples(rows),
    )
    some = count_triples(generated_homes, objects[:3])
    pd.testing.assert_frame_equal(some, count_triples(generated_homes).query("object in @objects[:3]"))


def test_uniform_is_the_share_of_pairs_that_are_so(made_up_homes):
    homes = made_up_homes["test"]
    table = prior_table("uniform", NOBODY, homes)
    held = [name in box.objects for home in homes for box in home.containers for name in vocabulary(homes)]
    np.testing.assert_allclose(table.probs, np.mean(held))
    assert table.objects == vocabulary(homes) and len(table.kinds) == 5


def test_the_true_prior_is_what_the_homes_themselves_hold(made_up_homes):
    homes = made_up_homes["test"]
    table = prior_table("oracle", NOBODY, homes)
    for kind in table.kinds:
        for name in table.objects:
            boxes = [box for home in homes for box in home.containers if box.type == kind[0]]
            share = np.mean([name in box.objects for box in boxes])
            assert table.probs[table.kinds.index(kind), table.objects.index(name)] == pytest.approx(share, abs=0.01)


def test_the_models_prior_is_the_models(made_up_homes):
    model = FrequencyModel(count_triples(made_up_homes["train"]))
    table = prior_table("model", model, made_up_homes["test"], ["Unicorn"])
    assert "Unicorn" in table.objects
    names = pd.DataFrame([("Mug", "Bed", "Bedroom")], columns=["object", "container", "room"], dtype="str")
    found = table.probs[table.kinds.index(("Bed", "Bedroom")), table.objects.index("Mug")]
    assert found == pytest.approx(model.predict(names)[0])
    with pytest.raises(ValueError, match="unknown prior 'flat'; allowed: model, uniform, oracle"):
        prior_table("flat", model, made_up_homes["test"])
