"""What is known of objects that are somewhere."""

from itertools import product

import numpy as np
import pytest

from mrtask.likelihood.existence import LEAST_EXISTENCE, before_existence, given_existence

PROBS = np.array([[0.2, 0.5, 0.001], [0.6, 0.01, 0.03], [0.3, 0.02, 0.002]])


def test_existence_is_taken_into_account_as_in_a_sum_over_all_worlds():
    for column, found in zip(PROBS.T, given_existence(PROBS).T, strict=True):
        somewhere, held = 0.0, np.zeros(3)
        for world in product((0, 1), repeat=3):
            weight = np.prod([p if there else 1 - p for p, there in zip(column, world, strict=True)])
            if any(world):
                somewhere += weight
                held += weight * np.array(world)
        np.testing.assert_allclose(found, held / somewhere)


def test_what_leads_there_is_found_again():
    np.testing.assert_allclose(before_existence(given_existence(PROBS)), PROBS, rtol=1e-9)


def test_an_object_that_is_surely_somewhere_and_one_that_is_in_one_place_at_most():
    sure = np.array([[1 - 1e-6, 0.25], [0.2, 0.5], [0.1, 0.25]])
    found = before_existence(sure)
    np.testing.assert_allclose(found[:, 0], sure[:, 0], rtol=1e-5)
    assert found[:, 1] == pytest.approx(LEAST_EXISTENCE * sure[:, 1])
    np.testing.assert_allclose(given_existence(found)[:, 1], sure[:, 1], rtol=0.01)
