"""The similarity model: what it makes of names it never saw, its limits, and its features against a naive twin."""

import numpy as np
import pandas as pd
import pytest
from scipy.special import logit

from mrtask.likelihood import similarity
from mrtask.likelihood.embeddings import embed_names
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.similarity import train_similarity

COLUMNS = ["object", "container", "room"]
KITCHEN = ["Apple", "Tomato", "Potato", "Lettuce", "Bread", "Egg", "Fork", "Spoon", "Knife", "Plate"]
BEDROOM = ["Pillow", "Blanket", "AlarmClock", "TeddyBear", "Book", "Laptop", "CellPhone", "Pencil"]
KINDS = [("Fridge", "Kitchen"), ("CounterTop", "Kitchen"), ("Bed", "Bedroom"), ("Desk", "Bedroom")]


def world(objects=None, factor=1):
    """Kitchen things lie in the kitchen, bedroom things in the bedroom."""
    rows = [
        (name, container, room, (30 if (name in KITCHEN) == (room == "Kitchen") else 2) * factor, 100 * factor)
        for name in objects or [*KITCHEN, *BEDROOM]
        for container, room in KINDS
    ]
    return pd.DataFrame(rows, columns=[*COLUMNS, "positives", "count"])


@pytest.fixture(scope="module")
def model(embedding_cache):
    return train_similarity(world(), cache_dir=embedding_cache)


def names(*rows):
    return pd.DataFrame(rows, columns=COLUMNS)


def test_unseen_objects_go_where_their_like_is(model):
    kitchen, bedroom = ("CounterTop", "Kitchen"), ("Bed", "Bedroom")
    for name, home, other in [("Carrot", kitchen, bedroom), ("Cup", kitchen, bedroom), ("Duvet", bedroom, kitchen)]:
        there, elsewhere = model.predict(names((name, *home), (name, *other)))
        assert there > 1.5 * elsewhere


def test_unseen_container_and_room_take_after_similar_names(model):
    fridge, wardrobe = model.predict(names(("Egg", "Refrigerator", "Kitchen"), ("Egg", "Mattress", "Bedroom")))
    assert fridge > 1.5 * wardrobe


def test_seen_triples_equal_their_frequency_when_there_is_much_data(embedding_cache):
    many = world(factor=1000)
    probs = train_similarity(many, cache_dir=embedding_cache).predict(many)
    assert probs == pytest.approx((many["positives"] / many["count"]).to_numpy(), rel=1e-2)


def test_better_than_the_frequency_table_on_unseen_and_not_worse_on_seen(embedding_cache):
    truth = world(factor=1000)
    rng = np.random.default_rng(0)
    sample = truth.assign(positives=rng.binomial(5, truth["positives"] / truth["count"]), count=5)
    held = truth["object"].isin(KITCHEN[::3] + BEDROOM[::3])

    def log_loss(probs, frame):
        p = frame["positives"] / frame["count"]
        return -(p * np.log(probs) + (1 - p) * np.log1p(-probs)).mean()

    for train, test in ((sample[~held], truth[held]), (sample, truth)):
        ours = log_loss(train_similarity(train, cache_dir=embedding_cache).predict(test), test)
        assert ours < log_loss(FrequencyModel(train).predict(test), test)


def test_features_equal_a_naive_twin(model, embedding_cache):
    """Of a training object (its own counts left out) and of names never seen."""

    def similar(first, second):
        vectors = embed_names([first, second], cache_dir=embedding_cache).astype(np.float64)
        return float(vectors[0] @ vectors[1])

    triples = list(model.triples.itertuples(index=False))
    overall = model.triples["positives"].sum() / model.triples["count"].sum()

    def twin(name, container, room):
        finds, rows = {}, {}
        for t in triples:
            if t.object != name:
                near = similar(container, t.container) + similar(room, t.room) - 2
                weight = np.exp(near / similarity.KIND_TEMPERATURE)
                finds[t.object] = finds.get(t.object, 0.0) + weight * t.positives
                rows[t.object] = rows.get(t.object, 0.0) + weight * t.count
        base = (sum(finds.values()) + overall) / (sum(rows.values()) + 1)
        like = {other: np.exp((similar(name, other) - 1) / similarity.OBJECT_TEMPERATURE) for other in finds}
        alike = sum(like[o] * (finds[o] + overall) / (rows[o] + 1) for o in finds) / sum(like.values())
        alike = (alike + similarity.BASE_SHARE * base) / (1 + similarity.BASE_SHARE)
        return [logit(base), logit(alike), similar(name, container), similar(name, room)]

    asked = [("apple", "fridge", "kitchen"), ("carrot", "bed", "bedroom"), ("book", "sofa", "living room")]
    found = model._known.features(names(*asked))
    assert found == pytest.approx(np.array([twin(*row) for row in asked]), rel=1e-4)


def test_a_name_may_be_written_in_several_ways(model, embedding_cache):
    ways = [("AlarmClock", "Bed", "Bedroom"), ("alarm clock", "bed", "bedroom"), ("Alarm_Clock", "BED", "Bedroom")]
    assert len(set(model.predict(names(*ways)))) == 1
    both = pd.concat([world(["AlarmClock"]), world(["alarm clock"]), world(["Apple", "Pillow"])])
    merged = train_similarity(both, cache_dir=embedding_cache).triples
    assert merged["object"].nunique() == 3 and merged["count"].max() == 200


def test_names_that_never_lie_anywhere(embedding_cache):
    empty = world().assign(positives=0)
    assert train_similarity(empty, cache_dir=embedding_cache).predict(empty).max() < 0.01


def test_single_training_object_or_kind(embedding_cache):
    for few in (world(["Apple"]), world().query("container == 'Bed'")):
        probs = train_similarity(few, cache_dir=embedding_cache).predict(names(("Pillow", "Bed", "Bedroom")))
        assert 0 < probs[0] < 1
