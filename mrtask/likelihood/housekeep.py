"""Votes on where things belong (`mrtask.homes.votes`) as labelled rows, and Housekeep's measure of a model on them.

The measure (Kant et al., ECCV 2022): for each object and room, the model ranks the room's receptacles. A receptacle is
right if more than half of the people called it so. The score is the mean, over the pairs of object and room that have a
right receptacle, of the ranking's average precision. Both the published and the recomputed figures leave out one object
of the test split, the guitar.
"""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from sklearn.metrics import average_precision_score

from mrtask.arrays import Floats
from mrtask.homes.votes import Votes, VotesError
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.rows import TRIPLE

LEFT_OUT = frozenset({"Guitar"})
"""The objects of the test split that the published measure does not count."""

PUBLISHED: Mapping[str, float] = {
    "RoBERTa, contrastive": 0.808,
    "GloVe, contrastive": 0.758,
    "masked language model, not trained": 0.425,
}
"""The measure of the paper's own models on its test objects, recomputed from their published scores."""


def vote_triples(votes: Votes) -> pd.DataFrame:
    """Return one row for each object and place: ``object, container, room, positives, count``.

    ``positives`` of ``count`` annotators call the place right.
    """
    rooms, receptacles = zip(*votes.placements, strict=True)
    objects, annotators = len(votes.objects), votes.ranks.shape[2]
    return pd.DataFrame(
        {
            "object": pd.array(list(votes.objects) * len(rooms), dtype="str"),
            "container": pd.array(np.repeat(receptacles, objects), dtype="str"),
            "room": pd.array(np.repeat(rooms, objects), dtype="str"),
            "positives": (votes.ranks > 0).sum(axis=2).ravel(),
            "count": np.full(objects * len(rooms), annotators, dtype=np.int64),
        }
    )


def predict_votes(model: LikelihoodModel, votes: Votes) -> Floats:
    """Return the model's probabilities ``[K, O]`` for all places and objects of the votes."""
    return model.predict(vote_triples(votes)[TRIPLE]).reshape(len(votes.placements), len(votes.objects))


def mean_average_precision(scores: Floats, votes: Votes) -> tuple[float, int]:
    """Return the measure for ``scores [K, O]`` and the number of pairs over which it is the mean.

    A higher score means a better place.

    Raises:
        VotesError: no object has a right place.
    """
    right = 2 * (votes.ranks > 0).sum(axis=2) > votes.ranks.shape[2]
    in_room: dict[str, list[int]] = {}
    for place, (room, _) in enumerate(votes.placements):
        in_room.setdefault(room, []).append(place)
    precisions = [
        average_precision_score(right[places, index], scores[places, index])
        for index, name in enumerate(votes.objects)
        if name not in LEFT_OUT
        for places in in_room.values()
        if right[places, index].any()
    ]
    if not precisions:
        raise VotesError(
            "no object has a place that more than half of the people call right: there is nothing to measure"
        )
    return float(np.mean(precisions)), len(precisions)
