"""The check of traces catches a deliberate cheat of every kind that we could think of.

The honest episode is one in which a robot waits for the other before it goes on, and the other waits at the end. Each
cheat changes as little else as it can, so that the check has nothing but the cheat to go by.
"""

from dataclasses import replace
from itertools import pairwise
from math import dist

import numpy as np
import pytest

from mrtask.execution.episode import run_episode
from mrtask.execution.team_spec import RobotSpec, Team
from mrtask.execution.trials import TrialOptions, home_order, sample_trial
from mrtask.maps.home_map import build_map
from mrtask.planning.planners import make_planner
from tests.execution.trace_check import check_trace

SPEC = RobotSpec(speed_m_per_s=0.7, search_time_s=1.5, interact_time_s=2.5)
FIRST, SECOND = 0, 1
"""The robot that waits, drives and interacts last, and the one that has done all else and waits at the end."""


@pytest.fixture(scope="module")
def honest(generated_homes):
    homes = {home.id: home for home in generated_homes}
    order = home_order(generated_homes, "medium", 2, 0)
    options = TrialOptions(templates=("seq3",), robot=SPEC)
    trial = sample_trial("medium", 2, 1, order, lambda home: build_map(home), seed=0, options=options)
    home = homes[trial.home_id]
    likelihood = np.random.default_rng(1).beta(0.3, 2.0, (len(home.containers), len(trial.objects)))
    home_map = build_map(home)
    result = run_episode(trial, home, home_map, likelihood, make_planner("learned_myopic"))
    first, second = result.trace.robots
    assert [leg.kind for leg in first[-3:]] == ["wait", "move", "interact"]
    assert [leg.kind for leg in second[-2:]] == ["interact", "wait"]
    assert [letter.robot for letter in result.trace.letters] == [SECOND, SECOND, FIRST]
    return trial, home, home_map, result


def with_trace(result, **changes):
    return replace(result, trace=replace(result.trace, **changes))


def with_legs(result, robot, legs):
    """The result with other legs of one robot."""
    robots = list(result.trace.robots)
    robots[robot] = tuple(legs)
    return with_trace(result, robots=tuple(robots))


def with_leg(result, robot, place, *new):
    """The result with other legs in place of one."""
    legs = list(result.trace.robots[robot])
    legs[place : place + 1 or None] = new
    return with_legs(result, robot, legs)


def first_leg(result, kind):
    """The number and the leg of the first robot's first act of this kind."""
    return next((place, leg) for place, leg in enumerate(result.trace.robots[FIRST]) if leg.kind == kind)


def changed(kind, change):
    """The cheat that changes the first robot's first leg of this kind."""

    def cheat(trial, home, result):
        place, leg = first_leg(result, kind)
        return trial, with_leg(result, FIRST, place, *change(home, leg))

    return cheat


def last_drive(path_of, slower=1.0):
    """The cheat that has the first robot drive another way to its last container, and wait the less for that."""

    def cheat(trial, home, result):
        *legs, wait, drive, act = result.trace.robots[FIRST]
        path = path_of(drive.path)
        length_m = sum(dist(*ends) for ends in pairwise(path))
        leaves_s = drive.t1_s - slower * length_m / SPEC.speed_m_per_s
        assert wait.t0_s < leaves_s
        legs += [replace(wait, t1_s=leaves_s), replace(drive, t0_s=leaves_s, path=path), act]
        return trial, with_legs(result, FIRST, legs)

    return cheat


def at_speed(factor):
    def cheat(trial, home, result):
        return replace(trial, team=Team.alike(2, replace(SPEC, speed_m_per_s=factor * SPEC.speed_m_per_s))), result

    return cheat


def as_if(**abilities):
    """The cheat of the first robot, which does what a robot like this cannot."""

    def cheat(trial, home, result):
        members = list(trial.team.members)
        members[FIRST] = replace(members[FIRST], **abilities)
        return replace(trial, team=Team(tuple(members), "unlike")), result

    return cheat


def result_with(**changes):
    return lambda trial, home, result: (trial, replace(result, **changes))


def back_and_forth(path):
    """The way with its first metres driven three times."""
    aside = tuple(0.9 * a + 0.1 * b for a, b in zip(*path[:2], strict=True))
    return (path[0], aside, *path)


def elsewhere(home, leg):
    return next(container.id for container in home.containers if container.id != leg.container)


def shortened(home, leg):
    """Half of the act, and a wait for the rest."""
    middle_s = (leg.t0_s + leg.t1_s) / 2
    return replace(leg, t1_s=middle_s), replace(leg, kind="wait", object=None, t0_s=middle_s)


def interact_in_passing(trial, home, result):
    act = result.trace.robots[FIRST][-1]
    wait, rest = replace(act, kind="wait", object=None, t1_s=act.t1_s - 1.0), replace(act, t0_s=act.t1_s - 1.0)
    return trial, with_leg(result, FIRST, -1, wait, rest)


def spell_without_acting(trial, home, result):
    act = result.trace.robots[FIRST][-1]
    return trial, with_leg(result, FIRST, -1, replace(act, kind="wait", object=None))


def search_nothing(trial, home, result):
    robots = [
        [replace(leg, kind="wait") if leg.kind == "search" else leg for leg in legs] for legs in result.trace.robots
    ]
    return trial, with_trace(result, robots=tuple(map(tuple, robots)))


def take_what_is_elsewhere(trial, home, result):
    """The last interaction and its letter are at a container that does not hold the object."""
    *letters, last = result.trace.letters
    empty = next(container.id for container in home.containers if last.object not in container.objects)
    return trial, with_trace(result, letters=(*letters, replace(last, container=empty)))


def reverse_the_word(trial, home, result):
    return trial, with_trace(result, letters=result.trace.letters[::-1])


def stop_before_the_end(trial, home, result):
    return trial, with_trace(result, letters=result.trace.letters[:-1])


def go_on_after_the_end(trial, home, result):
    return replace(trial, template="seq2", objects=trial.objects[:2]), result


def start_nearer(trial, home, result):
    x, y = result.trace.start
    return trial, with_trace(result, start=(x + 0.05, y))


CHEATS = {
    "all drive faster than their speed": ("faster than the robot", at_speed(0.99)),
    "all drive slower than their speed": ("slower than the robot", at_speed(1.01)),
    "one drive is slow": ("slower than the robot", last_drive(lambda path: path, slower=1.1)),
    "a detour": ("not the shortest way", last_drive(back_and_forth)),
    "through the furniture": ("off the free cells", last_drive(lambda path: (path[0], path[-1]))),
    "a jump": ("position not continuous", changed("move", lambda home, leg: [replace(leg, path=leg.path[-1:])])),
    "a drive while waiting": (
        "only moves have a way",
        changed("wait", lambda home, leg: [replace(leg, path=leg.path * 2)]),
    ),
    "a wait left out on the way": ("time not continuous", changed("wait", lambda home, leg: [])),
    "the last wait left out": (
        "the legs end before the episode",
        lambda trial, home, result: (trial, with_leg(result, SECOND, -1)),
    ),
    "a search from afar": (
        "not at the container",
        changed("search", lambda home, leg: [replace(leg, container=elsewhere(home, leg))]),
    ),
    "a hasty search": ("a search of another length", changed("search", shortened)),
    "a hasty interaction": ("an interaction of another length", interact_in_passing),
    "a letter without an interaction": ("no interaction leg", spell_without_acting),
    "an object that is not there": ("the object is not there", take_what_is_elsewhere),
    "a find without a search": ("before the container was searched", search_nothing),
    "letters in another order": ("letters out of order", reverse_the_word),
    "a task left undone": ("the task is not done", stop_before_the_end),
    "a task overdone": ("the task was done before", go_on_after_the_end),
    "a task done but called failed": ("the task is done", result_with(status="failed", cost_s=None, error="lost")),
    "a lower cost": ("another cost", lambda trial, home, result: (trial, replace(result, cost_s=0.99 * result.cost_s))),
    "a robot that vanished": (
        "a robot is missing",
        lambda trial, home, result: (trial, with_trace(result, robots=result.trace.robots[:1])),
    ),
    "another start": ("another start", start_nearer),
    "one touches what it does not handle": ("touches what it does not handle", as_if(handles=("Nothing",))),
    "one opens what it cannot": ("opens what it cannot", as_if(opens=("Nothing",))),
    "one drives where it does not fit": ("off the free cells", as_if(radius_m=0.3)),
    "one drives at another's speed": ("slower than the robot", as_if(speed_m_per_s=1.4)),
    "one searches in another's time": ("a search of another length", as_if(search_time_s=0.5)),
    "one starts elsewhere": ("another start", as_if(start_m=(1.0, 1.0))),
}
"""Kind of cheat -> what the check says, and how to cheat."""


@pytest.mark.parametrize("kind", CHEATS)
def test_a_cheat_is_caught(honest, kind):
    trial, home, home_map, result = honest
    said, cheat = CHEATS[kind]
    trial, result = cheat(trial, home, result)
    with pytest.raises(AssertionError, match=said):
        check_trace(trial, home, home_map, result)


def test_an_honest_episode_passes(honest):
    check_trace(*honest)
