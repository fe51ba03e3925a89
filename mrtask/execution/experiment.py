"""Compare planners on the same trials, in one process, with their episodes as a table.

Use this in programs and notebooks that use mrtask as a library. Trials, seeds and columns are the same as in the
pipeline, which adds many workers, continuation and the report.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mrtask.execution.episode import EpisodeResult, run_episode
from mrtask.execution.team_checks import check_doable, check_types
from mrtask.execution.team_maps import MakeMap
from mrtask.execution.trials import Trial, TrialOptions, check_formula, home_order, sample_trial
from mrtask.homes.home import ALL_SIZE_CLASSES, Home
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.table import build_table
from mrtask.maps.cache import cached_map
from mrtask.maps.home_map import DEFAULT_ROBOT_RADIUS_M, HomeMap
from mrtask.planning.planner import Planner, Plans
from mrtask.planning.planners import as_planner


@dataclass(frozen=True)
class Progress:
    """Called when one more episode has ended: the ``done``-th of ``total``."""

    done: int
    total: int
    trial: Trial
    result: EpisodeResult


Named = str | Sequence[str] | Mapping[str, Plans | str]
"""Names of planners in `PLANNERS`, or any planners under names that you choose."""


def run_experiment(
    homes: Sequence[Home],
    planners: Named,
    likelihood: LikelihoodModel,
    *,
    robots: int | Sequence[int] = (1, 2, 3),
    trials_per_cell: int = 10,
    seed: int = 0,
    options: TrialOptions | None = None,
    cache_dir: Path | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> pd.DataFrame:
    """Run every planner on every trial; return one row per (trial, planner), the ``trace`` column as `Trace`.

    Args:
        homes: the homes to evaluate on; trials are made for every size class among them. The likelihood should not have
            been trained on any of them.
        planners: names of `PLANNERS` or import paths (or just one), which get their default options; or a mapping from
            a name that you choose to a planner. A planner's random seeds depend on its name.
        likelihood: where objects may be.
        robots: the sizes of the teams, or just one.
        trials_per_cell: trials for each size class and team size.
        cache_dir: a folder in which maps are kept between calls.

    Raises:
        InputError: a planner is unknown, the likelihood has no method `predict`, the formula of the options is none of
            a task, no home has one of its objects, or the team of the options cannot do any task.
        ValueError: a plan cannot be carried out, or no home has enough objects.
    """
    chosen = _planners(planners)
    if options is not None and options.formula is not None:
        check_formula(options.formula, homes)
    teams = (robots,) if isinstance(robots, int) else tuple(robots)
    if options is not None and options.team is not None:
        check_types(options.team, homes)
        for size in teams:
            check_doable(options.team.first(size), options.formula, options.formula_objects)
    known = {home.id: home for home in homes}
    table = build_table(likelihood, homes, options.formula_objects if options else ())
    map_of = lru_cache(maxsize=None)(
        lambda home_id, radius_m=DEFAULT_ROBOT_RADIUS_M: cached_map(known[home_id], cache_dir, robot_radius_m=radius_m)
    )
    sizes = [name for name in ALL_SIZE_CLASSES if any(home.size_class == name for home in homes)]
    cells = [(size, team) for size in sizes for team in teams]
    orders = {cell: home_order(homes, *cell, seed) for cell in cells}
    rows: list[dict[str, Any]] = []
    total = trials_per_cell * len(cells) * len(chosen)
    for number in range(trials_per_cell):
        for cell in cells:
            trial = sample_trial(*cell, number, orders[cell], lambda home: map_of(home.id), seed=seed, options=options)
            home = known[trial.home_id]
            probs = table.matrix(home, trial.objects)
            for result in _episodes(trial, home, map_of(home.id), probs, chosen, partial(map_of, home.id)):
                rows.append(episode_row(trial, home, result))
                if on_progress is not None:
                    on_progress(Progress(len(rows), total, trial, result))
    return pd.DataFrame(rows)


def episode_row(trial: Trial, home: Home, result: EpisodeResult) -> dict[str, Any]:
    """Return an episode as a row of a table."""
    return {
        "trial_id": trial.trial_id,
        "home_id": home.id,
        "home_source": home.source,
        "size_class": trial.size_class,
        "robots": trial.team.robots,
        "team": trial.team.name,
        "template": trial.template,
        "formula": trial.formula,
        "objects": list(trial.objects),
        "planner": result.planner,
        "status": result.status,
        "cost_s": result.cost_s,
        "cost_cells": result.cost_cells,
        "decisions": result.decisions,
        "planning_s": result.planning_s,
        "samples": result.samples,
        "seed": trial.seed,
        "error": result.error,
        "trace": result.trace,
    }


def _planners(planners: Named) -> dict[str, Planner]:
    names = [planners] if isinstance(planners, str) else planners
    named = names if isinstance(names, Mapping) else {name: name for name in names}
    return {name: as_planner(planner) for name, planner in named.items()}


def _episodes(
    trial: Trial,
    home: Home,
    home_map: HomeMap,
    likelihood: NDArray[np.float64],
    planners: Mapping[str, Planner],
    make_map: MakeMap,
) -> Iterator[EpisodeResult]:
    for name, planner in planners.items():
        yield run_episode(trial, home, home_map, likelihood, planner, name, make_map=make_map)
