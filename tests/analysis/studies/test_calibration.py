"""Whether beliefs are judged by what they say."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.studies.calibration import (
    ALL_OBJECTS,
    EXISTING,
    Task,
    beliefs_of,
    calibration,
    change,
    reliability_in_homes,
    searched_in,
)
from mrtask.execution.trace import Leg, Trace
from mrtask.likelihood.adapt import AdaptOptions, Sighting, adapted
from mrtask.likelihood.existence import given_existence
from mrtask.likelihood.table import LikelihoodTable


def test_each_task_begins_with_what_the_searches_before_it_showed(two_room_home):
    ids = [container.id for container in two_room_home.containers]
    tasks = [Task("t-0", ("Egg",), frozenset(ids[1:])), Task("t-1", ("Egg", "Book"), frozenset())]
    kinds = two_room_home.container_kinds()

    def believe(task, number, seen):
        prior = np.full((3, len({*task.objects, *(one.object for one in seen)})), 0.25)
        return adapted(prior, task.objects, kinds, seen, number, AdaptOptions())[:, : len(task.objects)]

    found = beliefs_of(two_room_home, tasks, believe)
    first, second = found[found["task"] == 0], found[found["task"] == 1]
    np.testing.assert_allclose(first["prob"], 0.25 / (1 - 0.75**3))
    assert first["held"].tolist() == [True, False, False], "the egg is in the fridge"
    assert second["held"].tolist() == [True, False, False, False, False, True], "the book lies on the bed"
    seen = [Sighting(0, number, "Egg", False) for number in (1, 2)]
    expected = adapted(np.full((3, 2), 0.25), ("Egg", "Book"), two_room_home.container_kinds(), seen, 1, AdaptOptions())
    np.testing.assert_allclose(second["prob"], given_existence(expected).ravel())
    assert second["seen"].tolist() == [False, False, True, False, True, False], "the egg, on table and bed"
    plain = beliefs_of(two_room_home, tasks, lambda task, number, seen: np.full((3, len(task.objects)), 0.25))
    np.testing.assert_allclose(plain["prob"], 0.25 / (1 - 0.75**3))


def test_searches_are_read_from_a_trace():
    legs = [Leg(kind, 0, 1, place, None, ()) for kind, place in (("move", "a"), ("search", "a"), ("wait", "b"))]
    other = [Leg("search", 0, 1, "c", None, ())]
    assert searched_in(Trace((0, 0), (tuple(legs), tuple(other)), ())) == {"a", "c"}


def pairs(prob, held, trials):
    return pd.DataFrame({"trial_id": trials, "task": 0, "pair": range(len(prob)), "prob": prob, "held": held})


def test_losses_and_the_calibration_error_by_hand():
    prob, held = np.array([0.5, 0.1, 0.9, 0.2]), np.array([True, False, True, False])
    found = calibration(pairs(prob, held, ["a", "a", "b", "b"]), {"a": "1", "b": "2"})
    assert found.losses["log_loss"].value == pytest.approx(-np.log([0.5, 0.9, 0.9, 0.8]).mean())
    assert found.losses["brier"].value == pytest.approx((0.25 + 0.01 + 0.01 + 0.04) / 4)
    # Each pair is a bin of its own.
    assert found.ece == pytest.approx((0.5 + 0.1 + 0.1 + 0.2) / 4)
    assert list(found.curve["mean_prob"]) == [0.1, 0.2, 0.5, 0.9]
    assert not found.losses["brier"].has_interval, "two homes are too few"


def test_a_change_is_below_zero_where_the_belief_got_better_and_its_interval_is_over_homes():
    rng = np.random.default_rng(0)
    trials = [f"t{home}-{number}" for home in range(20) for number in range(10)]
    home_of = {trial: trial.partition("-")[0] for trial in trials}
    of_home = np.repeat(rng.random(20) < 0.5, 10)
    before, after = pairs(np.full(200, 0.5), of_home, trials), pairs(np.where(of_home, 0.7, 0.4), of_home, trials)
    found = change(after, before, "log_loss", home_of)
    assert found.value == pytest.approx(np.mean(np.where(of_home, -np.log(0.7), -np.log(0.6)) - np.log(2)))
    assert found.high < 0
    alone = change(after, before, "log_loss", {trial: trial for trial in trials})
    wider = (found.high - found.low) / (alone.high - alone.low)
    assert wider == pytest.approx(np.sqrt(10), rel=0.25), "the ten of a home are all alike: they count as one"


def test_reliability_in_homes_by_hand(two_room_home):
    """Egg in the fridge, book and pillow on the bed; the model gives 0.35 to all of that, and 0.05 to the rest."""
    kinds = tuple(sorted(set(two_room_home.container_kinds())))
    probs = np.full((3, 4), 0.05)
    table = LikelihoodTable(kinds, ("Book", "Egg", "Pillow", "Unicorn"), probs)
    for container, kind in zip(two_room_home.containers, two_room_home.container_kinds(), strict=True):
        for name in container.objects:
            probs[kinds.index(kind), table.objects.index(name)] = 0.35
    found = reliability_in_homes([two_room_home] * 2, table)
    plain = found[found["belief"] == ALL_OBJECTS]
    assert plain["mean_prob"].tolist() == pytest.approx([0.05, 0.35])
    assert plain["frequency"].tolist() == [0.0, 1.0] and plain["pairs"].tolist() == [18, 6]
    there = found[found["belief"] == EXISTING]
    some = 1 - 0.65 * 0.95**2
    assert there["mean_prob"].tolist() == pytest.approx([0.05 / some, 0.35 / some])
    assert there["pairs"].tolist() == [12, 6], "the unicorn is in no home"
    assert found["low"].isna().all(), "two homes have no interval"


def test_intervals_of_reliability_are_over_homes(two_room_home):
    kinds = tuple(sorted(set(two_room_home.container_kinds())))
    rng = np.random.default_rng(0)
    homes = []
    for _ in range(40):
        held = rng.random(3) < 0.5  # all three containers of a home are alike
        objects = ("Egg",) if held[0] else ()
        homes.append(
            replace(two_room_home, containers=tuple(replace(c, objects=objects) for c in two_room_home.containers))
        )
    found = reliability_in_homes(homes, LikelihoodTable(kinds, ("Egg",), np.full((3, 1), 0.45)))
    one = found[found["belief"] == ALL_OBJECTS].iloc[0]
    half = 1.96 * np.sqrt(one["frequency"] * (1 - one["frequency"]) / 40)
    assert (one["high"] - one["low"]) / 2 == pytest.approx(half, rel=0.15)
