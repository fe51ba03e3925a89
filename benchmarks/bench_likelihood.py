"""All likelihood models on one dataset: their metrics on seen and on unseen names, and how long each takes to train.

    python benchmarks/bench_likelihood.py [--rows datasets/rows/<hash>] [--kinds similarity paper_fcnn] [--seeds 5]

The folder is one that ``python -m pipeline.dataset`` made; without it, generated homes. With several seeds the
networks' rows are means, and their spread is printed.
"""

import argparse
import resource
import time
from dataclasses import replace
from pathlib import Path

import pandas as pd

from mrtask.homes.generator import generate_house
from mrtask.homes.procthor import parse_house
from mrtask.likelihood.dataset import Dataset, build_dataset, read_dataset
from mrtask.likelihood.embeddings import BUNDLED
from mrtask.likelihood.network import NetworkOptions
from mrtask.likelihood.training import (
    MODEL_KINDS,
    NETWORK_KINDS,
    TrainingOptions,
    score_unseen,
    train_model,
)

METRICS = ("roc_auc", "average_precision", "log_loss", "brier", "ece")
HOMES = {"train": 80, "validation": 20, "test": 50}
SMALL_LAYERS = (128, 64)


def generated_dataset() -> Dataset:
    """Rows of a hundred and fifty generated homes."""
    homes = [parse_house(generate_house(seed), None, "generated", seed) for seed in range(sum(HOMES.values()))]
    parts, start = {}, 0
    for split, number in HOMES.items():
        parts[split], start = homes[start : start + number], start + number
    return build_dataset(parts, source="generated", seed=0, code_version="bench")


def main() -> None:
    """Print one row per model, kind of names and metric."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=Path, help="the dataset's folder")
    parser.add_argument(
        "--kinds", nargs="+", choices=MODEL_KINDS, default=("similarity", "frequency", "logistic", "mlp")
    )
    parser.add_argument("--seeds", type=int, default=1, help="trainings of each network")
    parser.add_argument("--epochs", type=int, default=NetworkOptions().max_epochs)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--embedding", default=BUNDLED)
    parser.add_argument(
        "--unseen-networks", action="store_true", help="networks on unseen names too (5 more trainings)"
    )
    arguments = parser.parse_args()
    dataset = read_dataset(arguments.rows) if arguments.rows else generated_dataset()
    records = []
    for kind in arguments.kinds:
        for seed in range(arguments.seeds if kind in NETWORK_KINDS else 1):
            network = NetworkOptions(max_epochs=arguments.epochs, threads=arguments.threads, seed=seed)
            if kind == "mlp":
                network = replace(network, layers=SMALL_LAYERS)
            options = TrainingOptions(kind, embedding=arguments.embedding, network=network)
            began_s, began_cpu_s = time.monotonic(), time.process_time()
            trained = train_model(dataset, options)
            took = {"seconds": time.monotonic() - began_s, "cpu_seconds": time.process_time() - began_cpu_s}
            took |= {"epochs": len(trained.history)} if trained.history else {}
            found = {"seen names": trained.metrics["test"]}
            if kind not in NETWORK_KINDS or arguments.unseen_networks:
                found["unseen objects"] = score_unseen(dataset, options)
                found["unseen containers"] = score_unseen(dataset, options, "container")
            for names, metrics in found.items():
                record = {"model": kind, "names": names, "seed": seed, **{name: metrics[name] for name in METRICS}}
                records.append(record | (took if names == "seen names" else {}))
                print(", ".join(f"{k} {v:.4f}" if isinstance(v, float) else f"{k} {v}" for k, v in records[-1].items()))
    table = pd.DataFrame(records).drop(columns="seed").groupby(["names", "model"], sort=False)
    print(table.mean().round(4).to_string())
    if arguments.seeds > 1:
        print("spread over seeds (standard deviation)")
        print(table[list(METRICS)].std().dropna().round(5).to_string())
    print(f"lowest log loss possible on these test homes: {trained.metrics['test']['best_log_loss']:.4f}")
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


if __name__ == "__main__":
    main()
