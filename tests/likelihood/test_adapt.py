"""The belief that learns in a home, against a sum over all worlds."""

from itertools import product

import numpy as np
import pytest

from mrtask.likelihood import adapt
from mrtask.likelihood.adapt import AdaptOptions, Sighting, adapted, sightings_of

KINDS = [("Bed", "Bedroom"), ("Bed", "Bedroom"), ("Desk", "Bedroom")]
OBJECTS = ("Mug", "Book")
PRIOR = np.array([[0.1, 0.4], [0.1, 0.4], [0.3, 0.05]])


def brute_force(prior, sightings, tasks, options, nodes, weights):
    """Every habit of a kind and its objects, every history of every cell: what was drawn anew and what it held."""

    number = range(len(nodes))

    def shift(v, w):
        return options.kind_sd * nodes[v] + options.object_sd * nodes[w]

    def offset(p):  # by Newton's method rather than by halving
        b = np.log(p / (1 - p))
        for _ in range(100):
            theta = np.array(
                [[1 / (1 + np.exp(-b - shift(v, w))) for w in range(len(nodes))] for v in range(len(nodes))]
            )
            b -= (weights @ theta @ weights - p) / (weights @ (theta * (1 - theta)) @ weights)
        return b

    def cell(container, index, v, w):
        """The probability of what was seen of a cell, and that of it together with its holding the object at last."""
        theta = 1 / (1 + np.exp(-offset(prior[container, index]) - shift(v, w)))
        seen = {s.task: s.present for s in sightings if (s.container, s.object) == (container, OBJECTS[index])}
        total = held = 0.0
        for anew in product((False, True), repeat=tasks):
            for states in product((False, True), repeat=tasks + 1):
                prob = theta if states[0] else 1 - theta
                for before, after, fresh in zip(states, states[1:], anew, strict=False):
                    prob *= (
                        options.forget * (theta if after else 1 - theta)
                        if fresh
                        else ((1 - options.forget) * (before == after))
                    )
                if all(states[task] == present for task, present in seen.items()):
                    total += prob
                    held += prob * states[-1]
        return total, held

    result = np.empty(prior.shape)
    for kind in set(KINDS):
        members = [c for c, other in enumerate(KINDS) if other == kind]
        cells = {(c, o, v, w): cell(c, o, v, w) for c in members for o in (0, 1) for v in number for w in number}
        for target in product(members, (0, 1)):
            evidence = held = 0.0
            for v, w_mug, w_book in product(number, number, number):
                own = (w_mug, w_book)
                weight = weights[v] * weights[w_mug] * weights[w_book]
                both = weight
                for c, o in product(members, (0, 1)):
                    total, present = cells[c, o, v, own[o]]
                    weight *= total
                    both *= present if (c, o) == target else total
                evidence += weight
                held += both
            result[target] = held / evidence
    return result


SEEN = [
    Sighting(0, 0, "Mug", True),
    Sighting(0, 0, "Book", False),
    Sighting(1, 0, "Mug", False),
    Sighting(1, 1, "Book", True),
    Sighting(2, 0, "Mug", False),
    Sighting(2, 2, "Mug", True),
]


@pytest.mark.parametrize(
    "options", [AdaptOptions(0.7, 1.2, 0.15), AdaptOptions(0.0, 1.0, 0.3), AdaptOptions(1.5, 0, 0.5)]
)
def test_the_posterior_is_the_sum_over_all_worlds(options, monkeypatch):
    monkeypatch.setattr(adapt, "NODES", 3)
    expected = brute_force(PRIOR, SEEN, 3, options, *adapt._standard_normal())
    np.testing.assert_allclose(adapted(PRIOR, OBJECTS, KINDS, SEEN, 3, options), expected, rtol=1e-6)


def test_nothing_seen_leaves_the_model_as_it_is_and_so_does_certainty_about_households():
    np.testing.assert_allclose(adapted(PRIOR, OBJECTS, KINDS, [], 0, AdaptOptions()), PRIOR)
    sure = adapted(PRIOR, OBJECTS, KINDS, SEEN[:2], 1, AdaptOptions(0.0, 0.0, 1.0))
    np.testing.assert_allclose(sure, PRIOR, rtol=1e-6)
    elsewhere = [Sighting(0, 2, "Mug", True)]
    np.testing.assert_allclose(adapted(PRIOR, OBJECTS, KINDS, elsewhere, 1, AdaptOptions())[:2], PRIOR[:2], rtol=1e-6)


def test_what_was_seen_is_remembered_spreads_to_its_kind_and_fades():
    seen = [Sighting(0, 0, "Mug", True)]
    soon, late = (adapted(PRIOR, OBJECTS, KINDS, seen, task, AdaptOptions(forget=0.1)) for task in (1, 200))
    assert soon[0, 0] == pytest.approx(0.9 + 0.1 * soon[1, 0])
    assert soon[1, 0] > PRIOR[1, 0] and soon[1, 1] > PRIOR[1, 1], "the other bed, for the mug and a little for the book"
    assert soon[1, 0] / PRIOR[1, 0] > soon[1, 1] / PRIOR[1, 1]
    np.testing.assert_allclose(late[0], late[1], rtol=1e-6)
    forever = adapted(PRIOR, OBJECTS, KINDS, seen, 1000, AdaptOptions(forget=0.0))
    assert forever[0, 0] == 1 - 1e-6
    not_there = adapted(PRIOR, OBJECTS, KINDS, [Sighting(0, 0, "Mug", False)], 1, AdaptOptions())
    assert not_there[1, 0] < PRIOR[1, 0] and not_there[0, 0] < not_there[1, 0]


def test_habits_are_learnt_in_homes_drawn_from_the_model():
    """The posterior is right on average: where it says 30 %, it is so in 30 % of the homes."""
    rng, options = np.random.default_rng(0), AdaptOptions(1.0, 1.0, 0.0)
    nodes, weights = adapt._standard_normal()
    kinds, prior = [("Bed", "Bedroom")] * 6, np.full((6, 2), 0.3)
    b = adapt._offsets(prior[:1], options.kind_sd * nodes[:, None] + options.object_sd * nodes, weights)[0, 0]
    probs, truth = [], []
    for _ in range(800):
        v, w = nodes[rng.choice(len(nodes), p=weights)], nodes[rng.choice(len(nodes), p=weights, size=2)]
        held = rng.random((6, 2)) < 1 / (1 + np.exp(-b - v - w))
        seen = [Sighting(0, c, OBJECTS[o], bool(held[c, o])) for c in range(5) for o in (0, 1)]
        probs.append(adapted(prior, OBJECTS, kinds, seen, 1, options)[5])
        truth.append(held[5])
    probs, truth = np.ravel(probs), np.ravel(truth)
    for low, high in ((0, 0.15), (0.15, 0.3), (0.3, 0.6), (0.6, 1)):
        inside = (probs >= low) & (probs < high)
        assert inside.sum() > 50
        spread = np.sqrt(probs[inside].mean() * (1 - probs[inside].mean()) / inside.sum())
        assert truth[inside].mean() == pytest.approx(probs[inside].mean(), abs=4 * spread)
    assert probs.var() > 0.02, "something was learnt"


def test_sightings_of_an_episode(two_room_home):
    fridge, _, bed = two_room_home.containers
    objects = [fridge.objects[0], "Unicorn"]
    seen = sightings_of(two_room_home, 4, [True, False, True], objects)
    assert [(sighting.task, sighting.container, sighting.object) for sighting in seen] == [
        (4, 0, objects[0]), (4, 0, "Unicorn"), (4, 2, objects[0]), (4, 2, "Unicorn"),
    ]  # fmt: skip
    assert [sighting.present for sighting in seen] == [True, False, objects[0] in bed.objects, False]


@pytest.mark.parametrize(
    ("sightings", "message"),
    [
        ([Sighting(0, 0, "Cup", True)], "is about none of the objects Mug, Book"),
        ([Sighting(3, 0, "Mug", True)], "about no task before 3"),
        ([Sighting(0, 0, "Mug", True), Sighting(0, 0, "Mug", False)], "contradicts another of the same task"),
    ],
)
def test_sightings_that_cannot_be_are_refused(sightings, message):
    with pytest.raises(ValueError, match=message):
        adapted(PRIOR, OBJECTS, KINDS, sightings, 3, AdaptOptions())


def test_without_forgetting_contents_cannot_change():
    changed = [Sighting(0, 0, "Mug", True), Sighting(1, 0, "Mug", False)]
    with pytest.raises(ValueError, match="container 0 held Mug in task 0 but not in task 1: forget must be above 0"):
        adapted(PRIOR, OBJECTS, KINDS, changed, 2, AdaptOptions(forget=0.0))


def test_options_are_checked():
    with pytest.raises(ValueError, match="0 <= forget <= 1 needed"):
        AdaptOptions(forget=1.5)
