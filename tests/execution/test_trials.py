from dataclasses import replace

import numpy as np
import pytest

from mrtask.execution.experiment import run_experiment
from mrtask.execution.trials import TrialOptions, home_order, known_containers, objects_in, sample_trial
from mrtask.likelihood.function import FunctionModel
from mrtask.maps.home_map import build_map
from mrtask.tasks.formula import FormulaError


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


def test_a_formulas_trials_are_in_homes_that_can_serve_it(generated_homes, maps):
    order = home_order(generated_homes, "small", 1, seed=0)
    first, *others = (objects_in([home]) for home in order)
    rare = sorted(first - set.union(*others))[0]
    common = sorted(first & set.intersection(*others))[0]

    def trial(formula, number):
        options = TrialOptions(formula=formula, formula_objects=(rare, common))
        return sample_trial("small", 1, number, order, lambda home: maps[home.id], seed=0, options=options)

    assert {trial(f"F {rare} & F {common}", number).home_id for number in range(3)} == {order[0].id}
    anywhere = [trial(f"F {common} & (F {rare} | F {common})", number) for number in range(3)]
    assert [one.home_id for one in anywhere] == [home.id for home in order]
    # A trial in a home that can serve does not depend on whether others are passed over.
    assert replace(trial(f"F {rare} & F {common}", 0), formula="") == replace(anywhere[0], formula="")
    with pytest.raises(ValueError, match=r"no small home has enough .* for F Unicorn; give other"):
        options = TrialOptions(formula="F Unicorn", formula_objects=("Unicorn",))
        sample_trial("small", 1, 0, order, lambda home: maps[home.id], seed=0, options=options)


@pytest.mark.parametrize(
    ("formula", "said"),
    [("F Pillo", "unknown object 'Pillo', did you mean 'Pillow'"), ("F (Egg & Pillow)", "no order"), ("true", "done")],
)
def test_an_experiment_refuses_a_formula_that_is_no_task_here(two_room_home, formula, said):
    model = FunctionModel(lambda names: np.full(len(names), 0.1))
    with pytest.raises(FormulaError, match=said):
        run_experiment([two_room_home], ["greedy"], model, options=TrialOptions(formula=formula))


def test_part_of_the_containers_is_known_but_never_one_with_the_tasks_objects(generated_homes, maps):
    order = home_order(generated_homes, "large", 2, seed=0)
    shares, by_id = [], {home.id: home for home in generated_homes}
    for number in range(40):
        args = ("large", 2, number, order, lambda home: maps[home.id])
        trial = sample_trial(*args, seed=0, options=TrialOptions(unsearched_share=(0.5, 1.0)))
        assert replace(trial, known=()) == sample_trial(*args, seed=0)  # nothing else is drawn anew
        containers = by_id[trial.home_id].containers
        for index in trial.known:
            assert not set(containers[index].objects) & set(trial.objects)
        shares.append(1 - len(trial.known) / len(containers))
        assert trial == sample_trial(*args, seed=0, options=TrialOptions(unsearched_share=(0.5, 1.0)))
    assert 0.5 - 0.02 <= min(shares) < 0.6 and 0.9 < max(shares) <= 1.0
    assert np.mean(shares) == pytest.approx(0.75, abs=0.1)


def test_what_holds_the_tasks_objects_stays_unsearched_even_beyond_the_share(two_room_home):
    rng = np.random.default_rng(0)
    assert known_containers(two_room_home, ("Egg", "Pillow"), (0.0, 0.0), rng) == (1,)
    assert known_containers(two_room_home, ("Egg", "Pillow"), (1.0, 1.0), rng) == ()


def test_in_file_order_all_team_sizes_take_the_same_homes(generated_homes):
    orders = [home_order(generated_homes, "small", robots, 0, "file") for robots in (1, 2, 3)]
    assert orders[0] == orders[1] == orders[2] == [home for home in generated_homes if home.size_class == "small"]
