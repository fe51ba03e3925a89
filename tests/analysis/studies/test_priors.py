"""Priors compared on the same trials: by hand, and on a page."""

import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.results.statistics import EVERYTHING
from mrtask.analysis.studies.prior_page import render_priors
from mrtask.analysis.studies.prior_study import TRUTH, ArmRows, PriorStudy

TASKS, HOMES = 4, 12
FACTORS = {(TRUTH, False): 1.0, ("procthor", False): 1.5, ("procthor", True): 1.2}


def episodes(factor, cells=(("small", 1), ("large", 2)), homes=HOMES):
    rng = np.random.default_rng(0)
    rows = []
    for size_class, robots in cells:
        for number in range(homes * TASKS):
            base_s = rng.uniform(50, 150)
            for planner, worse in (("learned_myopic", 1.25), ("pouct", 1.0)):
                cost_s = base_s * (factor if number % TASKS else FACTORS["procthor", False]) * worse
                rows.append(
                    {
                        "trial_id": f"{size_class}-{robots}-{number:03d}",
                        "size_class": size_class,
                        "robots": robots,
                        "planner": planner,
                        "status": "accepted",
                        "cost_s": cost_s,
                        "cost_cells": 20 * cost_s,
                        "objects": ("Mug", "Book") if number % 2 else (f"Thing{number % TASKS}",),
                    }
                )
    return pd.DataFrame(rows)


def beliefs(prob):
    trials = [f"{cell}-{number:03d}" for cell in ("small-1", "large-2") for number in range(HOMES * TASKS)]
    frame = pd.DataFrame({"trial_id": np.repeat(trials, 2), "pair": np.tile([0, 1], len(trials))})
    number = frame["trial_id"].str[-3:].astype(int) % TASKS
    return frame.assign(
        task=number, held=frame["pair"] == 0, seen=False, prob=np.where(frame["pair"] == 0, prob, 1 - prob)
    )


@pytest.fixture(scope="module")
def arms():
    return [
        ArmRows("housekeep", prior, adapts, episodes(factor), beliefs(1 / (1 + factor)), (f"belief.adapt={adapts}",))
        for (prior, adapts), factor in FACTORS.items()
    ]


@pytest.fixture(scope="module")
def study(arms):
    return PriorStudy.of(arms, TASKS)


def test_what_a_prior_costs_and_what_adapting_wins_back(study, arms):
    true, wrong, adapting = arms
    costs = [study.costs(arm) for arm in arms]
    later = study.of_task(costs[0].index, [1, 2, 3])
    assert study.above(costs[1], costs[0], later).value == pytest.approx(50)
    assert study.saved(costs[2], costs[1], later).value == pytest.approx(100 * (1 - 1.2 / 1.5))
    first = study.of_task(costs[0].index, [0])
    assert study.saved(costs[2], costs[1], first).value == pytest.approx(0)
    assert study.won_back(adapting, wrong, EVERYTHING).value == pytest.approx(60)
    assert study.won_back(adapting, wrong, ("small", 1)).value == pytest.approx(60)
    assert list(study.pairs("housekeep")) == [(adapting, wrong)]
    assert study.find("procthor", TRUTH) is None and study.find("housekeep", TRUTH) is true
    assert study.cells == [("small", 1), ("large", 2), EVERYTHING]
    assert study.planner == "pouct"


def test_without_the_true_prior_that_of_the_same_contents_is_the_measure(arms):
    own = ArmRows("housekeep", "housekeep", False, arms[0].episodes, arms[0].beliefs)
    study = PriorStudy.of([arms[1], own], TASKS)
    assert study.best("housekeep") is own and study.best("procthor") is None
    assert study.won_back(arms[2], arms[1], EVERYTHING).value == pytest.approx(60)


def test_intervals_are_over_homes(study):
    costs = study.costs(study.arms[0])
    rng = np.random.default_rng(1)
    homes = pd.Series({home: rng.uniform(0.5, 1.0) for home in set(study.home_of.values())})
    better = costs * [homes[study.home_of[trial]] for trial in costs.index]
    found = study.saved(better, costs)
    assert found.n == 2 * HOMES
    alone = PriorStudy.of(study.arms, 1).saved(better, costs)
    assert found.value == pytest.approx(alone.value)
    assert found.high - found.low > 1.5 * (alone.high - alone.low)


def test_objects_are_new_until_somebody_was_sent_for_them_in_that_home(study):
    new = study.new_objects(study.arms[0])
    # Thing0, then Mug and Book, then Thing2, then Mug and Book again; the first is nobody's test.
    assert {trial: flag for trial, flag in new.items() if trial.startswith("small-1-00")} == {
        f"small-1-00{number}": number % TASKS in (1, 2) for number in range(10)
    }


def test_the_page_says_it_all(arms):
    page = render_priors(arms, TASKS, "test")
    text = " ".join(page.split())
    assert "Contents of people: the ProcTHOR prior costs" in text
    assert "Adapting helps in 1 of 1 pairs" in text and "It is clearly worse in 0" in text
    assert "ProcTHOR, adapting" in text and "belief.adapt=True" in text
    for section in ("cost", "margin", "adapting", "tasks", "belief", "arms"):
        assert f'id="{section}"' in text
    margin = text.split('id="margin"')[1].split('id="adapting"')[0]
    assert "<b>20.0 %</b>" in margin, "a quarter worse is 20 % more than the planner"
    tasks = text.split('id="tasks"')[1]
    saved = tasks.split("saved by adapting</span>")[1].split("</tr>")[1]
    assert saved.count("<b>20.0 %</b>") == TASKS - 1 and saved.count("<b>0.0 %</b>") == 1
    once = render_priors([arm for arm in arms if not arm.adapts], 1, "test")
    assert 'id="tasks"' not in once and 'id="adapting"' not in once and "No arm adapts here" in once


def test_malformed_episodes_are_refused(arms):
    broken = ArmRows("housekeep", TRUTH, False, arms[0].episodes.drop(columns="status"), arms[0].beliefs)
    with pytest.raises(ValueError, match="the episodes lack the columns status"):
        render_priors([broken], TASKS, "test")
