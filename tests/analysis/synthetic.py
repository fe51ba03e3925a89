"""Made-up episodes with known effects, and a naive twin of the statistics."""

import json
from collections.abc import Iterable, Sequence
from fractions import Fraction
from statistics import NormalDist

import numpy as np
import pandas as pd

FACTORS = {
    "nonlearned_myopic": 1.6,
    "learned_myopic": 1.3,
    "greedy": 1.05,
    "pouct_paper": 1.1,
    "pouct": 0.9,
    "known": 0.6,
}
BASE_S = {"small": 12.0, "medium": 28.0, "large": 50.0}


def make_episodes(
    trials: int = 12,
    planners: Sequence[str] = tuple(FACTORS),
    size_classes: Sequence[str] = tuple(BASE_S),
    robots: Sequence[int] = (1, 2, 3),
    seed: int = 0,
) -> pd.DataFrame:
    """Accepted episodes whose costs are, on average, proportional to the planners' factors."""
    rng = np.random.default_rng(seed)
    records = []
    for size_class in size_classes:
        for team in robots:
            for number in range(trials):
                cost_s = BASE_S.get(size_class, 20.0) / team**0.6 * rng.gamma(4, 0.25)
                for planner in planners:
                    own_s = cost_s * FACTORS.get(planner, 1.0) * rng.lognormal(0, 0.15)
                    records.append(
                        {
                            "trial_id": f"{size_class}-{team}-{number:03d}",
                            "home_id": f"home-{size_class}-{team}-{number}",
                            "size_class": size_class,
                            "robots": team,
                            "template": "and2",
                            "formula": "F Mug & F Book",
                            "objects": json.dumps(["Mug", "Book"]),
                            "planner": planner,
                            "status": "accepted",
                            "cost_s": own_s,
                            "cost_cells": own_s * 20,
                            "decisions": int(rng.integers(1, 20)),
                            "planning_s": rng.lognormal(-3, 1),
                            "samples": 100,
                            "error": None,
                        }
                    )
    return pd.DataFrame(records)


def rows(size_class: str, robots: int, costs: dict[str, Sequence[float | None]]) -> pd.DataFrame:
    """Episodes of one cell from ``planner -> cost of trial 0, 1, ...``; None is a failed one."""
    return pd.DataFrame(
        [
            {
                "trial_id": f"{size_class}-{robots}-{number:03d}",
                "size_class": size_class,
                "robots": robots,
                "planner": planner,
                "status": "failed" if cost is None else "accepted",
                "cost_s": cost,
                "cost_cells": None if cost is None else cost * 20,
                "error": "Mug is in no reachable container" if cost is None else None,
            }
            for planner, values in costs.items()
            for number, cost in enumerate(values)
        ]
    )


def in_homes(episodes: pd.DataFrame, times: int) -> pd.DataFrame:
    """Each trial ``times`` times, every time in the same home: no more is known than from one time."""
    homes = episodes["home_id"] if "home_id" in episodes.columns else "home of " + episodes["trial_id"]
    copies = [
        episodes.assign(trial_id=episodes["trial_id"] + f"{number:03d}", home_id=homes) for number in range(times)
    ]
    return pd.concat(copies, ignore_index=True)


def fail(frame: pd.DataFrame, chosen: pd.Series, status: str = "failed", error: str = "why") -> pd.DataFrame:
    """A copy of the frame in which the chosen episodes end with another status."""
    frame = frame.copy()
    frame.loc[chosen, ["status", "error"]] = [status, error]
    frame.loc[chosen, ["cost_s", "cost_cells"]] = np.nan
    return frame


def naive_bca(
    cost: Sequence[float],
    baseline: Sequence[float],
    resamples: int,
    seed: int,
    groups: Sequence[Sequence[int]] | None = None,
) -> tuple[float, float]:
    """The BCa interval of ``100 (1 - mean / mean)`` in exact fractions, from what the library draws.

    It draws groups of trials, by default single ones.
    """
    groups = groups or [[trial] for trial in range(len(cost))]
    costs, baselines = list(map(Fraction, cost)), list(map(Fraction, baseline))

    def improvement(chosen: Iterable[int]) -> Fraction:
        chosen = [trial for group in chosen for trial in groups[group]]
        return 100 * (1 - sum(costs[i] for i in chosen) / sum(baselines[i] for i in chosen))

    n, normal = len(groups), NormalDist()
    drawn = np.random.default_rng(seed).integers(n, size=(resamples, n)).tolist()
    values = [improvement(chosen) for chosen in drawn]
    whole = improvement(range(n))
    below = sum(value < whole for value in values) + sum(value <= whole for value in values)
    bias = normal.inv_cdf(below / (2 * resamples))
    without = [improvement(i for i in range(n) if i != out) for out in range(n)]
    deviations = [float(sum(without) / n - value) for value in without]
    acceleration = sum(d**3 for d in deviations) / (6 * sum(d**2 for d in deviations) ** 1.5)
    levels = []
    for level in (0.025, 0.975):
        z = bias + normal.inv_cdf(level)
        levels.append(normal.cdf(bias + z / (1 - acceleration * z)))
    low, high = np.quantile([float(value) for value in values], levels)
    return float(low), float(high)
