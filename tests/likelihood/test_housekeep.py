"""Housekeep's measure against a count by hand, and votes as rows."""

from pathlib import Path

import numpy as np
import pytest

from mrtask.homes.votes import Votes, VotesError, read_splits, read_votes
from mrtask.likelihood.housekeep import mean_average_precision, predict_votes, vote_triples
from mrtask.likelihood.options import TrainingOptions
from mrtask.likelihood.training import fit

HUMAN = Path(__file__).parents[2].parent / "shared" / "human"
PLACES = (("kitchen", "table"), ("kitchen", "fridge"), ("kitchen", "sink"), ("hall", "table"))


def votes(right, objects=("Cup", "Egg")):
    """Return votes in which ``right [K, O]`` of ten people call each place right."""
    ranks = np.zeros((*np.shape(right), 10), dtype=np.int16)
    for place, row in enumerate(right):
        for index, count in enumerate(row):
            ranks[place, index, :count] = 1
    return Votes(PLACES, objects, ranks)


def test_the_measure_is_the_mean_over_objects_and_rooms_with_a_right_place():
    found = votes([[6, 0], [5, 10], [9, 6], [7, 5]])
    scores = np.array([[0.1, 0.3], [0.2, 0.1], [0.3, 0.2], [0.5, 0.5]])
    # Cup in the kitchen: sink right at rank 1, table at 3; in the hall the table. Egg: sink at rank 2, fridge at 3;
    # nothing in the hall, where five of ten are not more than half.
    expected = [(1 / 1 + 2 / 3) / 2, 1.0, (1 / 2 + 2 / 3) / 2]
    assert mean_average_precision(scores, found) == (pytest.approx(np.mean(expected)), 3)
    with_guitar = votes([[6, 0], [5, 10], [9, 6], [7, 5]], ("Cup", "Guitar"))
    assert mean_average_precision(scores, with_guitar) == (pytest.approx(np.mean(expected[:2])), 2)
    with pytest.raises(VotesError, match="no object has a place that more than half"):
        mean_average_precision(scores, votes([[5, 5]] * 4))


def test_votes_as_rows_and_back():
    found = votes([[6, 0], [5, 10], [9, 6], [7, 5]])
    rows = vote_triples(found)
    assert rows.iloc[3].to_dict() == {
        "object": "Egg", "container": "fridge", "room": "kitchen", "positives": 10, "count": 10,
    }  # fmt: skip
    model, _ = fit(rows, rows.head(0), TrainingOptions(kind="frequency", smoothing=1e-9))
    np.testing.assert_allclose(predict_votes(model, found), found.share_right, atol=1e-5)


@pytest.mark.skipif(not HUMAN.is_dir(), reason="the real votes are not here")
def test_half_of_the_real_annotators_score_as_was_found_elsewhere():
    found = read_votes(HUMAN / "housekeep-data.npy")
    test = found.of(read_splits(HUMAN / "housekeep-splits.json")["test"])
    precision, pairs = mean_average_precision((test.ranks[:, :, :5] > 0).mean(axis=2), test)
    assert (round(precision, 3), pairs) == (0.840, 1172)
