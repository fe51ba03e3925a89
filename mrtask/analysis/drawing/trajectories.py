"""Drawings of episodes: a floor plan with each robot's path, searches and interactions, planner beside baseline.

A rule chooses the trials: among those of the largest team, the one where the planner saved most against the baseline,
the median one, and the one where it lost most.
"""

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patches import Polygon as DrawnPolygon
from shapely.geometry import Polygon as ShapelyPolygon

from mrtask.analysis.drawing.floor_plans import draw_rooms
from mrtask.analysis.page.charts import panels
from mrtask.analysis.page.style import (
    BLACK,
    GREY,
    ROBOT_LINES,
    YELLOW,
    house_style,
    planner_label,
    robot_color,
)
from mrtask.analysis.results.roles import BASELINES, INFORMED_BASELINE
from mrtask.analysis.results.statistics import paired_costs
from mrtask.execution.trace import Leg, Trace
from mrtask.homes.home import Container, Home, Point

FURNITURE = "#d5d0c8"
PANEL_WIDTH_IN, MAX_HEIGHT_IN = 5.3, 6.5
MIN_SHOWN_WAIT_S = 0.5
MIN_ARROW_M = 0.6
MIN_LABEL_AREA_M2 = 0.3
"""Smaller furniture is labelled only where it plays a part in the episode."""
CENTERED: Mapping[str, Any] = {"ha": "center", "va": "center"}
BACKDROP = {"facecolor": "white", "alpha": 0.55, "linewidth": 0, "pad": 0.6}
ONE_PLANNER_PICKS = ("the longest", "the median", "the shortest")
PAIRED_PICKS = ("most saved", "median saved", "least saved")
LOST_PICK = "most lost"


@dataclass(frozen=True)
class Pick:
    """A trial to draw, and why."""

    trial_id: str
    home_id: str
    reason: str


def instructive_trials(
    episodes: pd.DataFrame, planner: str, baseline: str | None = None, home_ids: Collection[str] | None = None
) -> list[Pick]:
    """The trials of the largest team where ``planner`` saved most seconds against ``baseline``, the median, and fewest.

    Without a baseline: the longest, the median and the shortest. Trials of homes outside ``home_ids`` (None: any home)
    or, if there is a column ``trace``, without traces are skipped in favour of the next in rank.
    """
    if "home_id" not in episodes.columns:
        return []
    rows = episodes[(episodes["status"] == "accepted") & episodes["home_id"].notna()]
    if "trace" in rows.columns:
        rows = rows[rows["trace"].notna()]
    names = [planner] if baseline is None else [planner, baseline]
    costs = paired_costs(rows).reindex(columns=names).dropna()
    trials = rows.drop_duplicates("trial_id").set_index("trial_id").loc[costs.index]
    costs = costs[trials["robots"] == trials["robots"].max()]
    if costs.empty:
        return []
    gain = costs[planner] if baseline is None else costs[baseline] - costs[planner]
    ranked = gain.rename("gain").reset_index().sort_values(["gain", "trial_id"], ascending=[False, True])["trial_id"]
    homes = ranked.map(trials["home_id"].astype(str))
    candidates = list(zip(ranked.astype(str), homes, strict=True))
    reasons = list(ONE_PLANNER_PICKS if baseline is None else PAIRED_PICKS)
    if baseline is not None and gain.min() < 0:
        reasons[-1] = LOST_PICK
    last = len(candidates) - 1
    picks: dict[str, Pick] = {}
    for rank, reason in zip((0, last // 2, last), reasons, strict=True):
        for index in sorted(range(len(candidates)), key=lambda other: abs(other - rank)):
            trial, home_id = candidates[index]
            if trial not in picks and (home_ids is None or home_id in home_ids):
                picks[trial] = Pick(trial, home_id, reason if index == rank else f"near {reason}")
                break
    return list(picks.values())


def baseline_beside(planners: Iterable[str], planner: str) -> str | None:
    """The planner drawn beside the main one: the informed baseline, or the first other that ran; None if none did."""
    ran = set(planners)
    candidates = (INFORMED_BASELINE, *BASELINES, *sorted(ran))
    return next((name for name in candidates if name in ran and name != planner), None)


@house_style()
def draw_trial(home: Home, episodes: Mapping[str, Mapping[Any, Any]], called: Sequence[str] = ()) -> Figure:
    """One panel per planner of the same trial.

    Args:
        episodes: planner -> its row, with `trace`, `cost_s`, and `objects` where it is known.
        called: what the legend calls the robots, in their order; those without a name by their number.
    """
    xs, ys = np.array([point for room in home.rooms for point in room.polygon]).T
    aspect = max(float(np.ptp(ys)), 1.0) / max(float(np.ptp(xs)), 1.0)
    height_in = min(PANEL_WIDTH_IN * aspect, MAX_HEIGHT_IN) + 0.9
    figure, (line,) = panels(PANEL_WIDTH_IN * max(len(episodes), 1), height_in, columns=len(episodes))
    traces = {planner: Trace.from_json(row["trace"]) for planner, row in episodes.items()}
    for axes, (planner, row) in zip(line, episodes.items(), strict=True):
        trace = traces[planner]
        draw_searched_home(axes, home, task_objects(row.get("objects")), _visited(trace))
        draw_trace(axes, trace, home)
        axes.set_title(f"{planner_label(planner)}: {row['cost_s']:.1f} s")
        axes.set(xlim=(xs.min() - 0.2, xs.max() + 0.2), ylim=(ys.min() - 0.2, ys.max() + 0.2))
    waited = any(_is_shown_wait(leg) for trace in traces.values() for legs in trace.robots for leg in legs)
    robots = max((len(trace.robots) for trace in traces.values()), default=0)
    figure.legend(handles=_legend(robots, waited, called), loc="outside lower center", ncols=8, fontsize=8)
    return figure


def draw_searched_home(axes: Axes, home: Home, objects: Sequence[str] = (), labelled: Collection[str] = ()) -> None:
    """Draw a floor plan where containers that hold one of ``objects`` are outlined and say what they hold."""
    draw_rooms(home, axes)
    for container in home.containers:
        held = [name for name in objects if name in container.objects]
        _draw_container(axes, container, held, container.id in labelled)
    for room in home.rooms:
        place = ShapelyPolygon(room.polygon).representative_point()
        axes.text(place.x, place.y, room.type, **CENTERED, fontsize=7.5, color="#9a9a9a", style="italic", zorder=2.2)


def _draw_container(axes: Axes, container: Container, held: Sequence[str], labelled: bool) -> None:
    axes.add_patch(
        DrawnPolygon(
            container.footprint, closed=True, facecolor=YELLOW if held else FURNITURE, alpha=0.9,
            edgecolor=BLACK if held else "#a9a39a", linewidth=1.3 if held else 0.6, zorder=3,
        )
    )  # fmt: skip
    shape = ShapelyPolygon(container.footprint)
    if held or labelled or shape.area > MIN_LABEL_AREA_M2:
        name = container.type + (f"\n[{', '.join(held)}]" if held else "")
        axes.text(
            shape.centroid.x, shape.centroid.y, name, ha="center", va="center", fontsize=5.5,
            color=BLACK if held or labelled else "#6b665f", weight="bold" if held else "normal", zorder=7,
            bbox=BACKDROP if held or labelled else None, linespacing=1.0,
        )  # fmt: skip


def draw_trace(axes: Axes, trace: Trace, home: Home) -> None:
    """Each robot's path in its colour; the team's searches are numbered, stars are interactions, squares are waits."""
    searches = sorted(
        ((leg.t1_s, robot, leg) for robot, legs in enumerate(trace.robots) for leg in legs if leg.kind == "search"),
        key=lambda entry: entry[:2],
    )
    for robot, legs in enumerate(trace.robots):
        color, line = robot_color(robot), ROBOT_LINES[robot % len(ROBOT_LINES)]
        for leg in legs:
            if leg.kind == "move":
                axes.plot(*np.array(leg.path).T, color=color, linestyle=line, linewidth=1.8, alpha=0.85, zorder=4)
                _arrow(axes, leg.path, color)
            elif _is_shown_wait(leg):
                x, y = leg.path[0]
                axes.plot(x, y, marker="s", markersize=8, markerfacecolor="none", markeredgecolor=color, zorder=5)
    for number, (_, robot, leg) in enumerate(searches, 1):
        x, y = leg.path[0]
        axes.plot(x, y, marker="o", markersize=8, color=robot_color(robot), markeredgecolor="white", zorder=6)
        axes.text(
            x, y, str(number), ha="center", va="center_baseline", fontsize=5.8, color="white", weight="bold", zorder=8
        )
    middles_y = {c.id: ShapelyPolygon(c.footprint).centroid.y for c in home.containers}
    for (robot, (x, y), container), words in _letters_by_place(trace).items():
        color, below = robot_color(robot), middles_y[container] > y
        axes.plot(x, y, marker="*", markersize=21, color=color, markeredgecolor=BLACK, markeredgewidth=0.7, zorder=5.5)
        axes.annotate(
            "\n".join(words), (x, y), xytext=(0, -10 if below else 10), textcoords="offset points", ha="center",
            va="top" if below else "bottom",
            fontsize=6.5, weight="bold", color=color, bbox=BACKDROP, zorder=9, linespacing=1.05,
        )  # fmt: skip
    for start in {trace.start, *(legs[0].path[0] for legs in trace.robots if legs)}:
        axes.plot(*start, marker="P", markersize=10, color=BLACK, markeredgecolor="white", zorder=10)


def task_objects(raw: object) -> tuple[str, ...]:
    """The task's objects from a row, which holds them as a list or as its JSON text."""
    if isinstance(raw, str):
        try:
            raw = json.loads(raw)
        except json.JSONDecodeError:
            raw = [part.strip() for part in str(raw).split(",")]
    return tuple(map(str, raw)) if isinstance(raw, list | tuple | np.ndarray) else ()


def _visited(trace: Trace) -> set[str]:
    kinds = ("search", "interact")
    return {leg.container for legs in trace.robots for leg in legs if leg.kind in kinds and leg.container}


def _is_shown_wait(leg: Leg) -> bool:
    return leg.kind == "wait" and leg.t1_s - leg.t0_s > MIN_SHOWN_WAIT_S


def _letters_by_place(trace: Trace) -> dict[tuple[int, Point, str], list[str]]:
    """``(robot, place, container)`` -> what it interacted with there and when, in time order."""
    found: dict[tuple[int, Point, str], list[str]] = {}
    for letter in trace.letters:
        place = place_at(trace.robots[letter.robot], letter.t_s, trace.start)
        found.setdefault((letter.robot, place, letter.container), []).append(f"{letter.object} {letter.t_s:.0f} s")
    return found


def place_at(legs: Sequence[Leg], t_s: float, start: Point) -> Point:
    """Where a robot stands at this time: the end of its last finished leg."""
    places = [leg.path[-1] for leg in legs if leg.t1_s <= t_s + 1e-6]
    return places[-1] if places else start


def _arrow(axes: Axes, path: Sequence[Point], color: str) -> None:
    """An arrow head in the middle of the longest straight stretch."""
    points = np.array(path)
    lengths = np.hypot(*np.diff(points, axis=0).T)
    if not len(lengths) or lengths.max() < MIN_ARROW_M:
        return
    longest = int(lengths.argmax())
    tail, head = points[longest], points[longest + 1]
    middle, step = (tail + head) / 2, (head - tail) / lengths[longest] * 0.02
    axes.annotate(
        "",
        middle + step,
        middle - step,
        zorder=4.5,
        arrowprops={"arrowstyle": "-|>", "color": color, "mutation_scale": 11},
    )


def _legend(robots: int, waited: bool, called: Sequence[str]) -> list[Line2D | Patch]:
    def mark(marker: str, label: str, color: str = GREY, size: float = 8, edge: str = "white") -> Line2D:
        looks: dict[str, Any] = {"markersize": size, "markeredgecolor": edge}
        return Line2D([], [], linestyle="none", marker=marker, color=color, label=label, **looks)

    names = [name or f"robot {index + 1}" for index, name in enumerate([*called, *[""] * robots][:robots])]
    entries: list[Line2D | Patch] = [
        Line2D([], [], color=robot_color(index), linestyle=line, linewidth=1.8, label=names[index])
        for index, line in zip(range(robots), cycle(ROBOT_LINES), strict=False)
    ]
    entries += [
        mark("P", "start", BLACK, 9),
        mark("o", "searched, in this order"),
        mark("*", "interaction", size=12, edge=BLACK),
        Patch(facecolor=YELLOW, edgecolor=BLACK, label="holds a task object"),
    ]
    return [*entries, mark("s", "waits", "none", 7, GREY)] if waited else entries
