"""Compare settings of a belief that learns in a home, by its log loss on homes that are used for nothing else.

Each validation home has ten tasks, once with ProcTHOR's contents and once with people's. The prior is learned from
training homes with either contents. No robot drives: in each task the containers are searched in the order of the
belief about the task's objects, until all are found. For each setting, print by how much adapting changes the log loss
of the belief from the second task on (given that an object is somewhere), with a 95 % interval over homes.

    python benchmarks/bench_belief.py --files a.jsonl.gz b.jsonl.gz --assets asset-database.json --votes data.npy
"""

import argparse
import os
from collections.abc import Sequence
from itertools import product
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mrtask.analysis.studies.calibration import Task, beliefs_of, calibration, change
from mrtask.homes.home import Home
from mrtask.homes.procthor import read_houses
from mrtask.homes.receptacles import BUNDLED_TABLE
from mrtask.homes.split import split_homes
from mrtask.likelihood.adapt import AdaptOptions, Sighting, adapted
from mrtask.likelihood.existence import given_existence
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.options import BUNDLED, TrainingOptions
from mrtask.likelihood.rows import count_triples, vocabulary
from mrtask.likelihood.table import LikelihoodTable, build_table
from mrtask.likelihood.training import fit
from pipeline.store.voted_contents import VotedContents

TASKS = 10
OBJECTS = (2, 3)
"""The number of objects in a task, as in most templates."""
HELD_OUT_EVERY = 10
SPLIT_SALT = "0"
"""The pipeline's seed for homes, so that both split the same files in the same way."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=Path, nargs="+", required=True)
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--votes", type=Path, required=True)
    parser.add_argument("--train", type=int, default=500)
    parser.add_argument("--validation", type=int, default=50)
    parser.add_argument("--kind-sd", type=float, nargs="+", default=[0.0, 0.25, 0.5, 1.0])
    parser.add_argument("--object-sd", type=float, nargs="+", default=[0.0, 0.5, 1.0, 1.5])
    parser.add_argument("--forget", type=float, nargs="+", default=[AdaptOptions.forget])
    given = parser.parse_args()
    by_id = {home.id: home for home in read_houses(given.files, given.assets, lambda error: None)}
    parts = split_homes(by_id, given.train, given.validation, None, SPLIT_SALT)
    train, validation = ([by_id[home_id] for home_id in ids] for ids in (parts.train, parts.validation))
    people = VotedContents(
        file=given.votes, splits=None, objects="all", table=BUNDLED_TABLE, misplaced=0.1, seed=0, embedding=BUNDLED
    )  # fmt: skip
    contents = {"people": (people.furnish(train), people.furnish(validation)), "ProcTHOR": (train, validation)}
    models = {name: learned(homes) for name, (homes, _) in contents.items()}
    settings = list(product(given.kind_sd, given.object_sd, given.forget))
    for (name, (_, homes)), (prior, model) in product(contents.items(), models.items()):
        table = build_table(model, homes)
        tasks = [tasks_in(home, number, table) for number, home in enumerate(homes)]
        before = beliefs(homes, tasks, table, None)
        home_of = {trial: trial.partition("-")[0] for trial in before["trial_id"].unique()}
        loss = calibration(before, home_of).losses["log_loss"].value
        print(f"contents of {name}, prior of {prior}: log loss {loss:.4f} without adapting", flush=True)
        for kind_sd, object_sd, forget in settings:
            after = beliefs(homes, tasks, table, AdaptOptions(kind_sd, object_sd, forget))
            changes = [
                change(after.loc[part], before.loc[part], "log_loss", home_of)
                for part in (before.index, ~before["seen"])
            ]
            text = ", of pairs not seen before ".join(f"{c.value:+.4f} [{c.low:+.4f}, {c.high:+.4f}]" for c in changes)
            print(f"  kind_sd {kind_sd:4} object_sd {object_sd:4} forget {forget:5}: {text}", flush=True)


def learned(homes: Sequence[Home]) -> LikelihoodModel:
    """Fit the prior; every tenth home decides how far the counts of the others are trusted."""
    held_out = homes[::HELD_OUT_EVERY]
    counted = [home for number, home in enumerate(homes) if number % HELD_OUT_EVERY]
    return fit(count_triples(counted), count_triples(held_out), TrainingOptions(kind="similarity"))[0]


def tasks_in(home: Home, number: int, table: LikelihoodTable) -> list[Task]:
    """Draw random objects of the home, and list the containers that are searched for them."""
    rng = np.random.default_rng(number)
    names = vocabulary([home])
    done = []
    for task in range(TASKS):
        count = min(int(rng.integers(OBJECTS[0], OBJECTS[1] + 1)), len(names))
        objects = tuple(str(name) for name in rng.choice(names, count, replace=False))
        missing, searched = set(objects), set()
        for index in np.argsort(-given_existence(table.matrix(home, objects)).sum(axis=1), kind="stable"):
            if missing:
                searched.add(home.containers[index].id)
                missing -= set(home.containers[index].objects)
        done.append(Task(f"{number}-{task}", objects, frozenset(searched)))
    return done


def beliefs(
    homes: Sequence[Home], tasks: Sequence[Sequence[Task]], table: LikelihoodTable, options: AdaptOptions | None
) -> pd.DataFrame:
    """Collect the beliefs from the second task on."""
    found = pd.concat(_beliefs_in(home, done, table, options) for home, done in zip(homes, tasks, strict=True))
    return found[found["task"] > 0].reset_index(drop=True)


def _beliefs_in(home: Home, done: Sequence[Task], table: LikelihoodTable, options: AdaptOptions | None) -> pd.DataFrame:
    def believe(task: Task, number: int, seen: Sequence[Sighting]) -> NDArray[np.float64]:
        if options is None:
            return table.matrix(home, task.objects)
        known = tuple(dict.fromkeys([*task.objects, *(sighting.object for sighting in seen)]))
        prior = table.matrix(home, known)
        return adapted(prior, known, home.container_kinds(), seen, number, options)[:, : len(task.objects)]

    return beliefs_of(home, done, believe)


if __name__ == "__main__":
    main()
