"""Measure what a likelihood model is worth to the mission: `pouct`'s mean cost with each model on the same trials.

    python benchmarks/bench_mission.py --homes a.jsonl.gz b.jsonl.gz --assets asset-database.json

The models are compared with a uniform belief (the training rows' share of positives for every object and container) and
with the true contents (`known`, the same search). Models are trained on 500 homes, and trials are on the remaining
ones; without ``--homes`` all homes are generated. Costs are in seconds at 1 m/s, over the trials that finished under
all beliefs.
"""

import argparse
import multiprocessing
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from bench_likelihood import HOMES, SMALL_LAYERS, SPLIT_SALT, generated_homes, triples_of
from numpy.typing import NDArray

from mrtask.analysis.results.statistics import compare
from mrtask.execution.episode import run_episode
from mrtask.execution.trials import Trial, home_order, sample_trial
from mrtask.files import default_cache_dir
from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.homes.procthor import read_houses
from mrtask.homes.split import split_homes
from mrtask.likelihood.kinds import KINDS
from mrtask.likelihood.options import PAPER_LAYERS, NetworkOptions, TrainingOptions
from mrtask.likelihood.rows import SPLITS
from mrtask.likelihood.table import LikelihoodTable, build_table
from mrtask.likelihood.training import fit
from mrtask.maps.cache import cached_map
from mrtask.maps.home_map import HomeMap
from mrtask.planning.planners import make_planner

ROBOTS = (1, 2, 3)
UNIFORM, TRUTH = "uniform", "known contents"


@dataclass(frozen=True, eq=False)
class Beliefs:
    """What the planner is told about where objects lie."""

    tables: Mapping[str, LikelihoodTable]
    uniform_prob: float

    def likelihood(self, name: str, home: Home, objects: Sequence[str]) -> NDArray[np.float64]:
        """Return the likelihoods ``[C, O]``; the planner that knows the contents does not use them."""
        if name in self.tables:
            return self.tables[name].matrix(home, objects)
        return np.full((len(home.containers), len(objects)), self.uniform_prob)


def map_of(home: Home) -> HomeMap:
    """Return the home's map, from the user's cache if it has the map."""
    return cached_map(home, default_cache_dir() / "maps")


def sample_trials(homes: Sequence[Home], per_cell: int) -> list[Trial]:
    """Sample ``per_cell`` trials for each size class and team size."""
    seen = cache(map_of)
    return [
        sample_trial(size_class, robots, number, order, seen, seed=0)
        for size_class in SIZE_CLASSES
        for robots in ROBOTS
        for order in [home_order(homes, size_class, robots, seed=0)]
        for number in range(per_cell)
    ]


def run_trial(task: tuple[Trial, Home, Beliefs, int]) -> dict[str, object]:
    """Return the cost of one trial under every belief; NaN if the task could not be done."""
    trial, home, beliefs, samples = task
    home_map = map_of(home)
    row: dict[str, object] = {"size_class": trial.size_class, "home_id": home.id}
    for name in (UNIFORM, *beliefs.tables, TRUTH):
        planner = "known" if name == TRUTH else "pouct"
        likelihood = beliefs.likelihood(name, home, trial.objects)
        cost_s = run_episode(trial, home, home_map, likelihood, make_planner(planner, {"samples": samples})).cost_s
        row[name] = float("nan") if cost_s is None else cost_s
    return row


def main() -> None:
    """Print mean costs by size class and overall, and each belief's saving against the frequency table's."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--homes", nargs="+", type=Path, default=[], help="house files in ProcTHOR's schema")
    parser.add_argument("--assets", type=Path, help="ProcTHOR's asset database")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--per-cell", type=int, default=34, help="trials for each size class and team size")
    parser.add_argument("--samples", type=int, default=1000, help="of the planner")
    arguments = parser.parse_args()

    homes = list(read_houses(arguments.homes, arguments.assets)) if arguments.homes else generated_homes()
    by_id = {home.id: home for home in homes}
    by_split = split_homes(by_id, HOMES["train"], HOMES["validation"], None, SPLIT_SALT)
    triples = triples_of([by_id[home_id] for name in SPLITS for home_id in getattr(by_split, name)], by_split)
    test_homes = {home_id: by_id[home_id] for home_id in by_split.test}
    tables = {}
    for kind in arguments.kinds:
        network = NetworkOptions(layers=SMALL_LAYERS if kind == "mlp" else PAPER_LAYERS, threads=1, device="cpu")
        model, _ = fit(triples["train"], triples["validation"], TrainingOptions(kind, network=network))
        tables[kind] = build_table(model, test_homes.values())
        print(f"trained {kind}", flush=True)
    beliefs = Beliefs(tables, triples["train"]["positives"].sum() / triples["train"]["count"].sum())
    trials = sample_trials(list(test_homes.values()), arguments.per_cell)
    tasks = [(trial, test_homes[trial.home_id], beliefs, arguments.samples) for trial in trials]
    began_s = time.monotonic()
    # Not forked: this process has torch's threads.
    with multiprocessing.get_context("spawn").Pool() as pool:
        costs = pd.DataFrame(pool.map(run_trial, tasks, chunksize=4))
    names = [UNIFORM, *tables, TRUTH]
    finished = costs.dropna()
    print(f"{len(finished)} of {len(costs)} trials finished under all beliefs, {time.monotonic() - began_s:.0f} s")
    means = finished.groupby("size_class", sort=False)[names].mean()
    means.loc["all"] = finished[names].mean()
    print(f"\nmean cost in seconds\n{means.T.round(2).to_string()}")
    baseline = "frequency" if "frequency" in tables else UNIFORM
    print(f"\nsaving against {baseline} in percent, with its 95 % interval; trials better, equal, worse; p (Wilcoxon)")
    for belief in (name for name in names if name != baseline):
        found = compare(finished[belief].to_numpy(), finished[baseline].to_numpy(), list(finished["home_id"]))
        saved = found.improvement
        print(
            f"{belief:15} {saved.value:6.2f} ({saved.low:.2f} to {saved.high:.2f})   "
            f"{found.wins} {found.ties} {found.losses}   {found.p_value:.3g}"
        )


if __name__ == "__main__":
    main()
