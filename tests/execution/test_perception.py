"""Searches that err: posteriors against sums over all worlds, episodes in which objects are missed and imagined."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from mrtask.execution.belief import GIVEN_UP_ODDS, Belief, prior_belief
from mrtask.execution.episode import run_episode
from mrtask.execution.perception import Perception, Rates
from mrtask.execution.sensor import Sensor
from mrtask.execution.team_spec import RobotSpec, Team
from mrtask.execution.trials import TrialOptions, home_order, sample_trial
from mrtask.maps.home_map import build_map
from mrtask.planning.planners import PLANNERS, make_planner
from tests.execution.trace_check import check_trace

OPTIONS = {"pouct": {"samples": 25}, "known": {"samples": 25}, "pouct_paper": {"samples": 25}}
POOR = Perception(Rates(0.7, 0.1))
HONEST = [name for name in PLANNERS if name != "known"]


def belief_of(prior, *rates):
    prior = np.array(prior, dtype=float)
    names = [f"o{index}" for index in range(prior.shape[1])]
    perception = Perception(by_object={name: Rates(*rate) for name, rate in zip(names, rates, strict=True)})
    return prior_belief(prior, np.ones(len(prior), dtype=bool), Sensor.of(perception, names))


def by_enumeration(prior, rates, evidence):
    """Marginals [C, O] after searches [(container, detections)]: the sum over all 2^(C O) worlds."""
    weight = np.zeros_like(prior)
    total = 0.0
    for bits in product([False, True], repeat=prior.size):
        world = np.array(bits).reshape(prior.shape)
        prob = np.where(world, prior, 1 - prior).prod()
        for container, seen in evidence:
            for obj, (hit, alarm) in enumerate(rates):
                detected = hit if world[container, obj] else alarm
                prob *= detected if seen[obj] else 1 - detected
        total += prob
        weight += prob * world
    return weight / total


@pytest.mark.parametrize("seed", range(20))
def test_the_posterior_is_that_of_all_worlds(seed):
    rng = np.random.default_rng(seed)
    prior = rng.uniform(0.02, 0.98, (3, 2))
    rates = [(hit, hit * rng.uniform(0, 0.9)) for hit in rng.uniform(0.3, 1.0, 2)]
    evidence = [(container, rng.random(2) < 0.4) for container in (0, 1, 0, 1)]
    belief = belief_of(prior, *rates)
    for container, seen in evidence:
        belief.learned(container, seen)
    np.testing.assert_allclose(belief.posterior, by_enumeration(prior, rates, evidence), rtol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_a_confidence_weighs_what_a_detection_and_none_would_say(seed):
    rng = np.random.default_rng(seed)
    prior, confidence = rng.uniform(0.02, 0.98, (1, 2)), rng.random(2)
    rates = [(0.8, 0.1), (1.0, 0.0)]
    belief = belief_of(prior, *rates)
    belief.learned(0, confidence)
    expected = sum(
        np.where(seen, confidence, 1 - confidence).prod() * by_enumeration(prior, rates, [(0, seen)])
        for seen in product([False, True], repeat=2)
    )
    np.testing.assert_allclose(belief.posterior, expected, rtol=1e-10)
    assert belief.posterior[0, 1] == pytest.approx(confidence[1]), "where searches do not err, it is the probability"


def test_robots_that_see_all_know_what_they_saw():
    belief = belief_of([[0.0, 1.0, 0.3, 0.3]], *[(1.0, 0.0)] * 4)
    assert belief.learned(0, np.array([True, False, True, False]))
    assert belief.presence_prob.tolist() == belief.posterior.tolist() == [[1.0, 0.0, 1.0, 0.0]]
    assert not belief.learned(0, np.array([True, False, True, False])), "nothing new"
    belief.look_again(~belief.found(), np.ones(1, dtype=bool))
    assert belief.searched.all(), "what was seen is never looked for again"


def test_a_container_is_opened_again_where_nothing_better_is_left():
    """By hand: after a miss 0.6 is 0.12 / 0.52 = 3/13, after another one 3/53; then 0.2 and 0.1 are better."""
    belief, everywhere = belief_of([[0.6], [0.2], [0.1]], (0.8, 0.0)), np.ones(3, dtype=bool)

    def search(container):
        belief.learned(container, np.array([False]))
        assert belief.searched[container] and belief.presence_prob[container, 0] == 0.0
        belief.look_again(np.array([True]), everywhere)
        return np.flatnonzero(~belief.searched).tolist()

    assert search(0) == [0, 1, 2]
    assert belief.presence_prob[0, 0] == pytest.approx(3 / 13)
    assert search(0) == [1, 2]
    assert belief.posterior[0, 0] == pytest.approx(3 / 53)
    assert search(1) == [2]
    assert search(2) == [0, 1, 2], "nothing else is left"
    belief.learned(1, np.array([True]))
    assert belief.found().all() and belief.presence_prob[1, 0] == 1.0


def test_what_is_not_needed_or_cannot_be_reached_stays_closed():
    belief = belief_of([[0.6, 0.6], [0.6, 0.6]], (0.8, 0.0), (0.8, 0.0))
    for container in (0, 1):
        belief.learned(container, np.array([False, False]))
    belief.look_again(np.array([False, False]), np.ones(2, dtype=bool))
    assert belief.searched.all()
    belief.look_again(np.array([True, False]), np.array([False, True]))
    assert belief.searched.tolist() == [True, False]


def test_after_enough_searches_nothing_is_expected_any_more():
    belief = belief_of([[0.5]], (0.7, 0.0))
    for _ in range(100):
        if belief.searched[0]:
            break
        belief.learned(0, np.array([False]))
        belief.look_again(np.array([True]), np.array([True]))
    searches = int(belief.searches[0])
    assert 0.3**searches <= GIVEN_UP_ODDS < 0.3 ** (searches - 1)
    belief.learned(0, np.array([True]))
    assert belief.presence_prob[0, 0] == 1.0, "but a detection counts even then"


def test_an_object_is_found_where_it_was_detected_and_is_believed_to_be():
    sure = belief_of([[0.95]], (0.5, 0.1))
    sure.learned(0, np.array([False]))
    assert sure.posterior[0, 0] > 0.5 and not sure.found().any(), "nobody can take what nobody has seen"
    unheard_of = belief_of([[1e-9]], (0.7, 0.1))
    for seen in (True, True, False, True, True, True):
        assert not unheard_of.found().any()
        unheard_of.learned(0, np.array([seen]))
    assert unheard_of.found().all(), "enough detections outdo any likelihood"
    doubtful = belief_of([[0.01]], (0.9, 0.1))
    doubtful.learned(0, np.array([True]))
    assert not doubtful.found().any() and doubtful.posterior[0, 0] == pytest.approx(0.009 / 0.108)
    doubtful.learned(0, np.array([True]))
    doubtful.learned(0, np.array([True]))
    assert doubtful.found().all()
    doubtful.ruled_out(0, 0)
    assert not doubtful.found().any() and doubtful.posterior[0, 0] == 0.0


def test_a_find_outlasts_a_second_search_for_something_else():
    belief = belief_of([[0.5, 0.9]], (0.9, 0.05), (0.6, 0.0))
    belief.learned(0, np.array([True, False]))
    assert belief.found().tolist() == [True, False]
    belief.look_again(np.array([False, True]), np.array([True]))
    assert not belief.searched[0] and belief.presence_prob[0, 0] == pytest.approx(18 / 19)
    belief.learned(0, np.array([False, True]))
    assert belief.found().tolist() == [True, True]


@pytest.mark.parametrize("rates", [(0.0, 0.0), (0.5, 0.5), (0.4, 0.5), (1.1, 0.0), (0.9, -0.1)])
def test_rates_that_say_nothing_are_refused(rates):
    with pytest.raises(ValueError, match="a detection says nothing"):
        Rates(*rates)


def test_rates_by_object_are_found_by_any_spelling():
    sensor = Sensor.of(Perception(Rates(0.9, 0.1), {"RemoteControl": Rates(0.6, 0.2)}), ["Mug", "remote control"])
    assert sensor.true_positive_prob.tolist() == [0.9, 0.6]
    assert sensor.false_positive_prob.tolist() == [0.1, 0.2]


@pytest.fixture(scope="module")
def trials(generated_homes):
    maps = {home.id: build_map(home) for home in generated_homes}
    result = []
    for number in range(6):
        size_class, robots = ("small", "medium")[number % 2], 1 + number % 3
        order = home_order(generated_homes, size_class, robots, 0)
        spec = RobotSpec(1.0, 2.0 * (number % 2), 3.0 * (number // 3), POOR)
        trial = sample_trial(
            size_class, robots, number, order, lambda home: maps[home.id], seed=0, options=TrialOptions(robot=spec)
        )
        home = next(home for home in generated_homes if home.id == trial.home_id)
        likelihood = np.random.default_rng(number).beta(0.3, 2.0, (len(home.containers), len(trial.objects)))
        result.append((trial, home, maps[home.id], likelihood))
    return result


@pytest.mark.parametrize("planner", PLANNERS)
def test_tasks_are_done_although_objects_are_missed_and_imagined(trials, planner):
    again = in_vain = 0
    for trial, home, home_map, likelihood in trials:
        result = run_episode(trial, home, home_map, likelihood, make_planner(planner, OPTIONS.get(planner)))
        assert result.status == "accepted", result.error
        check_trace(trial, home, home_map, result, known=planner == "known")
        legs = [leg for legs in result.trace.robots for leg in legs]
        searched = [leg.container for leg in legs if leg.kind == "search"]
        contents = {container.id: container.objects for container in home.containers}
        again += len(searched) - len(set(searched))
        in_vain += sum(leg.kind == "interact" and leg.object not in contents[leg.container] for leg in legs)
    assert (again > 0, in_vain > 0) == (planner != "known",) * 2


@pytest.mark.parametrize("planner", HONEST)
def test_an_object_that_is_nowhere_is_given_up(trials, planner):
    trial, home, home_map, likelihood = trials[0]
    spec = replace(trial.team.members[0], perception=Perception(Rates(0.95, 0.0)))
    nowhere = replace(trial, template="formula", formula="F Unicorn", objects=("Unicorn",), team=Team.alike(2, spec))
    result = run_episode(nowhere, home, home_map, likelihood[:, :1], make_planner(planner, OPTIONS.get(planner)))
    assert result.status == "failed" and "found in no container that can be reached: Unicorn" in str(result.error)
    searches = [leg.container for legs in result.trace.robots for leg in legs if leg.kind == "search"]
    assert {searches.count(container.id) for container in home.containers} == {5}, "0.05^5 < 1e-6"


def test_all_planners_get_the_same_detections(trials):
    """The first search of a container shows the same, whoever makes it."""
    trial, home, home_map, likelihood = trials[3]
    first = {}
    for planner in HONEST:
        learned = []
        original = Belief.learned

        def watched(self, container, seen, fresh=None, learned=learned, original=original):
            if self.searches[container] == 0:
                learned.append((container, tuple(seen.tolist())))
            return original(self, container, seen, fresh)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Belief, "learned", watched)
            run_episode(trial, home, home_map, likelihood, make_planner(planner, OPTIONS.get(planner)))
        for container, seen in learned:
            assert first.setdefault(container, seen) == seen
    truth = {index: tuple(name in one.objects for name in trial.objects) for index, one in enumerate(home.containers)}
    assert any(seen != truth[container] for container, seen in first.items())
