"""One planner on one trial, from the first decision to acceptance or a stated failure."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from mrtask.execution.simulation import Simulation
from mrtask.execution.trace import Trace
from mrtask.execution.trials import Trial, key_seed
from mrtask.homes.home import Home
from mrtask.maps.home_map import HomeMap
from mrtask.planning.planners import make_planner
from mrtask.planning.problem import Plan, Planner, PlanningProblem
from mrtask.tasks.automaton import build_automaton

CELL_M = 0.05
"""The paper's grid cell, in which its table counts cost."""
MAX_DECISIONS = 1000
IDLE_DECISIONS_PER_ROBOT = 10
"""An episode fails with so many decisions in a row between which nothing was learned or done: its planner goes round in
circles. A team needs no more than one or two each, for robots that take up a place early."""
Observer = Callable[[float, PlanningProblem, Plan], None]
"""Told of each decision: the time in seconds, what the planner saw and what it answered."""


@dataclass(frozen=True)
class EpisodeResult:
    """What an episode came to. What it costs is the trial's to say; ``error`` says why a failed one failed."""

    planner: str
    status: str
    cost_s: float | None
    cost_cells: float | None
    decisions: int
    planning_s: float
    samples: int
    error: str | None
    trace: Trace
    searched: tuple[bool, ...]
    """Of each container: whether its contents were seen, or known from the start."""


def run_episode(
    trial: Trial,
    home: Home,
    home_map: HomeMap,
    likelihood: NDArray[np.float64],
    planner_name: str,
    planner_options: Mapping[str, object] | None = None,
    *,
    planner: Planner | None = None,
    max_decisions: int = MAX_DECISIONS,
    observe: Observer | None = None,
) -> EpisodeResult:
    """Runs a trial with a planner.

    Args:
        likelihood: [C, O] the model's probability that container c holds the trial's object o.
        planner: the planner itself, where it is not to be made from its name and options.

    Raises:
        ValueError: an unknown planner, refused options, or a plan that the simulation cannot carry out.
    """
    planner = planner or make_planner(planner_name, planner_options)
    simulation = _simulation(trial, home, home_map, likelihood, planner.knows_contents)
    decisions, idle_decisions, samples, planning_s, error = 0, 0, 0, 0.0, None
    max_idle_decisions = IDLE_DECISIONS_PER_ROBOT * trial.team.robots
    while not simulation.accepted:
        if decisions == max_decisions:
            error = f"decision limit of {max_decisions} reached"
            break
        problem = simulation.problem()
        began_s = perf_counter()
        plan = planner.plan(problem, key_seed(trial.seed, planner_name, decisions))
        planning_s += perf_counter() - began_s
        decisions += 1
        samples += plan.info.samples
        if observe is not None:
            observe(simulation.time_s, problem, plan)
        simulation.assign(plan.assignments)
        if not simulation.advance():
            missing = simulation.missing()
            error = (
                f"found in no container that can be reached: {', '.join(missing)}"
                if missing and simulation.searched[home_map.reachable].all()
                else "every robot waits and none is under way"
            )
            break
        idle_decisions = 0 if simulation.news else idle_decisions + 1
        if idle_decisions == max_idle_decisions:
            error = f"no progress for {idle_decisions} decisions: {planner_name} neither searches nor interacts"
            break
    trace = simulation.trace()
    cost_s = _cost_s(trial, simulation.time_s, trace) if error is None else None
    return EpisodeResult(
        planner=planner_name,
        status="accepted" if error is None else "failed",
        cost_s=cost_s,
        cost_cells=None if cost_s is None else cost_s * trial.team.spec.speed_m_per_s / CELL_M,
        decisions=decisions,
        planning_s=planning_s,
        samples=samples,
        error=error,
        trace=trace,
        searched=tuple(bool(seen) for seen in simulation.searched),
    )


def warm_up(
    trial: Trial,
    home: Home,
    home_map: HomeMap,
    likelihood: NDArray[np.float64],
    planner_name: str,
    planner_options: Mapping[str, object] | None = None,
) -> None:
    """Lets a planner compile what it needs, on a trial's first decision; arguments and errors as of `run_episode`."""
    planner = make_planner(planner_name, planner_options)
    planner.warm_up(_simulation(trial, home, home_map, likelihood, planner.knows_contents).problem())


def _simulation(
    trial: Trial, home: Home, home_map: HomeMap, likelihood: NDArray[np.float64], known: bool
) -> Simulation:
    automaton = build_automaton(trial.formula, trial.objects)
    truth = np.array([[name in container.objects for name in trial.objects] for container in home.containers])
    return Simulation(
        home,
        home_map,
        automaton,
        likelihood,
        truth,
        team=trial.team,
        start_cell=trial.start_cell,
        known=known,
        known_containers=trial.known,
        seed=trial.seed,
    )


def _cost_s(trial: Trial, makespan_s: float, trace: Trace) -> float:
    if trial.cost == "makespan":
        return makespan_s
    return min(sum(leg.t1_s - leg.t0_s for leg in legs if leg.kind == "move") for legs in trace.robots)
