"""Maps the homes and runs the episodes of an evaluation, on all workers; a pilot estimates how long they take."""

import contextlib
import math
import statistics
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

from mrtask.names import counted
from mrtask.planning.planners import PLANNERS
from pipeline.backends import runs
from pipeline.backends.nodes import HeadLost
from pipeline.backends.pool import Outcome, Pool
from pipeline.base import console
from pipeline.base.config import UserError
from pipeline.episodes.kernels import compiled_meanwhile
from pipeline.episodes.plan import EvaluationPlan
from pipeline.episodes.tally import Tally
from pipeline.episodes.worker import Context, EpisodeKey, map_home, run_chain, run_warm, unfinished_row, warm
from pipeline.store.episode_row import EpisodeRow
from pipeline.store.folder import Folder, this_process
from pipeline.store.layout import PROGRESS
from pipeline.store.records import Reach, RunProgress
from pipeline.store.rows import EpisodeWriter

POST_EVERY_S = 10.0
"""How often the run's progress is recorded."""
LOG_EVERY_S = 60.0
"""How often MLflow gets live metrics."""
PILOT_S = 20.0
"""How long a pilot runs at least."""


def map_homes(context: Context, pool: Pool) -> Reach:
    """Map all homes into the cache; return how many containers they have and how many can be reached."""
    # Compiled once here, so that the workers find the kernels in numba's cache.
    context.maps.map_of(context.homes[0])
    mapped = pool.values(map_home, range(len(context.homes)), context, unit="homes mapped")
    containers, reachable = (sum(counts) for counts in zip(*(counts for _, counts in mapped), strict=True))
    reach = Reach(containers=containers, reachable=reachable)
    console.line(f"{counted(len(context.homes), 'home')} mapped, {reach.share:.2%} of their containers reachable")
    return reach


def run_episodes(
    plan: EvaluationPlan, missing: Sequence[EpisodeKey], pool: Pool, writer: EpisodeWriter, live: runs.LiveMetrics
) -> None:
    """Run the missing episodes and close the writer, also on an interrupt: finished episodes stay.

    ``live`` gets the number of episodes and the improvement so far every minute.

    Raises:
        HeadLost: the cluster's head is gone.
        UserError: too many episodes fail, or the rows cannot be written.
    """
    options = plan.spec.options
    tally = Tally(plan.planners, options.max_failed_fraction)
    warm_kernels(plan.context, missing)
    done = len(plan.keys) - len(missing)
    chains, wanted = plan.chains(missing), {(key.trial_id, key.planner) for key in missing}
    timeout_s = options.episode_timeout_s * max((len(chain) for chain in chains), default=1)
    context, posts = plan.context, _Posts(plan, tally, pool, writer, live, done)
    try:
        with console.Progress(len(plan.keys), "episodes", done) as progress:
            for outcome in pool.run(run_chain, chains, context, timeout_s=timeout_s, modules=context.own_modules):
                if outcome is None:
                    writer.tick()
                    posts.post()
                    progress.update(0, tally.note(pool.workers))
                    continue
                for row in rows_of(outcome, context):
                    if (row.trial_id, row.planner) in wanted:  # others had a row and ran again only to be learned from
                        writer.add(row)
                        tally.add(row)
                        posts.done += 1
                        progress.update(note=tally.note(pool.workers))
                posts.post()
        writer.close()
    except HeadLost as error:
        writer.close()
        posts.end("failed", str(error))
        raise HeadLost(
            f"{error}; {posts.done} of {len(plan.keys)} episodes are safe in {plan.spec.output_dir}"
        ) from error
    except KeyboardInterrupt:
        writer.flush_soon()
        posts.end("interrupted")
        raise
    except BaseException as error:
        writer.close()
        posts.end("failed", str(error))
        raise
    posts.end("finished")


class _Posts:
    """Leaves a record of the run's progress in its folder every few seconds, for those who look from elsewhere."""

    def __init__(
        self,
        plan: EvaluationPlan,
        tally: Tally,
        pool: Pool,
        writer: EpisodeWriter,
        live: runs.LiveMetrics,
        done: int,
    ) -> None:
        self.done = done
        self._folder = Folder(plan.spec.output_dir)
        self._total, self._began_with, self._started = len(plan.keys), done, time.time()
        self._tally, self._pool, self._writer, self._live = tally, pool, writer, live
        self._posted_s = self._logged_s = -math.inf

    def post(self) -> None:
        """Leave a record when it is time."""
        if not self.done:  # a run without rows leaves nothing
            return
        if time.monotonic() - self._posted_s >= POST_EVERY_S:
            self._posted_s = time.monotonic()
            record = self._record("running")
            self._writer.post(lambda: self._folder.write(PROGRESS, record.to_json(), patient=False))
        if time.monotonic() - self._logged_s >= LOG_EVERY_S:
            self._logged_s = time.monotonic()
            saved = self._tally.saved
            self._live.log({"live/episodes": self.done} | ({} if saved is None else {"live/improvement": saved}))

    def end(self, state: Literal["finished", "interrupted", "failed"], message: str = "") -> None:
        """Leave the last record; a store that does not take it is not waited for."""
        if not self.done:
            return
        with contextlib.suppress(UserError):
            self._folder.write(PROGRESS, self._record(state, message).to_json(), patient=False)

    def _record(self, state: Literal["running", "finished", "interrupted", "failed"], message: str = "") -> RunProgress:
        return RunProgress(
            state=state,
            by=this_process(),
            started=self._started,
            updated=time.time(),
            done=self.done,
            total=self._total,
            began_with=self._began_with,
            workers=self._pool.slots,
            note=self._tally.note(),
            last_error=self._tally.last_error,
            message=message,
        )


def rows_of(
    outcome: Outcome[tuple[EpisodeKey, ...], tuple[EpisodeRow, ...]], context: Context
) -> tuple[EpisodeRow, ...]:
    """Return the rows of a chain's episodes, however they ended; one that breaks off ends its whole chain."""
    if outcome.value is not None:
        rows = outcome.value
    elif outcome.failure is not None:
        status = "timeout" if outcome.failure.kind == "timeout" else "error"
        rows = tuple(unfinished_row(key, context, status, outcome.failure.message) for key in outcome.item)
    else:
        raise ValueError(f"{outcome.item} has neither a value nor a failure")
    return tuple(replace(row, attempt=outcome.attempt, node=outcome.node) for row in rows)


def warm_kernels(context: Context, missing: Sequence[EpisodeKey]) -> None:
    """Compile the planners' kernels, once for all workers. A user's own planner runs in workers only."""
    firsts = {key.planner: key for key in reversed(missing)}
    with compiled_meanwhile(context.planners[name] for name in firsts):
        pass
    for name, key in firsts.items():
        if context.planners[name].planner in PLANNERS:
            try:
                warm(key, context)
            except Exception as error:  # the run continues: these episodes become rows of status error
                console.line(f"{name} failed on {key.trial_id} already in the driver: {error}")


def pilot(plan: EvaluationPlan, pool: Pool) -> Iterator[str]:
    """Time some episodes and say how long all of them would take, a line for each planner and one for the whole."""
    if pool.occupied:
        yield f"{pool.occupied} of {pool.workers} are occupied by others now, who make this pilot and the run slower"
    spent_s = _spent_s(plan, pool)
    episodes = len(plan.keys) // len(plan.planners)
    total_s = 0.0
    for planner, pairs in spent_s.items():
        planning_s, other_s = zip(*pairs, strict=True)
        # Only the first episode in a home maps it, which most episodes need not do: hence the median.
        mean_s = statistics.fmean(planning_s) + statistics.median(other_s)
        total_s += mean_s * episodes
        yield f"{planner:20} {mean_s:8.3f} s an episode, from {len(pairs)}"
    wall = console.duration(total_s / pool.slots)
    yield f"about {wall} on {pool.workers}, {total_s / 3600:.2g} CPU hours; no episode was written (dry_run)"


def _spent_s(plan: EvaluationPlan, pool: Pool) -> dict[str, list[tuple[float, float]]]:
    """Return, by planner, the seconds of planning and of everything else in each episode of at least `PILOT_S`."""
    warm_kernels(plan.context, plan.keys)
    spent_s: defaultdict[str, list[tuple[float, float]]] = defaultdict(list)
    end_s = time.monotonic() + PILOT_S
    timeout_s, own = plan.spec.options.episode_timeout_s, plan.context.own_modules
    for outcome in pool.run(run_warm, plan.keys, plan.context, timeout_s=timeout_s, modules=own):
        row = outcome.value if outcome is not None else None
        if row is not None and row.planning_s is not None and row.wall_s is not None:
            spent_s[row.planner].append((row.planning_s, row.wall_s - row.planning_s))
        if time.monotonic() > end_s and len(spent_s) == len(plan.planners):
            break
    return spent_s
