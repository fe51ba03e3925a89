"""What a wrong prior costs, and what a belief that learns in the home wins back, task by task.

Ten tasks in each home, whose contents are those of ProcTHOR or of people; the prior is uniform or learned from homes
with either contents; the belief adapts or not. All arms run the same trials. Prints mean costs, what adapting changes
with a 95 % bootstrap interval over homes, and the log loss of what the team believed of its objects.

    python benchmarks/bench_belief.py --files a.jsonl.gz b.jsonl.gz --assets asset-database.json --votes data.npy
"""

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd

from mrtask.execution.episode import run_episode
from mrtask.execution.trials import TrialOptions, home_order, sample_trial
from mrtask.files import default_cache_dir
from mrtask.homes.home import Home
from mrtask.homes.procthor import read_houses
from mrtask.homes.receptacles import BUNDLED_TABLE
from mrtask.likelihood.adapt import AdaptOptions, Sighting, adapted, sightings_of
from mrtask.likelihood.embeddings import BUNDLED
from mrtask.likelihood.model import clip_probs
from mrtask.likelihood.options import TrainingOptions
from mrtask.likelihood.rows import distinct_triples, label_rows, vocabulary
from mrtask.likelihood.table import LikelihoodTable, build_table
from mrtask.likelihood.training import fit
from mrtask.maps.cache import cached_map
from pipeline.store.voted_contents import VotedContents

TASKS = 10
RESAMPLES = 2000

Parts = tuple[Sequence[Home], Sequence[Home]]
"""Homes to learn a prior from, and to run tasks in."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=Path, nargs="+", required=True)
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--votes", type=Path, required=True)
    parser.add_argument("--train", type=int, default=150)
    parser.add_argument("--homes", type=int, default=8, help="homes of each size class")
    parser.add_argument("--classes", nargs="+", default=["small", "medium", "large"])
    parser.add_argument("--robots", type=int, default=1)
    parser.add_argument("--planner", default="pouct")
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--kind-sd", type=float, default=AdaptOptions.kind_sd)
    parser.add_argument("--object-sd", type=float, default=AdaptOptions.object_sd)
    parser.add_argument("--out", type=Path, default=Path("bench_belief.csv"))
    given = parser.parse_args()
    options = AdaptOptions(given.kind_sd, given.object_sd, 0.0)  # contents stay where they are here
    homes = shuffled(read_houses(given.files, given.assets, lambda error: None))
    train, rest = homes[: given.train], homes[given.train :]
    test = [home for name in given.classes for home in [h for h in rest if h.size_class == name][: given.homes]]
    people = VotedContents(
        file=given.votes, splits=None, objects="all", table=BUNDLED_TABLE, misplaced=0.1, seed=0, embedding=BUNDLED
    )  # fmt: skip
    contents = {"procthor": (train, test), "human": tuple(map(people.furnish, (train, test)))}
    rows: list[dict[str, object]] = []
    for name, (_, evaluated) in contents.items():
        for prior, table in priors(contents, evaluated).items():
            for size_class in given.classes:
                order = home_order(evaluated, size_class, given.robots, 0)
                for number in range(len(order)):
                    for adapts in (False, True):
                        chain = run_chain(given, order, size_class, number, table, options if adapts else None)
                        rows += [row | {"contents": name, "prior": prior, "adapts": adapts} for row in chain]
                pd.DataFrame(rows).to_csv(given.out, index=False)
            print(summary(pd.DataFrame(rows).query("contents == @name and prior == @prior")), flush=True)


def shuffled(homes: object) -> list[Home]:
    distinct = sorted({home.id: home for home in homes}.values(), key=lambda home: home.id)  # type: ignore[attr-defined]
    return [distinct[index] for index in np.random.default_rng(0).permutation(len(distinct))]


def priors(
    contents: Mapping[str, tuple[Sequence[Home], Sequence[Home]]], evaluated: Sequence[Home]
) -> dict[str, LikelihoodTable]:
    """Uniform (the mean share of all rows), and what a similarity model says that learned from either contents."""
    tables = {}
    for name, (train, _) in contents.items():
        objects = vocabulary(train)
        triples = distinct_triples(pd.concat([label_rows(home, objects) for home in train], ignore_index=True))
        model, _ = fit(triples, triples.head(0), TrainingOptions(kind="similarity"))
        tables[name] = build_table(model, evaluated)
    own = tables["procthor"]
    share = np.mean([len(container.objects) for home in evaluated for container in home.containers])
    uniform = np.full_like(own.probs, share / len(own.objects))
    return {"uniform": replace(own, probs=clip_probs(uniform)), **tables}


def run_chain(
    given: argparse.Namespace,
    order: list[Home],
    size_class: str,
    number: int,
    table: LikelihoodTable,
    options: AdaptOptions | None,
) -> list[dict[str, object]]:
    maps = default_cache_dir() / "maps"
    seen: list[Sighting] = []
    rows = []
    for task in range(TASKS):
        trial = sample_trial(
            size_class, given.robots, number * TASKS + task, order, lambda home: cached_map(home, maps, 0.1),
            seed=0, options=TrialOptions(tasks_per_home=TASKS),
        )  # fmt: skip
        home = next(home for home in order if home.id == trial.home_id)
        names = tuple(dict.fromkeys([*trial.objects, *(sighting.object for sighting in seen)]))
        belief = table.matrix(home, names)
        if options is not None:
            belief = adapted(belief, names, home.container_kinds(), seen, task, options)
        belief = belief[:, : len(trial.objects)]
        held = np.array([[name in container.objects for name in trial.objects] for container in home.containers])
        planner_options = {"samples": given.samples} if given.planner.startswith("pouct") else {}
        result = run_episode(trial, home, cached_map(home, maps, 0.1), belief, given.planner, planner_options)
        seen += sightings_of(home, task, result.searched, trial.objects)
        loss = -np.where(held, np.log(belief), np.log1p(-belief)).mean()
        rows.append(
            {"size_class": size_class, "home": home.layout_id, "task": task, "cost_s": result.cost_s, "log_loss": loss}
        )
    return rows


def summary(rows: pd.DataFrame) -> str:
    """Means, and what adapting changes from the second task on, by size class."""
    lines = []
    for size_class, part in rows[rows["task"] > 0].groupby("size_class", sort=False):
        per_home = part.pivot_table(index="home", columns="adapts", values=["cost_s", "log_loss"])
        saved = (per_home["cost_s"][True] - per_home["cost_s"][False]).to_numpy()
        draws = np.random.default_rng(0).choice(saved, (RESAMPLES, len(saved))).mean(axis=1)
        means = per_home.mean()
        lines.append(
            f"{part['contents'].iloc[0]:9} prior {part['prior'].iloc[0]:9} {size_class:7}"
            f" {means['cost_s', False]:7.1f} s, adapting {means['cost_s', True]:7.1f} s"
            f" ({saved.mean():+.1f} [{np.quantile(draws, 0.025):+.1f}, {np.quantile(draws, 0.975):+.1f}]);"
            f" log loss {means['log_loss', False]:.3f} -> {means['log_loss', True]:.3f}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
