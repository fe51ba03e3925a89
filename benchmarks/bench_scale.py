"""Measure what running episodes over Ray costs: workers, several nodes, overhead per episode, 10,000 in one run.

    python benchmarks/bench_scale.py [--part workers|cluster|overhead|many] [--samples 10000] [--episodes 10000]

Without --part all four parts run, in about five minutes on two cores. The CPU time "around" an episode is that of all
processes (driver, Ray, workers) minus the CPU time inside the episodes of the same run, minus what Ray's processes take
at rest. So other load on the machine hardly matters there; episodes per second need a quiet machine.
"""

import argparse
import logging
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import psutil
from ray.cluster_utils import Cluster as SimulatedCluster

from mrtask.execution.trials import TrialOptions
from mrtask.files import default_cache_dir
from mrtask.homes.generator.house import generate_house
from mrtask.homes.home import SIZE_CLASSES
from mrtask.homes.procthor import parse_house
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.rows import distinct_triples, label_rows, vocabulary
from mrtask.likelihood.table import build_table
from pipeline.backends.pool import Pool
from pipeline.base.sections import Cluster, Map
from pipeline.base.specs import MapOptions, PlannerSpec
from pipeline.episodes.worker import Context, EpisodeKey, Provenance, run_one, warm

PLANNER = "pouct"
TRAINING_HOMES, EVALUATION_HOMES = 15, 12
TRIALS = 180
"""Episodes in a measurement; a fifth of this number runs before it, to start the workers."""
MEMORY_PER_TASK_GB = 0.25
NODES = 4
REST_S = 5.0
SAMPLED_EVERY_S = 1.0
ROWS_SHOWN = 8
CHEAP = ("nonlearned_myopic", "learned_myopic")


@dataclass(frozen=True)
class Spent:
    """Where and when one episode ran, and the CPU time that it took there."""

    process: int
    began_s: float
    ended_s: float
    cpu_s: float


@dataclass(frozen=True)
class Measured:
    """One run over the trials, in seconds."""

    episodes: int
    wall_s: float
    inside_s: float
    """CPU time inside the episodes."""
    around_s: float
    """All other CPU time of driver, Ray and workers, except what they take at rest."""
    rest_share: float
    """The share of a core that Ray's processes take at rest."""
    idle_share: float
    """The share of the workers' time between their first and last episode in which they had no episode."""


def timed(key: EpisodeKey, context: Context) -> Spent:
    """Run an episode and discard its row."""
    began_s, cpu_s = time.monotonic(), time.thread_time()
    run_one(key, context)
    return Spent(os.getpid(), began_s, time.monotonic(), time.thread_time() - cpu_s)


def make_context(samples: int) -> Context:
    """Make generated homes and a frequency table, as an evaluation would share them."""
    homes = [
        parse_house(generate_house(seed, SIZE_CLASSES[seed % len(SIZE_CLASSES)]), None, "bench", seed)
        for seed in range(TRAINING_HOMES + EVALUATION_HOMES)
    ]
    training, evaluated = homes[:TRAINING_HOMES], tuple(homes[TRAINING_HOMES:])
    names = vocabulary(homes)
    model = FrequencyModel(distinct_triples(pd.concat([label_rows(home, names) for home in training])))
    return Context(
        homes=evaluated,
        table=build_table(model, homes),
        maps=MapOptions(Map(resolution_m=0.05, robot_radius_m=0.2, ways="shortest"), default_cache_dir()),
        seed=0,
        trials=TrialOptions(),
        planners={PLANNER: PlannerSpec(PLANNER, PLANNER, {"samples": samples})},
        provenance=Provenance(model_version="0", config_hashes={PLANNER: ""}, code_version=""),
    )


def trial_keys(count: int, planner: str = PLANNER) -> list[EpisodeKey]:
    """List trials of all size classes, with one to three robots in turn."""
    return [EpisodeKey(SIZE_CLASSES[number % 3], 1 + number // 3 % 3, number // 9, planner) for number in range(count)]


def all_cpu_s() -> float:
    """Return the CPU time so far of this process and its living descendants."""
    total_s = 0.0
    own = psutil.Process()
    for process in [own, *own.children(recursive=True)]:
        try:
            times = process.cpu_times()
        except psutil.NoSuchProcess:
            continue
        total_s += times.user + times.system
    return total_s


def measure(pool: Pool, keys: Sequence[EpisodeKey], context: Context) -> Measured:
    """Run the episodes on workers that are warm."""
    for _ in pool.run(timed, keys[: max(len(keys) // 5, 4 * pool.slots)], context):
        pass
    before_s = all_cpu_s()
    time.sleep(REST_S)
    rest_share = (all_cpu_s() - before_s) / REST_S
    before_s, began_s = all_cpu_s(), time.monotonic()
    outcomes = [outcome for outcome in pool.run(timed, keys, context) if outcome is not None]
    wall_s, cpu_s = time.monotonic() - began_s, all_cpu_s() - before_s
    spent = [outcome.value for outcome in outcomes if outcome.value is not None]
    if len(spent) != len(keys):
        raise RuntimeError(f"episodes failed: {next(one.failure for one in outcomes if one.failure)}")
    inside_s = sum(one.cpu_s for one in spent)
    around_s = cpu_s - inside_s - rest_share * wall_s
    return Measured(len(spent), wall_s, inside_s, around_s, rest_share, idle_share(spent))


def idle_share(spent: Sequence[Spent]) -> float:
    """Return the share of the workers' time between their first and last episode in which they had no episode."""
    by_process: defaultdict[int, list[Spent]] = defaultdict(list)
    for one in spent:
        by_process[one.process].append(one)
    there_s = sum(max(o.ended_s for o in each) - min(o.began_s for o in each) for each in by_process.values())
    return 1 - sum(one.ended_s - one.began_s for one in spent) / there_s


def heading() -> None:
    print(f"{'':22}{'episodes/s':>11}{'ms inside':>11}{'ms around':>11}{'share':>8}{'idle':>8}{'Ray at rest':>15}")


def line(name: str, found: Measured) -> None:
    each = found.episodes
    print(
        f"{name:22}{each / found.wall_s:11.1f}{1e3 * found.inside_s / each:11.2f}{1e3 * found.around_s / each:11.2f}"
        f"{found.around_s / found.inside_s:8.1%}{found.idle_share:8.1%}{found.rest_share:8.1%} a core",
        flush=True,
    )


def local(cpus: int) -> Cluster:
    return Cluster(address="local", cpus=cpus, memory_per_task_gb=MEMORY_PER_TASK_GB, retries=0)


def part_workers(samples: int, trials: int) -> None:
    """Run part (a): the same trials on one worker and on two."""
    context, keys, runs = make_context(samples), trial_keys(trials), {}
    warm(keys[0], context)
    heading()
    for workers in (1, 2):
        with Pool(local(workers)) as pool:
            runs[workers] = measure(pool, keys, context)
        line(f"{workers} worker{'s' * (workers > 1)}", runs[workers])
    one, two = runs[1], runs[2]
    busy = (1 - two.idle_share) / (1 - one.idle_share)
    print(
        f"efficiency with two workers: {one.wall_s / two.wall_s / 2:.1%} by the clock, "
        f"{one.inside_s / two.inside_s * busy:.1%} if each had a core for itself (by CPU time and idle share)"
    )


def part_cluster(samples: int, trials: int) -> None:
    """Run part (b): the same trials on nodes of one core each, all on this machine."""
    context, keys = make_context(samples), trial_keys(trials)
    warm(keys[0], context)
    logging.getLogger("ray").setLevel(logging.ERROR)
    cluster = SimulatedCluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    for _ in range(NODES - 1):
        cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    with Pool(local(NODES).model_copy(update={"address": cluster.address})) as pool:
        heading()
        line(f"{pool.slots} nodes of one core", measure(pool, keys, context))
    cluster.shutdown()
    print(f"(this machine has {os.cpu_count()} cores: what counts is the time around an episode)")


def part_overhead(samples: int, trials: int) -> None:
    """Run part (c): a plain loop against one worker."""
    context, keys = make_context(samples), trial_keys(trials)
    for key in keys[: len(keys) // 5]:
        run_one(key, context)
    began_s, cpu_s = time.monotonic(), time.thread_time()
    for key in keys:
        run_one(key, context)
    wall_s, cpu_s = time.monotonic() - began_s, time.thread_time() - cpu_s
    heading()
    print(f"{'a loop without Ray':22}{len(keys) / wall_s:11.1f}{1e3 * cpu_s / len(keys):11.2f}", flush=True)
    with Pool(local(1)) as pool:
        found = measure(pool, keys, context)
        cheap = measure(pool, trial_keys(5 * trials, "nonlearned_myopic"), context)
    line("one worker", found)
    line("one worker, no search", cheap)


def part_many(episodes: int) -> None:
    """Run part (d): many cheap episodes in one run of `pipeline.evaluate`, and its report."""
    trials = -(-episodes // (9 * len(CHEAP)))
    overrides = [
        "homes.train=12", "homes.validation=3", "homes.test=60", "model=frequency",
        f"evaluation.planners=[{','.join(CHEAP)}]", f"evaluation.trials_per_cell={trials}",
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        prepared = [*overrides, "evaluation.trials_per_cell=1", "output_dir=prepared"]
        subprocess.run(stage("reproduce", prepared), cwd=folder, check=True, stdout=subprocess.DEVNULL)
        began_s = time.monotonic()
        target = Path(folder) / "outputs" / "paper"
        moments = watch(subprocess.Popen(stage("evaluate", overrides), cwd=folder), target / "episodes")
        wall_s = time.monotonic() - began_s
        began_s = time.monotonic()
        subprocess.run(stage("report", overrides), cwd=folder, check=True)
        report_s = time.monotonic() - began_s
        parts = list((target / "episodes").glob("*.parquet"))
        rows = pd.read_parquet(target / "episodes", columns=["trial_id", "planner"])
        print(f"{'s':>5} {'driver MB':>10} {'workers MB':>11} {'largest':>8} {'part files':>11} {'MB':>6}")
        for moment in moments[:: max(1, len(moments) // ROWS_SHOWN)]:
            print("{:5.0f} {:10.0f} {:11.0f} {:8.0f} {:11d} {:6.1f}".format(*moment))
        size = sum(part.stat().st_size for part in parts)
        print(
            f"{len(rows)} rows ({len(rows.drop_duplicates())} distinct) in {wall_s:.0f} s with start-up; "
            f"{len(parts)} part file{'s' * (len(parts) > 1)}, {size / len(rows):.0f} bytes a row; report in "
            f"{report_s:.0f} s, {(target / 'report' / 'index.html').stat().st_size / 2**20:.1f} MB"
        )


def stage(name: str, overrides: Sequence[str]) -> list[str]:
    return [sys.executable, "-m", f"pipeline.{name}", *overrides]


def watch(driver: "subprocess.Popen[bytes]", parts: Path) -> list[tuple[float, float, float, float, int, float]]:
    """Watch until the driver ends: seconds; MB of driver, all workers and the largest; part files and their MB."""
    began_s, moments = time.monotonic(), []
    process = psutil.Process(driver.pid)
    while driver.poll() is None:
        time.sleep(SAMPLED_EVERY_S)
        try:
            workers = [p for p in process.children(recursive=True) if p.name().startswith("ray::_call")]
            own, others = memory_mb(process), [memory_mb(worker) for worker in workers]
            sizes = [part.stat().st_size for part in parts.glob("part-*.parquet")]
        except (psutil.NoSuchProcess, FileNotFoundError):  # ended, or merged, meanwhile
            continue
        if others:
            elapsed_s = time.monotonic() - began_s
            moments.append((elapsed_s, own, sum(others), max(others), len(sizes), sum(sizes) / 2**20))
    if driver.returncode:
        raise RuntimeError("the evaluation failed")
    return moments


def memory_mb(process: psutil.Process) -> float:
    """Return the memory that the process does not share with others."""
    return float(process.memory_full_info().uss) / 2**20


def main() -> None:
    """Run the parts, each in a process of its own."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--part", choices=["workers", "cluster", "overhead", "many"])
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--trials", type=int, default=TRIALS)
    parser.add_argument("--episodes", type=int, default=10_000)
    options = parser.parse_args()
    if options.part is None:
        for part in ("workers", "cluster", "overhead", "many"):
            subprocess.run([sys.executable, __file__, "--part", part, *sys.argv[1:]], check=True)
        return
    print(f"== {options.part}: {options.samples} samples" if options.part != "many" else "== many", flush=True)
    if options.part == "many":
        part_many(options.episodes)
    else:
        parts: dict[str, Callable[[int, int], None]] = {
            "workers": part_workers, "cluster": part_cluster, "overhead": part_overhead,
        }  # fmt: skip
        parts[options.part](options.samples, options.trials)


if __name__ == "__main__":
    main()
