"""Make the file of a frozen suite: newly drawn homes and trials, the default model's likelihoods, all path lengths.

    python benchmarks/freeze_suite.py mrtask-2 --seed 2

A published suite is never made again; a new suite gets a new name. Its sha256 goes into
``mrtask/suite/frozen.py``, its scores come from ``benchmarks/record_scores.py``.
"""

import argparse
from pathlib import Path

from mrtask.execution.trials import home_order, sample_trial
from mrtask.homes.generator.homes import generate_home
from mrtask.homes.home import SIZE_CLASSES
from mrtask.likelihood.options import TrainingOptions
from mrtask.likelihood.table import build_table
from mrtask.likelihood.training import fit_on_homes
from mrtask.maps.cache import cached_map
from mrtask.suite.frozen import write_suite

FOLDER = Path(__file__).resolve().parents[1] / "mrtask" / "suite"
HOMES_PER_CLASS = 15
TRIALS_PER_CELL = 20
ROBOTS = (1, 2, 3)
TRAINING_HOMES = 150
SEEDS_APART = 1_000_000
"""The distance between the generator's seeds for evaluation homes and for training homes, and between suites."""


def main() -> None:
    """Freeze a suite."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name")
    parser.add_argument("--seed", type=int, required=True)
    options = parser.parse_args()
    first = options.seed * 2 * SEEDS_APART
    homes = [generate_home(first + number, size) for size in SIZE_CLASSES for number in range(HOMES_PER_CLASS)]
    maps = {home.id: cached_map(home, None) for home in homes}
    trials = []
    for size in SIZE_CLASSES:
        for robots in ROBOTS:
            order = home_order(homes, size, robots, options.seed)
            trials += [
                sample_trial(size, robots, number, order, lambda home: maps[home.id], seed=options.seed)
                for number in range(TRIALS_PER_CELL)
            ]
    seen = {home.id for home in homes}
    learned = [generate_home(first + SEEDS_APART + number) for number in range(TRAINING_HOMES)]
    model = fit_on_homes([home for home in learned if home.id not in seen], options=TrainingOptions(kind="similarity"))
    path = FOLDER / f"{options.name}.json.gz"
    print(f'"{options.name}": "{write_suite(path, options.name, homes, trials, build_table(model, homes))}"')
    print(f"{path}: {path.stat().st_size} bytes, {len(homes)} homes, {len(trials)} trials")


if __name__ == "__main__":
    main()
