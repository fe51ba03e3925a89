"""Run one planner on one trial, from the first decision to acceptance or a stated failure."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from mrtask.execution.abilities import missing_ability
from mrtask.execution.acts import ActKind
from mrtask.execution.simulation import Simulation
from mrtask.execution.team_maps import MakeMap
from mrtask.execution.trace import Trace
from mrtask.execution.trials import Trial, key_seed
from mrtask.homes.home import Home
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.table import build_table
from mrtask.maps.home_map import HomeMap
from mrtask.planning.planner import Plans
from mrtask.planning.planners import as_planner, planner_name
from mrtask.planning.problem import Plan, PlanningProblem
from mrtask.tasks.automaton import NEVER_ACCEPTS, build_automaton

CELL_M = 0.05
"""The paper's grid cell, the unit of cost in its table."""
MAX_DECISIONS = 1000
IDLE_DECISIONS_PER_ROBOT = 10
"""An episode fails after this many decisions per robot in a row between which the team learned and did nothing: its
planner goes round in circles. A team needs no more than one or two each, for robots that take up a place early."""
BY_HAND = "by_hand"
"""The planner's name in an episode that is stepped by hand."""
Likelihood = NDArray[np.float64] | LikelihoodModel
"""[C, O] the probability that container c holds the trial's object o, or a model to ask."""
Observer = Callable[[float, PlanningProblem, Plan], None]
"""Called at each decision with the time in seconds, what the planner saw and what it answered."""


@dataclass(frozen=True)
class EpisodeResult:
    """An episode's outcome; the trial defines its cost."""

    planner: str
    status: str
    cost_s: float | None
    cost_cells: float | None
    """The cost in the paper's unit; None also where the robots differ in speed."""
    decisions: int
    planning_s: float
    samples: int
    error: str | None
    """The reason why a failed episode failed."""
    trace: Trace
    searched: tuple[bool, ...]
    """[C] whether each container's contents were seen, or known from the start."""


class Episode:
    """One trial, stepped by hand: read `problem`, pass a plan to `step`, until `done`; `run_episode` is this loop.

    Args:
        likelihood: where objects may be.
        name: the planner's name; the seeds of its plans depend on it.
        known: whether the planner sees the true contents from the start.
        max_decisions: the episode fails if the task is not done after this many.
        make_map: returns the home's map for robots of another width, whose radius it takes; by default it is built.
    """

    def __init__(
        self,
        trial: Trial,
        home: Home,
        home_map: HomeMap,
        likelihood: Likelihood,
        name: str = BY_HAND,
        *,
        known: bool = False,
        max_decisions: int = MAX_DECISIONS,
        make_map: MakeMap | None = None,
    ) -> None:
        self.trial, self.name = trial, name
        self.decisions, self.samples = 0, 0
        self.error: str | None = None
        """The reason why the episode failed, once it has failed."""
        self._home, self._automaton = home, build_automaton(trial.formula, trial.objects)
        self._simulation = Simulation(
            home,
            home_map,
            self._automaton,
            _matrix(likelihood, home, trial.objects),
            np.array([[obj in container.objects for obj in trial.objects] for container in home.containers]),
            team=trial.team,
            start_cell=trial.start_cell,
            make_map=make_map,
            known=known,
            known_containers=trial.known,
            seed=trial.seed,
        )
        self._max_decisions, self._idle_decisions = max_decisions, 0
        if trial.team.limited and self._hopeless():
            self.error = f"nobody in team {trial.team.name!r} can do the task{self._what_would_help()}"

    @property
    def done(self) -> bool:
        """Whether the task is done or the episode has failed."""
        return self._simulation.accepted or self.error is not None

    @property
    def time_s(self) -> float:
        """The present instant."""
        return self._simulation.time_s

    @property
    def problem(self) -> PlanningProblem:
        """What a planner may know now."""
        return self._simulation.problem()

    @property
    def seed(self) -> int:
        """The seed of the next plan: it depends on the trial, the planner's name and the number of the decision."""
        return key_seed(self.trial.seed, self.name, self.decisions)

    def step(self, plan: Plan) -> None:
        """Carry out a plan until the task is done or a robot is free again.

        Raises:
            ValueError: the episode is done, or the plan cannot be carried out.
        """
        if self.done:
            raise ValueError(f"the episode is done ({self.error or 'accepted'}); make a new Episode to go on")
        self.decisions += 1
        self.samples += plan.info.samples
        self._simulation.assign(plan.assignments)
        moved = self._simulation.advance()
        self._idle_decisions = 0 if self._simulation.news else self._idle_decisions + 1
        if not moved:
            self.error = self._stuck() + self._what_would_help()
        elif self._idle_decisions == IDLE_DECISIONS_PER_ROBOT * self.trial.team.robots:
            self.error = f"no progress for {self._idle_decisions} decisions: {self.name} neither searches nor interacts"
        elif self.decisions >= self._max_decisions and not self._simulation.accepted:
            self.error = f"decision limit of {self._max_decisions} reached"

    def result(self, planning_s: float = 0.0) -> EpisodeResult:
        """Return the outcome; ``planning_s`` is how long planning took, where the caller measured it.

        Raises:
            ValueError: the episode is not done.
        """
        if not self.done:
            raise ValueError(f"the episode is not done after {self.decisions} decisions; step it until `done` is true")
        trace = self._simulation.trace()
        cost_s = _cost_s(self.trial, self.time_s, trace) if self.error is None else None
        speed_m_per_s = self.trial.team.speed_m_per_s
        return EpisodeResult(
            planner=self.name,
            status="accepted" if self.error is None else "failed",
            cost_s=cost_s,
            cost_cells=None if cost_s is None or speed_m_per_s is None else cost_s * speed_m_per_s / CELL_M,
            decisions=self.decisions,
            planning_s=planning_s,
            samples=self.samples,
            error=self.error,
            trace=trace,
            searched=tuple(bool(seen) for seen in self._simulation.searched),
        )

    def _hopeless(self) -> bool:
        """Whether the robots' abilities and the home's furniture rule the task out, wherever the objects are."""
        steps = self._automaton.steps_with(self.problem.obtainable())
        return bool(steps[self._automaton.initial] == NEVER_ACCEPTS)

    def _what_would_help(self) -> str:
        """Return the end of a sentence on which robot could do the task after a change, or nothing."""
        if not self.trial.team.limited:
            return ""
        simulation = self._simulation
        said = missing_ability(self._automaton, self.trial.team, self._home, simulation.maps, simulation.truth)
        return "" if said is None else f"; {said}"

    def _stuck(self) -> str:
        missing = self._simulation.missing()
        if missing and self._simulation.searched[self._simulation.in_reach].all():
            return f"found in no container that can be reached: {', '.join(missing)}"
        return "every robot waits and none is under way"


def run_episode(
    trial: Trial,
    home: Home,
    home_map: HomeMap,
    likelihood: Likelihood,
    planner: Plans | str,
    name: str | None = None,
    *,
    max_decisions: int = MAX_DECISIONS,
    observe: Observer | None = None,
    make_map: MakeMap | None = None,
) -> EpisodeResult:
    """Run a trial with a planner.

    Args:
        likelihood: where objects may be.
        planner: any object with a method `plan`, or the name or import path of a planner, with its default options.
        name: the planner's name, on which its seeds depend; None: its name among ours, or its import path.

    Raises:
        ValueError: the simulation cannot carry out a plan.
        InputError: the planner has no method `plan`, or the likelihood no method `predict`.
    """
    full = as_planner(planner)
    name = name or planner_name(full)
    known = full.knows_contents
    episode = Episode(
        trial, home, home_map, likelihood, name, known=known, max_decisions=max_decisions, make_map=make_map
    )
    planning_s = 0.0
    while not episode.done:
        problem = episode.problem
        began_s = perf_counter()
        plan = full.plan(problem, episode.seed)
        planning_s += perf_counter() - began_s
        if observe is not None:
            observe(episode.time_s, problem, plan)
        episode.step(plan)
    return episode.result(planning_s)


def warm_up(
    trial: Trial,
    home: Home,
    home_map: HomeMap,
    likelihood: Likelihood,
    planner: Plans | str,
    make_map: MakeMap | None = None,
) -> None:
    """Let a planner compile its kernels on a trial's first decision. Takes and raises what `run_episode` does."""
    full = as_planner(planner)
    full.warm_up(Episode(trial, home, home_map, likelihood, known=full.knows_contents, make_map=make_map).problem)


def _matrix(likelihood: Likelihood, home: Home, objects: tuple[str, ...]) -> NDArray[np.float64]:
    if isinstance(likelihood, np.ndarray):
        return likelihood
    return build_table(likelihood, [home], objects).matrix(home, objects)


def _cost_s(trial: Trial, makespan_s: float, trace: Trace) -> float:
    if trial.cost == "makespan":
        return makespan_s
    return min(sum(leg.t1_s - leg.t0_s for leg in legs if leg.kind == ActKind.MOVE) for legs in trace.robots)
