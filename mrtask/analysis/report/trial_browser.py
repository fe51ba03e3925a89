"""Trial by trial: a scatter whose points lead to their trials, and the trials that are worth a look.

The page holds the points, their names and the list of notable trials in plain HTML. The content behind a click
(outcomes, both paths on the floor plan) is packed beside them and unpacked by ``report.js``.
"""

import base64
import gzip
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from mrtask.analysis.drawing.floor_plans import ROOM_COLORS, passages, ways_out
from mrtask.analysis.drawing.replay_content import task_in_words
from mrtask.analysis.drawing.sheet import Sheet
from mrtask.analysis.drawing.trajectories import Pick, baseline_beside, instructive_trials, task_objects
from mrtask.analysis.page.style import planner_label
from mrtask.analysis.results.episodes import natural_key, size_classes_in_order
from mrtask.analysis.results.statistics import paired_costs
from mrtask.execution.trace import Trace
from mrtask.homes.home import Home
from mrtask.planning.planners import planners_in_order

WORST_LOSSES, FAILURES = 10, 10
MAX_MAPPED_TRIALS = 3000
"""In larger runs only the notable trials have a map, or the report would grow too large."""
PLOT_SIZE, PLOT_LEFT, PLOT_BOTTOM, PLOT_PAD = 520, 54, 40, 12
MAX_TICKS = 6
NEEDED = (
    *("trial_id", "home_id", "size_class", "robots", "template", "formula", "objects"),
    *("planner", "status", "cost_cells", "trace"),
)
"""The columns from which a click shows something."""
ROOM_INDEX = {name: index for index, name in enumerate(ROOM_COLORS)}


@dataclass(frozen=True)
class Point:
    """A trial in the scatter: its place in the packed list, where it is drawn, and its name."""

    index: int
    x: float
    y: float
    robots: int
    text: str


@dataclass(frozen=True)
class TrialBrowser:
    """What the section shows."""

    content: Mapping[str, Any]
    """All that a click shows, as ``report.js`` reads it; planners in the order of the tables."""
    compared: tuple[str, ...]
    """The full names of the planner and the baseline."""
    robots: tuple[int, ...]
    points: tuple[Point, ...]
    ticks: tuple[float, ...]
    """On both axes, in grid cells."""

    @property
    def packed(self) -> str:
        """The content as JSON, gzip, base64."""
        text = json.dumps(self.content, separators=(",", ":"), allow_nan=False)
        return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode("ascii")


def notable_trials(rows: pd.DataFrame, planner: str | None) -> list[Pick]:
    """The representative trials, the failures of the planner and its worst losses against the baseline beside it."""
    if planner is None or "home_id" not in rows.columns:
        return []
    baseline = baseline_beside(rows["planner"], planner)
    home_of = dict(zip(rows["trial_id"], rows["home_id"].astype(str), strict=True))
    picks = instructive_trials(rows.drop(columns="trace", errors="ignore"), planner, baseline)
    reasons = {pick.trial_id: pick.reason for pick in picks}
    for trial in rows.loc[(rows["planner"] == planner) & (rows["status"] == "failed"), "trial_id"].head(FAILURES):
        reasons.setdefault(trial, "failed")
    if baseline is not None:
        costs = paired_costs(rows)[[planner, baseline]].dropna()
        lost = (costs[planner] - costs[baseline]).sort_values(ascending=False, kind="stable")
        for trial, lost_s in lost[lost > 0].head(WORST_LOSSES).items():
            reasons.setdefault(str(trial), f"lost {lost_s:.1f} s")
    return [Pick(trial, home_of[trial], reason) for trial, reason in reasons.items()]


def compared_planners(rows: pd.DataFrame, planner: str | None) -> tuple[str, ...]:
    """The planner and the baseline beside it."""
    if planner is None:
        return ()
    beside = baseline_beside(rows["planner"], planner)
    return (planner, beside) if beside else (planner,)


def mapped_trials(rows: pd.DataFrame, planner: str | None) -> set[str]:
    """The trials that get a map: all of them unless they are too many."""
    trials = set(rows["trial_id"])
    return trials if len(trials) <= MAX_MAPPED_TRIALS else {pick.trial_id for pick in notable_trials(rows, planner)}


def browse_trials(
    rows: pd.DataFrame, planner: str | None, homes: Mapping[str, Home], replays: Collection[str] = ()
) -> TrialBrowser | None:
    """The section's content for one variant's rows; None where there is no episode.

    Args:
        replays: the trials that have a page of their own, ``replays/<trial>.html``.
    """
    if planner is None or rows.empty:
        return None
    compared = compared_planners(rows, planner)
    planners = planners_in_order(rows["planner"].unique())
    indices = [planners.index(name) for name in compared]
    templates = sorted(set(rows["template"].dropna().astype(str))) if "template" in rows.columns else []
    classes = size_classes_in_order(rows["size_class"].unique())
    drawn: dict[str, int] = {}
    by_trial = rows[[name for name in NEEDED if name in rows.columns]].groupby("trial_id")
    found = {str(trial_id): of_trial.to_dict("records") for trial_id, of_trial in by_trial}
    trials = [
        _trial(found[trial_id], planners, indices, templates, classes, drawn, homes)
        for trial_id in sorted(found, key=natural_key)
    ]
    top = max((cost for trial in trials for cost in trial["cost"] if cost is not None), default=0.0) * 1.04 or 1.0
    content = {
        "planners": list(map(planner_label, planners)),
        "names": list(planners),
        "compared": indices,
        "templates": templates,
        "classes": classes,
        "top": top,
        "plot": [PLOT_SIZE, PLOT_LEFT, PLOT_BOTTOM, PLOT_PAD],
        "homes": [_floor(homes[home_id]) for home_id in drawn],
        "replays": sorted(replays),
        "trials": trials,
    }
    teams = tuple(sorted({int(trial["robots"]) for trial in trials}))
    return TrialBrowser(content, compared, teams, _points(trials, indices, top), _ticks(top))


def place(cost_cells: float, top: float, upright: bool) -> float:
    """Where a cost stands on an axis, in the picture's units."""
    share = cost_cells / top
    span = PLOT_SIZE - PLOT_PAD - (PLOT_BOTTOM if upright else PLOT_LEFT)
    return round(PLOT_SIZE - PLOT_BOTTOM - share * span if upright else PLOT_LEFT + share * span, 1)


def _points(trials: Sequence[Mapping[str, Any]], compared: Sequence[int], top: float) -> tuple[Point, ...]:
    """One point for each trial that the planner and the baseline finished: across the baseline's cost, up its own."""
    if len(compared) < 2:
        return ()
    costs = [(index, trial, *(trial["cost"][planner] for planner in compared)) for index, trial in enumerate(trials)]
    return tuple(
        Point(
            index,
            place(other, top, False),
            place(own, top, True),
            trial["robots"],
            f"{trial['id']}: {own:.0f} against {other:.0f} cells",
        )
        for index, trial, own, other in costs
        if own is not None and other is not None
    )


def _ticks(top: float) -> tuple[float, ...]:
    """Round numbers from 0 up, six at most."""
    power = 10.0 ** np.floor(np.log10(top / MAX_TICKS))
    step = next(power * factor for factor in (1, 2, 5, 10) if top / (power * factor) <= MAX_TICKS)
    return tuple(float(value) for value in np.arange(0, top, step))


def _trial(
    found: Sequence[Mapping[Any, Any]],
    planners: Sequence[str],
    compared: Sequence[int],
    templates: Sequence[str],
    classes: Sequence[str],
    drawn: dict[str, int],
    homes: Mapping[str, Home],
) -> dict[str, Any]:
    first = next((row for row in found if isinstance(row.get("formula"), str)), found[0])
    by_planner = {row["planner"]: row for row in found}
    template = str(first.get("template"))
    formula = first["formula"] if isinstance(first.get("formula"), str) else ""
    home = homes.get(str(first.get("home_id")))
    traces = {index: by_planner.get(planners[index], {}).get("trace") for index in compared}
    paths = {
        str(index): _paths(Trace.from_json(trace), Sheet.of(home))
        for index, trace in traces.items()
        if home is not None and isinstance(trace, str)
    }
    return {
        "id": str(first["trial_id"]),
        "class": classes.index(first["size_class"]),
        "robots": int(first["robots"]),
        "template": templates.index(template) if template in templates else -1,
        "task": task_in_words(template, formula, task_objects(first.get("objects"))) if formula else "",
        "formula": formula,
        "cost": [_cost(by_planner.get(name)) for name in planners],
        "status": [str(by_planner[name]["status"]) if name in by_planner else "not run" for name in planners],
        "home": drawn.setdefault(home.id, len(drawn)) if home is not None and paths else -1,
        "paths": paths,
    }


def _cost(row: Mapping[Any, Any] | None) -> float | None:
    cost = float("nan") if row is None else float(row["cost_cells"])
    return round(cost, 1) if np.isfinite(cost) else None


def _paths(trace: Trace, sheet: Sheet) -> list[list[int]]:
    """For each robot its whole way as one line: x, y, x, y in centimetres of the picture."""
    lines = []
    for legs in trace.robots:
        points = [sheet.point(trace.start)]
        for leg in legs:
            points += [point for point in map(sheet.point, leg.path) if leg.kind == "move" and point != points[-1]]
        lines.append([coordinate for point in points for coordinate in point])
    return lines


def _floor(home: Home) -> dict[str, Any]:
    sheet = Sheet.of(home)
    return {
        "size": [sheet.width, sheet.height],
        "rooms": [[ROOM_INDEX.get(room.type, -1), sheet.points(room.polygon)] for room in home.rooms],
        "doors": [sheet.points(line) for line in passages(home)],
        "ways_out": [sheet.points(line) for line in ways_out(home)],
        "containers": [[one.type, sheet.points(one.footprint)] for one in home.containers],
    }
