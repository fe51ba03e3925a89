"""Trial by trial: a scatter whose points lead to their trials, and the trials that are worth a look.

The points, their names and the list of notable trials stand in the page; all that a click shows (outcomes, both paths
on the floor plan) is packed beside them and unpacked by ``report.js``.
"""

import base64
import gzip
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from mrtask.analysis.drawing.floor_plans import ROOM_COLORS
from mrtask.analysis.drawing.replay_content import task_in_words
from mrtask.analysis.drawing.sheet import Sheet
from mrtask.analysis.drawing.trajectories import Pick, baseline_beside, instructive_trials, task_objects
from mrtask.analysis.page.style import planner_label
from mrtask.analysis.results.episodes import natural_key, size_classes_in_order
from mrtask.analysis.results.statistics import paired_costs
from mrtask.execution.trace import Trace
from mrtask.homes.home import Home

WORST_LOSSES, FAILURES = 10, 10
MAX_MAPPED_TRIALS = 3000
"""Of larger runs only the notable trials have a map: the report would grow too large."""
PLOT_SIZE, PLOT_LEFT, PLOT_BOTTOM, PLOT_PAD = 520, 54, 40, 12
MAX_TICKS = 6
NEEDED = (
    *("trial_id", "home_id", "size_class", "robots", "template", "formula", "objects"),
    *("planner", "status", "cost_cells", "trace"),
)
"""The columns that a click shows something of."""
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

    planner: str
    baseline: str | None
    points: tuple[Point, ...]
    top: float
    """The axes' largest value, in grid cells."""
    ticks: tuple[float, ...]
    packed: str
    """Everything that a click shows: JSON, gzip, base64."""
    templates: tuple[str, ...]
    size_classes: tuple[str, ...]
    robots: tuple[int, ...]
    planners: tuple[str, ...]
    compared: tuple[str, ...]
    """The full names of the planner and the baseline."""


def notable_trials(rows: pd.DataFrame, planner: str | None) -> list[Pick]:
    """The representative trials, the failures of the planner and its worst losses against the baseline beside it."""
    if planner is None or "home_id" not in rows.columns:
        return []
    baseline = baseline_beside(rows["planner"], planner)
    picks = instructive_trials(rows.drop(columns="trace", errors="ignore"), planner, baseline)
    own = rows[rows["planner"] == planner]
    failed = own[own["status"] == "failed"].head(FAILURES)
    picks += [Pick(str(row["trial_id"]), str(row["home_id"]), "failed") for row in failed.to_dict("records")]
    if baseline is not None:
        costs = paired_costs(rows)[[planner, baseline]].dropna()
        lost = (costs[planner] - costs[baseline]).sort_values(ascending=False, kind="stable")
        home_of = dict(zip(rows["trial_id"], rows["home_id"].astype(str), strict=True))
        worst = lost[lost > 0].head(WORST_LOSSES)
        picks += [Pick(str(trial), home_of[str(trial)], f"lost {lost_s:.1f} s") for trial, lost_s in worst.items()]
    first: dict[str, Pick] = {}
    for pick in picks:
        first.setdefault(pick.trial_id, pick)
    return list(first.values())


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
    baseline = baseline_beside(rows["planner"], planner)
    planners = list(dict.fromkeys([planner, *([baseline] if baseline else []), *sorted(set(rows["planner"]))]))
    templates = sorted(set(rows["template"].dropna().astype(str))) if "template" in rows.columns else []
    classes = size_classes_in_order(rows["size_class"].unique())
    drawn: dict[str, int] = {}
    by_trial: dict[str, list[Mapping[Any, Any]]] = {}
    for row in rows[[name for name in NEEDED if name in rows.columns]].to_dict("records"):
        by_trial.setdefault(str(row["trial_id"]), []).append(row)
    trials = [
        _trial(by_trial[trial_id], planners, templates, classes, drawn, homes)
        for trial_id in sorted(by_trial, key=natural_key)
    ]
    costs = [cost for trial in trials for cost in trial["cost"] if cost is not None]
    top = max(costs, default=0.0) * 1.04 or 1.0
    content = {
        "planners": [planner_label(name) for name in planners],
        "names": planners,
        "templates": templates,
        "classes": classes,
        "top": top,
        "plot": [PLOT_SIZE, PLOT_LEFT, PLOT_BOTTOM, PLOT_PAD],
        "homes": [_floor(homes[home_id]) for home_id in drawn],
        "replays": sorted(replays),
        "trials": trials,
    }
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return TrialBrowser(
        planner=planner_label(planner),
        baseline=planner_label(baseline) if baseline else None,
        points=tuple(_points(trials, top)) if baseline else (),
        top=top,
        ticks=_ticks(top),
        packed=base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode("ascii"),
        templates=tuple(templates),
        size_classes=tuple(classes),
        robots=tuple(sorted({int(trial["robots"]) for trial in trials})),
        planners=tuple(planner_label(name) for name in planners),
        compared=(planner, *([baseline] if baseline else [])),
    )


def place(cost_cells: float, top: float, upright: bool) -> float:
    """Where a cost stands on an axis, in the picture's units."""
    share = cost_cells / top
    span = PLOT_SIZE - PLOT_PAD - (PLOT_BOTTOM if upright else PLOT_LEFT)
    return round(PLOT_SIZE - PLOT_BOTTOM - share * span if upright else PLOT_LEFT + share * span, 1)


def _points(trials: Sequence[Mapping[str, Any]], top: float) -> list[Point]:
    """One point for each trial that the planner and the baseline finished: across the baseline's cost, up its own."""
    points = []
    for index, trial in enumerate(trials):
        own, other = trial["cost"][:2]
        if own is not None and other is not None:
            text = f"{trial['id']}: {own:.0f} against {other:.0f} cells"
            points.append(Point(index, place(other, top, False), place(own, top, True), trial["robots"], text))
    return points


def _ticks(top: float) -> tuple[float, ...]:
    """Round numbers from 0 up, six at most."""
    power = 10.0 ** np.floor(np.log10(top / MAX_TICKS))
    step = next(power * factor for factor in (1, 2, 5, 10) if top / (power * factor) <= MAX_TICKS)
    return tuple(float(value) for value in np.arange(0, top, step))


def _trial(
    found: Sequence[Mapping[Any, Any]],
    planners: Sequence[str],
    templates: Sequence[str],
    classes: Sequence[str],
    drawn: dict[str, int],
    homes: Mapping[str, Home],
) -> dict[str, Any]:
    first = next((row for row in found if isinstance(row.get("formula"), str)), found[0])
    by_planner = {row["planner"]: row for row in found}
    formula = first.get("formula")
    template = str(first.get("template"))
    home = homes.get(str(first.get("home_id")))
    paths: dict[str, Any] = {}
    if home is not None:
        sheet = Sheet.of(home)
        for index, name in enumerate(planners[:2]):
            trace = by_planner.get(name, {}).get("trace")
            if isinstance(trace, str):
                paths[str(index)] = _paths(Trace.from_json(trace), sheet)
    return {
        "id": str(first["trial_id"]),
        "class": classes.index(first["size_class"]),
        "robots": int(first["robots"]),
        "template": templates.index(template) if template in templates else -1,
        "task": task_in_words(template, formula, task_objects(first.get("objects")))
        if isinstance(formula, str)
        else "",
        "formula": formula if isinstance(formula, str) else "",
        "cost": [_cost(by_planner.get(name)) for name in planners],
        "status": [str(by_planner[name]["status"]) if name in by_planner else "not run" for name in planners],
        "home": drawn.setdefault(home.id, len(drawn)) if home is not None and paths else -1,
        "paths": paths,
    }


def _cost(row: Mapping[Any, Any] | None) -> float | None:
    cost = float("nan") if row is None else float(row["cost_cells"])
    return round(cost, 1) if np.isfinite(cost) else None


def _paths(trace: Trace, sheet: Sheet) -> list[list[int]]:
    """By robot, all it drove as one line: x, y, x, y in centimetres of the picture."""
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
        "containers": [[one.type, sheet.points(one.footprint)] for one in home.containers],
    }
