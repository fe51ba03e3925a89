"""Planners see the belief and nothing else.

While a planner plans in the real episode loop, the truth cannot be read; and from the same history in a second world,
in which every container not searched yet holds exactly what it does not hold in the first, problem and plan are equal.
"""

import gc
import sys
from dataclasses import fields, replace
from types import FunctionType, ModuleType

import numpy as np
import pytest

from mrtask.execution import episode
from mrtask.execution.simulation import Simulation
from mrtask.execution.team_spec import RobotSpec, Team
from mrtask.execution.trials import home_order, sample_trial
from mrtask.homes.home import Container, Home
from mrtask.maps.home_map import build_map
from mrtask.planning.planners import PLANNERS, make_planner

HONEST = [name for name in PLANNERS if name != "known"]
OPTIONS = {"pouct": {"samples": 50}, "pouct_paper": {"samples": 50}}


class GuardedSimulation(Simulation):
    """Its truth can be closed; it remembers how it was made and what it was told."""

    closed = False

    def __init__(self, home, home_map, automaton, likelihood, truth, **options):
        self.made_from, self.options, self.told = (home, home_map, automaton, likelihood), options, []
        super().__init__(home, home_map, automaton, likelihood, truth, **options)

    @property
    def truth(self):
        assert not self.closed, "the truth was read while planning"
        return self._truth

    @truth.setter
    def truth(self, truth):
        self._truth = truth

    def assign(self, assignments):
        self.told.append(dict(assignments))
        super().assign(assignments)

    def elsewhere(self):
        """The same history in the world whose unsearched containers hold the opposite."""
        other = type(self)(*self.made_from, np.where(self.searched[:, None], self.truth, ~self.truth), **self.options)
        for assignments in self.told:
            other.assign(assignments)
            assert other.advance()
        return other


class Watched:
    """A planner whose every plan is checked; ``checked`` counts those for which the second world differed."""

    knows_contents = False

    def __init__(self, planner, simulations):
        self.planner, self.simulations, self.checked = planner, simulations, 0

    def plan(self, problem, seed):
        simulation = self.simulations[-1]
        simulation.closed = True
        try:
            plan = self.planner.plan(problem, seed)
        finally:
            simulation.closed = False
        assert_nothing_leads_to_the_truth(problem, simulation)
        other = simulation.elsewhere()
        rebuilt = other.problem()
        assert_equal_fields(rebuilt, problem)
        for part in ("robots", "kinds"):
            for seen, again in zip(getattr(problem, part), getattr(rebuilt, part), strict=True):
                assert_equal_fields(seen, again)
        again = self.planner.plan(rebuilt, seed)
        assert again.assignments == plan.assignments
        np.testing.assert_equal(again.info.root, plan.info.root)
        self.checked += not np.array_equal(other.truth, simulation.truth)
        return plan


def assert_equal_fields(one, other):
    for item in fields(one):
        if item.name not in ("robots", "kinds"):
            np.testing.assert_equal(getattr(one, item.name), getattr(other, item.name))


def assert_nothing_leads_to_the_truth(problem, simulation):
    """No chain of references from the problem ends at the world."""
    seen, stack = set(), [problem]
    while stack:
        item = stack.pop()
        if id(item) in seen or isinstance(item, (type, ModuleType, FunctionType)):
            continue
        seen.add(id(item))
        assert not isinstance(item, (Simulation, Home, Container)), f"the problem leads to a {type(item).__name__}"
        assert item is not simulation.truth, "the problem leads to the truth"
        if isinstance(item, np.ndarray):
            assert not np.shares_memory(item, simulation.truth), "the problem shares the truth's memory"
        stack += gc.get_referents(item)


def run_watched(monkeypatch, trial, home, home_map, likelihood, planner, simulation=GuardedSimulation):
    simulations = []

    def make_simulation(*arguments, **options):
        simulations.append(simulation(*arguments, **options))
        return simulations[0]

    watched = Watched(planner, simulations)
    monkeypatch.setattr(episode, "Simulation", make_simulation)
    return episode.run_episode(trial, home, home_map, likelihood, watched), watched


@pytest.fixture(scope="module")
def trials(generated_homes):
    maps = {home.id: build_map(home) for home in generated_homes}
    result = []
    for number, robots in enumerate((1, 2, 3)):
        order = home_order(generated_homes, "medium", robots, 0)
        trial = sample_trial("medium", robots, number, order, lambda home: maps[home.id], seed=0)
        trial = replace(trial, team=Team.alike(robots, RobotSpec(1.0, float(number), float(number))))
        home = next(home for home in generated_homes if home.id == trial.home_id)
        likelihood = np.random.default_rng(number).beta(0.3, 2.0, (len(home.containers), len(trial.objects)))
        result.append((trial, home, maps[home.id], likelihood))
    return result


@pytest.mark.parametrize("name", HONEST)
def test_planners_cannot_see_the_truth(name, trials, monkeypatch):
    for trial in trials:
        planner = make_planner(name, OPTIONS.get(name))
        result, watched = run_watched(monkeypatch, *trial, planner)
        assert result.status == "accepted"
        assert watched.checked > result.decisions / 2


def test_a_planner_that_looks_for_the_truth_is_caught(trials, monkeypatch):
    class Peeking:
        def plan(self, problem, seed):
            simulation = sys._getframe(2).f_locals["episode"]._simulation
            return make_planner("greedy").plan(replace(problem, presence_prob=simulation.truth * 1.0), seed)

    with pytest.raises(AssertionError, match="the truth was read while planning"):
        run_watched(monkeypatch, *trials[0], Peeking())


def test_a_problem_that_tells_the_truth_is_caught(trials, monkeypatch):
    class Telling(GuardedSimulation):
        def problem(self):
            honest = super().problem()
            return replace(honest, presence_prob=0.99 * honest.presence_prob + 0.01 * self.truth)

    with pytest.raises(AssertionError, match="Arrays are not equal"):
        run_watched(monkeypatch, *trials[0], make_planner("greedy"), Telling)


def test_a_planner_that_remembers_another_world_is_caught(trials, monkeypatch):
    class Counting:
        """Its plans depend on how often it was asked, so on more than the problem."""

        asked = 0

        def plan(self, problem, seed):
            self.asked += 1
            return make_planner("pouct", {"samples": 10 * self.asked}).plan(problem, seed)

    with pytest.raises(AssertionError):
        run_watched(monkeypatch, *trials[0], Counting())
