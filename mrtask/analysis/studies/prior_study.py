"""Measure the value of a prior in a mission, from the episodes of several priors on the same trials.

An *arm* is a prior on homes with some contents, with or without a belief that learns from task to task in a home. Arms
with the same contents ran the same trials. Tasks of one home depend on each other, so intervals come from resampling
homes.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from mrtask.analysis.results.episodes import checked_episodes, size_classes_in_order
from mrtask.analysis.results.roles import main_planner
from mrtask.analysis.results.statistics import (
    EVERYTHING,
    UNDEFINED,
    Bootstrap,
    Cell,
    Estimate,
    improvement_of_means,
)
from mrtask.analysis.studies.calibration import Calibration, calibration, change, mean_loss
from mrtask.arrays import Floats

TRUTH = "truth"
CONTENTS_NAMES = {"procthor": "ProcTHOR", "housekeep": "people"}
PRIOR_NAMES = {"uniform": "uniform", "procthor": "ProcTHOR", "housekeep": "human", TRUTH: "true"}


@dataclass(frozen=True)
class ArmRows:
    """One arm: its episodes, and the beliefs of the main planner's team from `calibration.beliefs_of`."""

    contents: str
    prior: str
    adapts: bool
    episodes: pd.DataFrame
    beliefs: pd.DataFrame
    overrides: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Return the name of the prior in tables."""
        return PRIOR_NAMES[self.prior] + (", adapting" if self.adapts else "")


@dataclass(frozen=True)
class PriorStudy:
    """All arms, compared with others of the same contents; ``tasks`` is the number of successive ones in one home."""

    arms: tuple[ArmRows, ...]
    tasks: int
    planner: str
    home_of: Mapping[str, str] = field(repr=False)
    """The cell of each trial, and the number of its home there."""

    @staticmethod
    def of(arms: Sequence[ArmRows], tasks: int) -> "PriorStudy":
        """Return the study of these arms.

        Raises:
            ValueError: the episodes are not what `checked_episodes` demands, or a planner has no episodes.
        """
        for arm in arms:
            checked_episodes(arm.episodes)
        rows = pd.concat([arm.episodes for arm in arms])
        planner = main_planner(sorted(set(rows["planner"])))
        if planner is None:
            raise ValueError("there are no episodes; give those of at least one planner")
        home_of = {name: f"{cell}-{int(number) // tasks}" for name, cell, number in map(_parts, set(rows["trial_id"]))}
        return PriorStudy(tuple(arms), tasks, planner, home_of)

    @property
    def contents(self) -> list[str]:
        """Return all contents that homes have, in the order of the arms."""
        return list(dict.fromkeys(arm.contents for arm in self.arms))

    @property
    def cells(self) -> list[Cell]:
        """Return the size classes and team sizes, then everything together."""
        rows = pd.concat([arm.episodes[["size_class", "robots"]] for arm in self.arms]).drop_duplicates()
        teams = {(str(name), int(robots)) for name, robots in rows.itertuples(index=False)}
        classes = size_classes_in_order({name for name, _ in teams})
        return [*sorted(teams, key=lambda cell: (classes.index(cell[0]), cell[1])), EVERYTHING]

    def of_contents(self, contents: str) -> list[ArmRows]:
        """Return the arms with some contents."""
        return [arm for arm in self.arms if arm.contents == contents]

    def find(self, contents: str, prior: str, adapts: bool = False) -> ArmRows | None:
        """Return one arm, or None if it was not run."""
        wanted = (contents, prior, adapts)
        return next((arm for arm in self.arms if (arm.contents, arm.prior, arm.adapts) == wanted), None)

    def best(self, contents: str) -> ArmRows | None:
        """Return the arm to compare with: the true prior, or else the one learned from homes with the same contents."""
        return self.find(contents, TRUTH) or self.find(contents, contents)

    def pairs(self, contents: str) -> Iterator[tuple[ArmRows, ArmRows]]:
        """Yield each prior with adapting and without."""
        for arm in self.of_contents(contents):
            if arm.adapts and (without := self.find(contents, arm.prior)) is not None:
                yield arm, without

    def costs(self, arm: ArmRows, planner: str | None = None) -> pd.Series:
        """Return a planner's costs in seconds, by trial that it finished.

        By default, these are the main planner's.
        """
        rows = arm.episodes[(arm.episodes["planner"] == (planner or self.planner))]
        costs: pd.Series = rows[rows["status"] == "accepted"].set_index("trial_id")["cost_s"].astype(float)
        return costs

    def saved(self, after: pd.Series, before: pd.Series, trials: "pd.Series | None" = None) -> Estimate:
        """Return what ``after`` saves of ``before``'s mean cost, in percent.

        ``trials`` is a mask by trial; by default, all trials count.
        """
        both = pd.concat({"after": after, "before": before}, axis=1).dropna()
        if trials is not None:
            both = both[trials.reindex(both.index, fill_value=False)]
        return self._by_home(both, improvement_of_means)

    def above(self, costs: pd.Series, reference: pd.Series, trials: "pd.Series | None" = None) -> Estimate:
        """Return by how much the costs exceed the reference's, in percent."""
        return negative(self.saved(costs, reference, trials))

    def won_back(self, arm: ArmRows, without: ArmRows, cell: Cell) -> Estimate:
        """Return the share, in percent, of a prior's cost over the best one that adapting recovers."""
        best = self.best(arm.contents)
        if best is None or best is without:
            return UNDEFINED
        columns = {"arm": self.costs(arm), "without": self.costs(without), "best": self.costs(best)}
        table = pd.concat(columns, axis=1).dropna()
        return self._by_home(table[self.in_cell(table.index, cell)], _won_back)

    def in_cell(self, trials: pd.Index, cell: Cell) -> pd.Series:
        """Return which trials belong to a cell."""
        prefix = "" if cell == EVERYTHING else f"{cell[0]}-{cell[1]}-"
        return pd.Series([trial.startswith(prefix) for trial in trials], index=trials, dtype=bool)

    def of_task(self, trials: pd.Index, numbers: Sequence[int]) -> pd.Series:
        """Return which trials are one of these tasks in their home, counted from 0."""
        return pd.Series([int(_parts(trial)[2]) % self.tasks in numbers for trial in trials], index=trials, dtype=bool)

    def new_objects(self, arm: ArmRows) -> pd.Series:
        """Return the trials, after the first in their home, none of whose objects was requested there before."""
        rows = arm.episodes.drop_duplicates("trial_id").set_index("trial_id")["objects"]
        found = {}
        asked: dict[str, set[str]] = {}
        for trial in sorted(rows.index, key=lambda name: (self.home_of[name], int(_parts(name)[2]))):
            before = asked.setdefault(self.home_of[trial], set())
            found[trial] = bool(before) and not before & set(rows[trial])
            before |= set(rows[trial])
        return pd.Series(found, dtype=bool)

    def calibrated(self, arm: ArmRows, tasks: Sequence[int]) -> Calibration:
        """Return how good the beliefs at the beginning of these tasks were."""
        return calibration(arm.beliefs[arm.beliefs["task"].isin(tasks)], self.home_of)

    def loss(self, arm: ArmRows, name: str, task: int) -> Estimate:
        """Return a mean loss of the beliefs at the beginning of one task."""
        return mean_loss(arm.beliefs[arm.beliefs["task"] == task], name, self.home_of)

    def changed(
        self, arm: ArmRows, without: ArmRows, loss: str, tasks: Sequence[int], unseen: bool = False
    ) -> Estimate:
        """Return how adapting changes a mean loss of these tasks.

        ``unseen`` restricts it to pairs that the team had not seen before.
        """
        first, second = (one.beliefs[one.beliefs["task"].isin(tasks)] for one in (arm, without))
        if unseen:
            kept = ~first["seen"].to_numpy()
            first, second = first[kept], second[kept]
        return change(first, second, loss, self.home_of)

    def _by_home(self, costs: pd.DataFrame, statistic: Callable[[Floats], Floats]) -> Estimate:
        sums = costs.groupby([self.home_of[trial] for trial in costs.index]).sum().to_numpy(dtype=np.float64)
        return Bootstrap(sums).estimate(statistic)


def negative(estimate: Estimate) -> Estimate:
    """Return the estimate with its sign changed."""
    return Estimate(-estimate.value, -estimate.high, -estimate.low, estimate.n)


def _parts(trial: str) -> tuple[str, str, str]:
    cell, _, number = trial.rpartition("-")
    return trial, cell, number


def _won_back(means: Floats) -> Floats:
    """Return the share recovered, from means of the arm, of the prior without adapting and of the best prior.

    It is NaN if the prior costs nothing.
    """
    lost = means[..., 1] - means[..., 2]
    return np.asarray(np.where(lost > 0, 100 * (means[..., 1] - means[..., 0]) / lost, np.nan))
