"""Whether teams wait and go on as in the paper's examples (its Figs. 4 to 6), read from the traces of ordered tasks.

*Waits*: a robot stands at a container until a teammate has interacted with something, and then interacts there. *Goes
on*: a robot searches elsewhere after it saw an object that the task needs, and that object is used only later. Both
show only where a task has an order and a team has several robots.
"""

from dataclasses import dataclass
from itertools import takewhile

import pandas as pd

from mrtask.execution.trace import Letter, Trace

MIN_WAIT_S = 0.5
"""Shorter waits are rounding errors, or a robot that arrived at the same time as its teammate."""
ORDER = " U "
"""The operator by which a formula orders interactions."""


@dataclass(frozen=True)
class Coordination:
    """How often one planner's teams wait and go on."""

    episodes: int
    """Accepted episodes of ordered tasks with several robots whose traces were read."""
    eligible: int
    """All such episodes of the run."""
    waits: tuple[str, ...]
    """The trials in which a robot waits."""
    goes_on: tuple[str, ...]
    """The trials in which a robot goes on."""


def coordination(rows: pd.DataFrame, planner: str) -> Coordination | None:
    """The planner's coordination by its traces; None if no episode could show any."""
    if not {"trace", "formula"} <= set(rows.columns):
        return None
    ordered = rows["formula"].fillna("").astype(str).str.contains(ORDER, regex=False)
    eligible = rows[(rows["planner"] == planner) & (rows["status"] == "accepted") & (rows["robots"] > 1) & ordered]
    own = eligible[eligible["trace"].notna()]
    if own.empty:
        return None
    traces = {str(trial): Trace.from_json(text) for trial, text in zip(own["trial_id"], own["trace"], strict=True)}
    return Coordination(
        episodes=len(traces),
        eligible=len(eligible),
        waits=tuple(trial for trial, trace in traces.items() if any(_waited(trace, one) for one in trace.letters)),
        goes_on=tuple(trial for trial, trace in traces.items() if any(_went_on(trace, one) for one in trace.letters)),
    )


def _waited(trace: Trace, letter: Letter) -> bool:
    """Whether the letter's robot stood there waiting while a teammate interacted."""
    before = [leg for leg in trace.robots[letter.robot] if leg.t0_s < letter.t_s]
    stay = list(takewhile(lambda leg: leg.kind != "move", reversed(before)))
    waits = [leg for leg in stay if leg.kind == "wait"]
    if sum(leg.t1_s - leg.t0_s for leg in waits) < MIN_WAIT_S:
        return False
    since_s = min(leg.t0_s for leg in waits)
    return any(other.robot != letter.robot and since_s < other.t_s <= letter.t_s for other in trace.letters)


def _went_on(trace: Trace, letter: Letter) -> bool:
    """Whether a robot that had searched the letter's container searched another one before the interaction."""
    for legs in trace.robots:
        searches = [leg for leg in legs if leg.kind == "search" and leg.t1_s < letter.t_s - MIN_WAIT_S]
        seen = [index for index, leg in enumerate(searches) if leg.container == letter.container]
        if seen and any(leg.container != letter.container for leg in searches[seen[0] + 1 :]):
            return True
    return False
