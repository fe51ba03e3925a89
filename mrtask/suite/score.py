"""Score a planner on a frozen suite of trials and print its card beside our planners' results.

    mrtask score my_lab.Cautious
    mrtask score my_lab.Cautious options='{margin_s: 2}' suite=mrtask-1 workers=8 out=card/
    mrtask score my_lab.Cautious trials_per_cell=2            # a quick look, not a score

The planner is given by its import path or by a name of ours (pouct, greedy, ...), its options as YAML. The scores are
the same on any number of workers and on any machine; only planning times differ. ``out=`` keeps card.txt and
episodes.csv.
"""

import multiprocessing
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from tqdm import tqdm

from mrtask.errors import InputError, refuse
from mrtask.execution.episode import run_episode, warm_up
from mrtask.files import default_cache_dir
from mrtask.names import counted
from mrtask.planning.planners import make_planner
from mrtask.planning.warm_up import kernels_missing, mark_compiled
from mrtask.suite.card import planning_text, render_card
from mrtask.suite.frozen import DEFAULT_SUITE, Suite, load_suite
from mrtask.suite.recorded import recorded_episodes

COLUMNS = ("trial_id", "size_class", "robots", "template", "planner", "status", "cost_s", "decisions", "planning_s")
KEYS = ("options", "suite", "workers", "trials_per_cell", "out")
EPISODES_FILE, CARD_FILE = "episodes.csv", "card.txt"


@dataclass(frozen=True)
class Request:
    """The planner to score, and the suite."""

    planner: str
    options: Mapping[str, Any] = field(default_factory=dict)
    suite: str = DEFAULT_SUITE
    workers: int = 1
    trials_per_cell: int | None = None
    """Run only this many trials of each size class and team: a quick look, not a score."""
    out: Path | None = None

    @staticmethod
    def parse(arguments: list[str]) -> "Request":
        """Read the request from a command line. Raises `InputError`."""
        names = [argument for argument in arguments if "=" not in argument]
        if len(names) != 1:
            raise InputError(f"give one planner to score, not {', '.join(names) or 'none'}\n{__doc__}")
        values = dict(argument.split("=", 1) for argument in arguments if "=" in argument)
        if unknown := sorted(values.keys() - set(KEYS)):
            raise InputError(f"{unknown[0]}: no such key; allowed: {', '.join(KEYS)}")
        counts = {name: values[name] for name in ("workers", "trials_per_cell") if name in values}
        for name, value in counts.items():
            if not value.isdecimal() or int(value) < 1:
                raise InputError(f"{name}={value}: must be a whole number, at least 1")
        try:
            options = yaml.safe_load(values.get("options", "{}"))
        except yaml.YAMLError:
            options = None
        if not isinstance(options, dict):
            raise InputError(f"options={values['options']}: must be names and values, as options='{{samples: 1000}}'")
        out = Path(values["out"]) if "out" in values else None
        return Request(
            planner=names[0],
            options=options,
            suite=values.get("suite", DEFAULT_SUITE),
            workers=int(counts.get("workers", os.cpu_count() or 1)),
            trials_per_cell=int(counts["trials_per_cell"]) if "trials_per_cell" in counts else None,
            out=out,
        )

    def trial_numbers(self) -> list[int]:
        """Return the places of the trials in the suite."""
        trials, taken = load_suite(self.suite).trials, Counter[tuple[str, int]]()
        numbers = []
        for number, trial in enumerate(trials):
            cell = (trial.size_class, trial.team.robots)
            taken[cell] += 1
            if self.trials_per_cell is None or taken[cell] <= self.trials_per_cell:
                numbers.append(number)
        return numbers


def score_planner(request: Request, on_episode: Callable[[], None] | None = None) -> pd.DataFrame:
    """Run the planner; return `COLUMNS`, one row per trial in the suite's order.

    An exception in the planner becomes a row of status ``error``. Each trial has a new planner, so that no trial
    depends on another.
    """
    suite = load_suite(request.suite)
    planner = make_planner(request.planner, request.options)  # refuses wrong input before any work
    numbers = request.trial_numbers()
    rows: dict[int, dict[str, Any]] = {}
    first = suite.trials[0]
    # Compile once here, so that the workers find the kernels in numba's cache.
    warm_up(first, suite.homes[first.home_id], *_seen(suite, 0), planner)
    mark_compiled()
    if request.workers == 1:
        for number in numbers:
            rows[number] = _episode(request, number)
            if on_episode is not None:
                on_episode()
    else:
        # Not forked: numba's threads do not survive that. The caller's path, so that its planner is found.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(request.workers, context, _as_caller, (list(sys.path),)) as pool:
            waiting = {pool.submit(_episode, request, number): number for number in numbers}
            for done in as_completed(waiting):
                rows[waiting[done]] = done.result()
                if on_episode is not None:
                    on_episode()
    return pd.DataFrame([rows[number] for number in numbers], columns=list(COLUMNS))


def main(arguments: list[str]) -> int:
    """Run the command; return the exit code."""
    if {"-h", "--help"} & set(arguments):
        print(__doc__)
        return 0
    sys.path.insert(0, os.getcwd())
    try:
        request = Request.parse(arguments)
        suite = load_suite(request.suite)
        began_s = time.monotonic()
        if kernels_missing():
            print("the first plan compiles the planner, once for each version of the code", file=sys.stderr)
        with tqdm(total=len(request.trial_numbers()), desc=f"{request.planner} on {suite.name}", unit="trial") as bar:
            episodes = score_planner(request, bar.update)
        recorded = recorded_episodes(suite)
        recorded = recorded[recorded["trial_id"].isin(episodes["trial_id"])]
        home_of = {trial.trial_id: trial.home_id for trial in suite.trials}
        card = render_card(request.planner, request.options, episodes, recorded, suite.name, home_of)
        if len(episodes) < len(suite.trials):
            card += f"\n\nA look at {len(episodes)} of {len(suite.trials)} trials: not a score to quote."
    except (InputError, ValueError) as error:
        return refuse(error)
    print(f"{card}\n\n{planning_text(episodes)}")
    print(f"{time.monotonic() - began_s:.0f} s on {counted(request.workers, 'worker')}")
    if request.out is not None:
        request.out.mkdir(parents=True, exist_ok=True)
        (request.out / CARD_FILE).write_text(card + "\n", encoding="utf-8")
        episodes.to_csv(request.out / EPISODES_FILE, index=False)
        print(f"-> {request.out}")
    return 0


@cache
def _map_cache() -> Path:
    return default_cache_dir() / "maps"


def _seen(suite: Suite, number: int) -> tuple[Any, Any]:
    """Return the map and the likelihoods of a trial."""
    trial = suite.trials[number]
    return (
        suite.map_of(trial.home_id, _map_cache()),
        suite.table.matrix(suite.homes[trial.home_id], trial.objects),
    )


def _episode(request: Request, number: int) -> dict[str, Any]:
    suite = load_suite(request.suite)
    trial = suite.trials[number]
    home_map, likelihood = _seen(suite, number)
    row: dict[str, Any] = {
        "trial_id": trial.trial_id,
        "size_class": trial.size_class,
        "robots": trial.team.robots,
        "template": trial.template,
        "planner": request.planner,
    }
    try:
        planner = make_planner(request.planner, request.options)
        result = run_episode(trial, suite.homes[trial.home_id], home_map, likelihood, planner, request.planner)
    except Exception as error:  # a planner's bug is its score
        print(f"{trial.trial_id}: {type(error).__name__}: {error}", file=sys.stderr)
        return row | {"status": "error", "cost_s": None, "decisions": 0, "planning_s": float("nan")}
    return row | {name: getattr(result, name) for name in ("status", "cost_s", "decisions", "planning_s")}


def _as_caller(path: list[str]) -> None:
    sys.path[:] = path


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
