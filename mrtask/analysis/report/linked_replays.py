"""The replays beside a report: a page for each trial worth a look, without the reasons, which would take a run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from mrtask.analysis.drawing.replay_content import Episode, make_replay
from mrtask.analysis.drawing.replay_page import render_replay
from mrtask.analysis.drawing.trajectories import Pick, task_objects
from mrtask.execution.trace import Trace
from mrtask.homes.home import Home
from mrtask.tasks.automaton import build_automaton


@dataclass(frozen=True)
class Replays:
    """The pages by trial, and why some trials have none: their rows hold a formula, or name a place, that is none."""

    pages: Mapping[str, str]
    unplayable: tuple[str, ...] = ()


def play(rows: pd.DataFrame, planners: Sequence[str], picks: Sequence[Pick], homes: Mapping[str, Home]) -> Replays:
    """Plays the trials whose home and traces are there, with these planners side by side."""
    if not {"trace", "template", "formula", "objects"} <= set(rows.columns):
        return Replays({})
    pages, unplayable = {}, []
    for pick in picks:
        of_trial = rows[(rows["trial_id"] == pick.trial_id) & rows["trace"].notna()]
        by_planner = {row["planner"]: row for row in of_trial.to_dict("records")}
        shown = [by_planner[name] for name in planners if name in by_planner]
        if not shown or pick.home_id not in homes:
            continue
        first = shown[0]
        try:
            automaton = build_automaton(first["formula"], task_objects(first["objects"]))
            episodes = [_episode(row) for row in shown]
            home = homes[pick.home_id]
            replay = make_replay(pick.trial_id, first["size_class"], first["template"], automaton, home, episodes)
        except ValueError as error:
            unplayable.append(f"Trial {pick.trial_id} cannot be replayed: {error}")
            continue
        pages[pick.trial_id] = render_replay(replay)
    return Replays(pages, tuple(unplayable))


def _episode(row: Mapping[Any, Any]) -> Episode:
    accepted = row["status"] == "accepted"
    return Episode(
        planner=row["planner"],
        status=row["status"],
        cost_s=row["cost_s"] if accepted else None,
        error=None if accepted else str(row.get("error") or ""),
        trace=Trace.from_json(row["trace"]),
    )
