"""Compare a planner with the lower bound in one trial, both under the trial's belief.

The bound holds for the expected cost over the worlds that are possible under the belief. The planner therefore does not
run on the home's true contents, of which the likelihood model knows little, but on worlds drawn from the belief. The
bound is evaluated on the same worlds.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from mrtask.arrays import Bools, Floats
from mrtask.bounds.lower_bound import lower_bound
from mrtask.bounds.one_robot import SearchMade
from mrtask.execution.acts import ActKind
from mrtask.execution.episode import run_episode
from mrtask.execution.simulation import Simulation
from mrtask.execution.team_maps import MakeMap
from mrtask.execution.trace import Trace
from mrtask.execution.trials import Trial, key_seed
from mrtask.homes.home import Home
from mrtask.maps.home_map import HomeMap
from mrtask.planning.planner import Plans
from mrtask.planning.planners import as_planner, planner_name
from mrtask.planning.solver_belief import belief_of, draw_worlds
from mrtask.tasks.automaton import Automaton, build_automaton


def assess(
    trial: Trial,
    home: Home,
    home_map: HomeMap,
    likelihood: Floats,
    planner: Plans,
    worlds: int,
    name: str | None = None,
    make_map: MakeMap | None = None,
) -> dict[str, Any]:
    """Return one trial's row: means over ``worlds`` worlds of the planner's cost and of both bounds, in s.

    Args:
        likelihood: [C, O] the model's probability that container c holds the trial's object o.
        name: the planner's name. With None, it is its name among ours, or its import path.
        make_map: as `mrtask.execution.team_maps.maps_for` takes it.

    Raises:
        ValueError: no world is possible under the belief.
    """
    automaton = build_automaton(trial.formula, trial.objects)
    nothing = np.zeros(likelihood.shape, dtype=bool)
    problem = Simulation(
        home, home_map, automaton, likelihood, nothing, team=trial.team, start_cell=trial.start_cell, make_map=make_map
    ).problem()
    rng = np.random.default_rng(key_seed(trial.seed, "worlds"))
    drawn = draw_worlds(belief_of(problem), worlds, rng)
    costs_s, runs = np.full(worlds, np.nan), []
    for number, world in enumerate(drawn):
        result = run_episode(
            replace(trial, seed=key_seed(trial.seed, "world", number)),
            home_with(home, trial.objects, world),
            home_map,
            likelihood,
            planner,
            name,
            make_map=make_map,
        )
        runs.append(searches_of(result.trace, home, automaton))
        if result.cost_s is not None:
            costs_s[number] = result.cost_s
    bound = lower_bound(problem, drawn, rng, runs)
    done = np.isfinite(costs_s)
    return {
        "trial_id": trial.trial_id,
        "home_id": home.id,
        "size_class": trial.size_class,
        "robots": trial.team.robots,
        "template": trial.template,
        "formula": trial.formula,
        "planner": name or planner_name(as_planner(planner)),
        "worlds": worlds,
        "failed": int((~done).sum()),
        "cost_s": _mean(costs_s[done]),
        "bound_s": _mean(bound.values_s[done]),
        "clairvoyant_s": _mean(bound.clairvoyant_s[done]),
        "kind": bound.kind.value,
        "bound_seconds": bound.seconds,
    }


def searches_of(trace: Trace, home: Home, automaton: Automaton) -> list[SearchMade]:
    """Return the searches of a one-robot team, with the task's state at each."""
    number = {container.id: index for index, container in enumerate(home.containers)}
    state, searches = automaton.initial, []
    for leg in trace.robots[0]:
        if leg.kind == ActKind.SEARCH and leg.container is not None:
            searches.append(SearchMade(number[leg.container], state))
        elif leg.kind == ActKind.INTERACT and leg.object is not None:
            state = int(automaton.transitions[state, automaton.propositions.index(leg.object)])
    return searches


def home_with(home: Home, objects: tuple[str, ...], world: Bools) -> Home:
    """Return the home with the task's objects where ``world`` [C, O] places them, and nowhere else."""
    containers = []
    for container, held in zip(home.containers, world, strict=True):
        others = [name for name in container.objects if name not in objects]
        placed = [name for name, here in zip(objects, held, strict=True) if here]
        containers.append(replace(container, objects=tuple(sorted([*others, *placed]))))
    return replace(home, containers=tuple(containers))


def _mean(values: Floats) -> float:
    return float(values.mean()) if len(values) else float("nan")
