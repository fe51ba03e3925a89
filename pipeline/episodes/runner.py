"""Maps the homes and runs the episodes of an evaluation, on all workers."""

from collections.abc import Sequence
from dataclasses import replace

from mrtask.planning.planners import PLANNERS
from pipeline.backends.pool import Outcome, Pool
from pipeline.base import console
from pipeline.episodes.kernels import compiled_meanwhile
from pipeline.episodes.plan import EvaluationPlan
from pipeline.episodes.tally import Tally
from pipeline.episodes.worker import Context, EpisodeKey, map_home, run_chain, unfinished_row, warm
from pipeline.store.episode_row import EpisodeRow
from pipeline.store.records import Reach
from pipeline.store.rows import EpisodeWriter


def map_homes(context: Context, pool: Pool) -> Reach:
    """Map all homes into the cache; return how many containers they have and how many can be reached."""
    # Compiled once here, so that the workers find the kernels in numba's cache.
    context.maps.map_of(context.homes[0])
    mapped = pool.values(map_home, range(len(context.homes)), context, unit="homes mapped")
    containers, reachable = (sum(counts) for counts in zip(*(counts for _, counts in mapped), strict=True))
    reach = Reach(containers=containers, reachable=reachable)
    console.line(f"{len(context.homes)} homes mapped, {reach.share:.2%} of their containers reachable")
    return reach


def run_episodes(plan: EvaluationPlan, missing: Sequence[EpisodeKey], pool: Pool, writer: EpisodeWriter) -> None:
    """Run the missing episodes and close the writer, also on an interrupt: finished episodes stay.

    Raises:
        UserError: too many episodes fail.
    """
    options = plan.spec.options
    tally = Tally(plan.planners, options.max_failed_fraction)
    warm_kernels(plan.context, missing)
    done = len(plan.keys) - len(missing)
    chains, wanted = plan.chains(missing), {(key.trial_id, key.planner) for key in missing}
    timeout_s = options.episode_timeout_s * max((len(chain) for chain in chains), default=1)
    try:
        with console.Progress(len(plan.keys), "episodes", done) as progress:
            for outcome in pool.run(run_chain, chains, plan.context, timeout_s=timeout_s):
                if outcome is None:
                    writer.tick()
                    progress.update(0)
                    continue
                for row in rows_of(outcome, plan.context):
                    if (row.trial_id, row.planner) in wanted:  # others had a row and ran again only to be learned from
                        writer.add(row)
                        tally.add(row)
                        progress.update(note=tally.note())
    finally:
        writer.close()


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
    return tuple(replace(row, attempt=outcome.attempt) for row in rows)


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
