"""What is known of objects that are somewhere."""

from itertools import product

import numpy as np

from mrtask.likelihood.existence import given_existence

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
