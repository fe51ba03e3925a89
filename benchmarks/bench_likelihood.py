"""Compare all likelihood models in one table: on names seen in training and on names held out, with time and memory.

    python benchmarks/bench_likelihood.py
    python benchmarks/bench_likelihood.py --homes a.jsonl.gz b.jsonl.gz --assets asset-database.json --seeds 5
    python benchmarks/bench_likelihood.py --homes ... --votes data.npy

The homes are those of ``--homes``, or else generated: 500 for training, 50 for early stopping, the rest for testing,
split as ``homes=procthor`` splits them. With votes, the models are also compared on the same homes with people's
contents. To hold names out, each of five parts of the object types, and of the container types, is predicted by a model
that was trained without it. Each training has a process of its own. Networks get the mean and standard deviation over
several seeds; models that depend on no seed are trained once.
"""

import argparse
import multiprocessing
import resource
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from mrtask.homes.generator.house import generate_house
from mrtask.homes.home import SIZE_CLASSES, Home
from mrtask.homes.procthor import parse_house, read_houses
from mrtask.homes.receptacles import BUNDLED_TABLE
from mrtask.homes.split import HomeSplit, split_homes
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.kinds import KINDS
from mrtask.likelihood.options import BUNDLED, PAPER_LAYERS, NetworkOptions, TrainingOptions
from mrtask.likelihood.rows import SPLITS, count_triples, vocabulary
from mrtask.likelihood.training import fit, score, score_unseen
from pipeline.store.voted_contents import VotedContents

HOMES = {"train": 500, "validation": 50, "test": 300}
SPLIT_SALT = "0"
"""The pipeline's seed for homes, so that both split the same files in the same way."""
SMALL_LAYERS = (128, 64)
ORDER = ("frequency", "logistic", "similarity", "mlp", "paper_fcnn")
SEEN_METRICS = ("roc_auc", "average_precision", "log_loss", "brier", "ece")
UNSEEN_METRICS = ("log_loss", "roc_auc")


Triples = Mapping[str, pd.DataFrame]
"""Distinct triples with counts, by split."""


@dataclass(frozen=True)
class Job:
    """One training on one data set, and whether names are held out as well."""

    data: str
    kind: str
    seed: int
    unseen: bool
    threads: int
    embedding: str


def generated_homes() -> list[Home]:
    """Generate as many homes as a default run, a third of them in each size class."""
    with multiprocessing.Pool() as pool:
        return pool.map(_generated_home, range(sum(HOMES.values())), chunksize=10)


def _generated_home(number: int) -> Home:
    house = generate_house(number, SIZE_CLASSES[number % len(SIZE_CLASSES)])
    return parse_house(house, None, "generated", number)


def triples_of(homes: Sequence[Home], by_split: HomeSplit) -> Triples:
    """Count the homes' triples by split, for the objects of the training homes; ``homes`` are in the split's order."""
    by_id = dict(zip([*by_split.train, *by_split.validation, *by_split.test], homes, strict=True))
    parts = {name: [by_id[home_id] for home_id in getattr(by_split, name)] for name in SPLITS}
    objects = vocabulary(parts["train"])
    return {name: count_triples(members, objects) for name, members in parts.items()}


def measure(task: tuple[Job, Triples]) -> dict[str, object]:
    """Train and score a model, and measure time and memory."""
    job, triples = task
    layers = SMALL_LAYERS if job.kind == "mlp" else PAPER_LAYERS
    network = NetworkOptions(layers=layers, threads=job.threads, seed=job.seed, device="cpu")
    options = TrainingOptions(job.kind, embedding=job.embedding, network=network)
    began_s, began_cpu_s = time.monotonic(), time.process_time()
    model, _ = fit(triples["train"], triples["validation"], options)
    took = {"seconds": time.monotonic() - began_s, "cpu_seconds": time.process_time() - began_cpu_s}
    metrics = score(model, triples["test"])
    found: dict[str, object] = {name: metrics[name] for name in SEEN_METRICS}
    if job.unseen:
        for column in ("object", "container"):
            metrics = score_unseen(triples, options, column)
            found |= {f"unseen {column}: {name}": metrics[name] for name in UNSEEN_METRICS}
    peak_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return {"data": job.data, "model": job.kind, "seed": job.seed, **found, **took, "peak_gib": peak_gib}


def jobs(data: Sequence[str], arguments: argparse.Namespace) -> Iterator[Job]:
    """List every model on every data set; networks with every seed."""
    for name in data:
        for kind in (kind for kind in ORDER if kind in arguments.kinds):
            for seed in range(arguments.seeds if kind in ("paper_fcnn", "mlp") else 1):
                unseen = seed < arguments.unseen_seeds
                yield Job(name, kind, seed, unseen, arguments.threads, arguments.embedding)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--homes", nargs="+", type=Path, default=[], help="house files in ProcTHOR's schema")
    parser.add_argument("--assets", type=Path, help="ProcTHOR's asset database")
    parser.add_argument("--votes", type=Path, help="Housekeep's data.npy, or votes of your own in its format")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--seeds", type=int, default=5, help="trainings of each network")
    parser.add_argument("--unseen-seeds", type=int, default=1, help="of those, how many with names held out (10 more)")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="trainings at once")
    parser.add_argument("--embedding", default=BUNDLED)
    arguments = parser.parse_args()

    began_s = time.monotonic()
    homes = list(read_houses(arguments.homes, arguments.assets)) if arguments.homes else generated_homes()
    by_id = {home.id: home for home in homes}
    by_split = split_homes(by_id, HOMES["train"], HOMES["validation"], None, SPLIT_SALT)
    homes = [by_id[home_id] for name in SPLITS for home_id in getattr(by_split, name)]
    data = {"ProcTHOR's contents": triples_of(homes, by_split)}
    if arguments.votes:
        contents = VotedContents(
            file=arguments.votes, splits=None, objects="all", table=BUNDLED_TABLE,
            misplaced=0.1, seed=0, embedding=BUNDLED,
        )  # fmt: skip
        data["people's contents"] = triples_of(contents.furnish(homes), by_split)
    print(f"homes and counts: {time.monotonic() - began_s:.0f} s", flush=True)
    tasks = [(job, data[job.data]) for job in jobs(list(data), arguments)]
    records = []
    # Each in a fresh process, so that its peak memory is its own.
    with multiprocessing.get_context("spawn").Pool(arguments.jobs, maxtasksperchild=1) as pool:
        for record in pool.imap(measure, tasks, chunksize=1):
            records.append(record)
            print(", ".join(f"{k} {v:.4f}" if isinstance(v, float) else f"{v}" for k, v in record.items()), flush=True)
    table = pd.DataFrame(records).drop(columns="seed").groupby(["data", "model"], sort=False)
    pd.set_option("display.width", 250)
    print(f"\nmean over seeds\n{table.mean().round(4).to_string()}")
    if arguments.seeds > 1:
        measured = [name for name in records[0] if name.startswith(("unseen", *SEEN_METRICS))]
        print(f"\nstandard deviation over seeds\n{table[measured].std().dropna().round(5).to_string()}")
    for name, triples in data.items():
        best = score(FrequencyModel(triples["train"]), triples["test"])["best_log_loss"]
        print(f"lowest log loss possible on the {name} test homes: {best:.4f}")


if __name__ == "__main__":
    main()
