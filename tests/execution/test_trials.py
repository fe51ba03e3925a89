import pytest

from mrtask.execution.trials import TrialOptions, home_order, sample_trial
from mrtask.maps.home_map import build_map


@pytest.fixture(scope="module")
def maps(generated_homes):
    return {home.id: build_map(home) for home in generated_homes}


def test_a_trial_depends_on_its_key_alone(generated_homes, maps):
    forwards = home_order(generated_homes, "medium", 2, seed=1)
    backwards = home_order(generated_homes[::-1], "medium", 2, seed=1)
    trials = [
        sample_trial("medium", 2, 7, order, lambda home: maps[home.id], seed=1) for order in (forwards, backwards)
    ]
    assert trials[0] == trials[1]
    assert trials[0].trial_id == "medium-2-007"
    other = sample_trial("medium", 2, 8, forwards, lambda home: maps[home.id], seed=1)
    assert other.seed != trials[0].seed


def test_objects_are_distinct_and_reachable(generated_homes, maps):
    order = home_order(generated_homes, "large", 3, seed=0)
    for number in range(30):
        trial = sample_trial("large", 3, number, order, lambda home: maps[home.id], seed=0)
        home = next(home for home in generated_homes if home.id == trial.home_id)
        held = {name for container in home.containers for name in container.objects}
        assert set(trial.objects) <= held
        assert len(set(trial.objects)) == len(trial.objects)
        assert maps[home.id].free[trial.start_cell]


def test_a_cell_takes_all_homes_of_its_class_before_one_twice(generated_homes, maps):
    order = home_order(generated_homes, "small", 1, seed=0)
    and2 = TrialOptions(("and2",))
    taken = [
        sample_trial(
            "small",
            1,
            number,
            order,
            lambda home: maps[home.id],
            seed=0,
            options=and2,
        ).home_id
        for number in range(len(order))
    ]
    assert sorted(taken) == sorted(home.id for home in order)


def test_homes_without_enough_objects_are_refused_with_the_remedy(two_room_home, two_room_map):
    or_seq = TrialOptions(("or_seq",))
    with pytest.raises(ValueError, match=r"no small home has enough distinct .* give other evaluation homes"):
        sample_trial("small", 1, 0, [two_room_home], lambda home: two_room_map, seed=0, options=or_seq)
