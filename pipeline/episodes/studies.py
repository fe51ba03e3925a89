"""What workers do for `pipeline.optimality` and `pipeline.priors`.

This is not part of `pipeline.episodes.worker`, because it needs libraries that an evaluation's workers do without; they
would cost seconds at the start and memory in each worker.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mrtask.analysis.studies.calibration import Task, beliefs_of
from mrtask.bounds.assess import assess
from mrtask.likelihood.adapt import Sighting
from pipeline.episodes.worker import Context, EpisodeKey, bench_of, planning_likelihood, setting


def assess_trial(key: EpisodeKey, context: Context, worlds: int) -> dict[str, Any]:
    """Return how far a planner is from optimal in a trial, as the row of `mrtask.bounds.assess`."""
    spec = context.planners[key.planner]
    trial, home, home_map, likelihood = setting(key, context)
    make_map = bench_of(context).maker_of(home.id)
    return assess(trial, home, home_map, likelihood, spec.make(), worlds, spec.planner, make_map)


@dataclass(frozen=True)
class HomeTasks:
    """A planner's tasks in one home, in order."""

    planner: str
    home_id: str
    tasks: tuple[Task, ...]


def beliefs_in_home(done: HomeTasks, context: Context) -> pd.DataFrame:
    """Return what the team believed when each task began, see `mrtask.analysis.studies.calibration.beliefs_of`."""
    home, spec = bench_of(context).homes[done.home_id], context.planners[done.planner]

    def believe(task: Task, number: int, seen: Sequence[Sighting]) -> NDArray[np.float64]:
        return planning_likelihood(home, task.objects, task.seed, spec, context, number, seen)

    return beliefs_of(home, done.tasks, believe)
