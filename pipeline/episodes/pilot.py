"""Estimates how long an evaluation would take, from some of its episodes."""

import statistics
import time
from collections import defaultdict
from collections.abc import Iterator

from pipeline.backends.pool import Pool
from pipeline.base import console
from pipeline.episodes.plan import EvaluationPlan
from pipeline.episodes.runner import warm_kernels
from pipeline.episodes.worker import run_one

PILOT_S = 20.0


def pilot(plan: EvaluationPlan, pool: Pool) -> Iterator[str]:
    """Time some episodes and say how long all of them would take, a line for each planner and one for the whole."""
    spent_s = _spent_s(plan, pool)
    episodes = len(plan.keys) // len(plan.planners)
    total_s = 0.0
    for planner, pairs in spent_s.items():
        planning_s, other_s = zip(*pairs, strict=True)
        # Only the first episode in a home maps it, which most episodes need not do: hence the median.
        mean_s = statistics.fmean(planning_s) + statistics.median(other_s)
        total_s += mean_s * episodes / pool.slots
        yield f"{planner:20} {mean_s:8.3f} s an episode, from {len(pairs)}"
    yield f"about {console.duration(total_s)} on {pool.slots} workers; no episode was written (dry_run)"


def _spent_s(plan: EvaluationPlan, pool: Pool) -> dict[str, list[tuple[float, float]]]:
    """Return, by planner, the seconds of planning and of everything else in each episode of at least `PILOT_S`."""
    warm_kernels(plan.context, plan.keys)
    spent_s: defaultdict[str, list[tuple[float, float]]] = defaultdict(list)
    end_s = time.monotonic() + PILOT_S
    for outcome in pool.run(run_one, plan.keys, plan.context, timeout_s=plan.spec.options.episode_timeout_s):
        row = outcome.value if outcome is not None else None
        if row is not None and row.planning_s is not None and row.wall_s is not None:
            spent_s[row.planner].append((row.planning_s, row.wall_s - row.planning_s))
        if time.monotonic() > end_s and len(spent_s) == len(plan.planners):
            break
    return spent_s
