"""Keeps count of the episodes so far for the progress line, and notices when too many of them fail."""

from collections import defaultdict
from collections.abc import Sequence

from mrtask.planning.planners import Role, planners_with_role
from pipeline.base.config import UserError
from pipeline.store.episode_row import EpisodeRow

BASELINE = planners_with_role(Role.BASELINE)[0]
PLANNER = planners_with_role(Role.OURS)[0]
MIN_EPISODES_TO_JUDGE = 20
"""From this many episodes on, the share of failures counts."""


class Tally:
    """The failures, and how much the main planner saves against the baseline on trials that both have finished."""

    def __init__(self, planners: Sequence[str], max_failed_fraction: float) -> None:
        self._pair = (BASELINE, PLANNER) if {BASELINE, PLANNER} <= set(planners) else (planners[0], planners[-1])
        self._max_failed_fraction = max_failed_fraction
        self._costs_s: defaultdict[str, dict[str, float]] = defaultdict(dict)
        self._sums_s = dict.fromkeys(self._pair, 0.0)
        self._episodes = self._failed = 0
        self.last_error = ""

    def add(self, row: EpisodeRow) -> None:
        """Count a row.

        Raises:
            UserError: more episodes than allowed ended with an exception or a timeout.
        """
        self._episodes += 1
        if row.status in ("error", "timeout"):
            self._failed += 1
            reason = (row.error or row.status).strip().splitlines()[-1]
            self.last_error = f"{row.trial_id} by {row.planner}: {reason}"
            if self._episodes >= MIN_EPISODES_TO_JUDGE and self._failed > self._max_failed_fraction * self._episodes:
                raise UserError(
                    f"{self._failed} of {self._episodes} episodes failed, more than evaluation.max_failed_fraction="
                    f"{self._max_failed_fraction:g}; the rows so far are kept. The last one said:\n{row.error}"
                )
        elif row.planner in self._sums_s and row.cost_s is not None:
            costs_s = self._costs_s[row.trial_id]
            costs_s[row.planner] = row.cost_s
            if len(costs_s) == len(self._sums_s):
                for name, cost_s in self._costs_s.pop(row.trial_id).items():
                    self._sums_s[name] += cost_s

    @property
    def saved(self) -> float | None:
        """Which part of the baseline's cost the planner saves; None while no trial has both."""
        baseline, planner = self._pair
        if baseline == planner or not self._sums_s[baseline]:
            return None
        return 1 - self._sums_s[planner] / self._sums_s[baseline]

    def note(self, workers: str = "") -> str:
        """Return the note: ``8 workers, pouct 31% better than nonlearned_myopic, 2 failed``."""
        baseline, planner = self._pair
        parts = [workers] if workers else []
        if (saved := self.saved) is not None:
            parts.append(f"{planner} {abs(saved):.0%} {'better' if saved >= 0 else 'worse'} than {baseline}")
        if self._failed:
            parts.append(f"{self._failed} failed")
        return ", ".join(parts)
