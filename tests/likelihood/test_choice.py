import numpy as np
import pandas as pd
import pytest
from scipy.special import logit

from mrtask.homes.catalogue import load_catalogue
from mrtask.homes.contents import draw_objects, object_probs
from mrtask.likelihood.choice import chosen_likelihood
from mrtask.likelihood.options import LikelihoodChoice
from mrtask.likelihood.rows import TRIPLE, distinct_triples, label_rows, vocabulary
from mrtask.likelihood.truth import catalogue_truth, counted_truth

LIKELIHOOD = np.array([[0.1, 0.5], [0.3, 0.5], [0.8, 0.05]])
KINDS = [("Bed", "Bedroom"), ("Sofa", "LivingRoom"), ("Bed", "Bedroom")]


def test_likelihoods_go_from_what_they_are_to_knowing_nothing_of_where():
    np.testing.assert_array_equal(chosen_likelihood(LIKELIHOOD, KINDS, LikelihoodChoice(), 1), LIKELIHOOD)
    whole = chosen_likelihood(LIKELIHOOD, KINDS, LikelihoodChoice(uniform_mix=1.0), 1)
    np.testing.assert_allclose(whole, [[0.4, 0.35]] * 3)
    half = chosen_likelihood(LIKELIHOOD, KINDS, LikelihoodChoice(uniform_mix=0.5), 1)
    np.testing.assert_allclose(half, (LIKELIHOOD + whole) / 2)


def test_noise_is_one_error_in_log_odds_for_each_object_and_kind():
    options = LikelihoodChoice(noise_sd=2.0)
    errors = np.array(
        [logit(chosen_likelihood(LIKELIHOOD, KINDS, options, seed)) - logit(LIKELIHOOD) for seed in range(2000)]
    )
    np.testing.assert_allclose(errors[:, 0], errors[:, 2], atol=1e-9)
    independent = errors[:, :2].reshape(len(errors), -1)
    np.testing.assert_allclose(np.cov(independent.T), 4 * np.eye(4), atol=0.5)
    np.testing.assert_allclose(independent.mean(axis=0), 0, atol=0.2)
    first = chosen_likelihood(LIKELIHOOD[:, :1], KINDS, options, 7)
    np.testing.assert_array_equal(first, chosen_likelihood(LIKELIHOOD, KINDS, options, 7)[:, :1])


@pytest.mark.parametrize("options", [{"source": "oracle"}, {"uniform_mix": 1.1}, {"noise_sd": -1.0}])
def test_options_that_make_no_sense_are_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        LikelihoodChoice(**options)


def test_the_generators_likelihoods_are_how_often_it_draws_each_object():
    catalogue, rng, draws = load_catalogue(), np.random.default_rng(0), 4000
    for room, container in (("Kitchen", "Fridge"), ("Bedroom", "Dresser")):
        probs = object_probs(catalogue, room, container)
        drawn = pd.Series([name for _ in range(draws) for name in draw_objects(catalogue, room, container, rng)])
        shares = drawn.value_counts().reindex(list(probs), fill_value=0) / draws
        error = shares - pd.Series(probs)
        assert (error.abs() < 4.5 * np.sqrt(pd.Series(probs) * (1 - pd.Series(probs)) / draws) + 1e-3).all()
        facts = catalogue.objects[room][container]
        counts = np.minimum(np.arange(len(facts["distinct_objects"])), len(probs))
        mean = np.average(counts, weights=facts["distinct_objects"])
        assert sum(probs.values()) == pytest.approx(mean, rel=1e-9), "all that are drawn are drawn"


def test_what_the_catalogue_does_not_know_lies_nowhere():
    names = pd.DataFrame([("Mug", "Throne", "Kitchen"), ("Unicorn", "Fridge", "Kitchen")], columns=TRIPLE, dtype="str")
    assert (catalogue_truth().predict(names) < 1e-5).all()
    assert object_probs(load_catalogue(), "Kitchen", "Throne") == {}


def test_counts_of_homes_are_those_of_their_labelled_rows(generated_homes):
    homes = generated_homes[:4]
    rows = pd.concat([label_rows(home, vocabulary(homes)) for home in homes], ignore_index=True)
    expected = distinct_triples(rows)
    counted = counted_truth(homes).triples.sort_values(TRIPLE, ignore_index=True)
    pd.testing.assert_frame_equal(counted, expected, check_dtype=False)
