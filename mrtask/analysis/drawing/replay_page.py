"""The page of a replay: one HTML file that contains its picture, script and style and loads nothing.

All text is in the HTML, laid out here and by ``replay.html.jinja``; the script (``replay.js``) only moves things and
shows the decision at the current time. So the page is complete without scripts, and no name of a home or a task can
become code: the templates escape text, and `script_json` the data block.
"""

import json
from collections import Counter
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup
from shapely.geometry import Polygon as ShapelyPolygon

from mrtask.analysis.drawing.automaton import RADIUS, draw_automaton
from mrtask.analysis.drawing.floor_plans import ROOM_COLORS, clear_spot, passages, ways_out
from mrtask.analysis.drawing.replay_content import Decision, Replay, Run
from mrtask.analysis.drawing.sheet import Sheet
from mrtask.analysis.drawing.trajectories import place_at
from mrtask.analysis.page.rendering import render_fragment, script_digest, template_text
from mrtask.analysis.page.style import ROBOT_COLORS
from mrtask.names import counted

MIN_LABEL_AREA_M2 = 0.3
PERMILLE = 1000
CHART_WIDTH, CHART_HEIGHT = 560, 120
CHART_LEFT, CHART_RIGHT, CHART_TOP, CHART_BOTTOM = 44, 12, 8, 24
CHART_SLACK, CHART_LEAST_SPAN = 0.15, 0.1
MIN_TICK_GAP = 14
EDGE_SHARE = 0.14
"""Labels this close to a side of the picture extend away from it."""


def render_replay(replay: Replay, command: str | None = None) -> str:
    """The page; ``command`` is the command that makes it again."""
    script, style = template_text("replay.js"), template_text("replay.css")
    sheet = Sheet.of(replay.home)
    return render_fragment(
        "replay",
        replay=replay,
        command=command,
        sheet=sheet,
        floor=_floor(replay, sheet),
        min_label_area_m2=MIN_LABEL_AREA_M2,
        runs=[_run_view(run, replay, sheet) for run in replay.runs],
        has_belief=any(run.decisions for run in replay.runs),
        automaton=draw_automaton(replay.automaton),
        state_radius=RADIUS,
        robot_colors=[ROBOT_COLORS[robot % len(ROBOT_COLORS)] for robot in range(replay.robots)],
        team=counted(replay.robots, "robot"),
        called=replay.called[: replay.robots] if any(replay.called) else (),
        gap_text=_gap_text(replay.runs),
        data=script_json(page_data(replay, sheet)),
        script=Markup(script),
        style=Markup(style),
        script_digest=script_digest(script),
    )


def script_json(data: object) -> Markup:
    """JSON that is safe in a script element, whatever its strings contain."""
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def page_data(replay: Replay, sheet: Sheet) -> dict[str, Any]:
    """The data that the script moves, in centimetres of the picture and seconds; beliefs in thousandths by object."""
    place = {container.id: index for index, container in enumerate(replay.home.containers)}
    number = {name: index for index, name in enumerate(replay.objects)}

    def leg_of(leg: Any) -> list[Any]:
        path = [coordinate for point in leg.path for coordinate in sheet.point(point)]
        container = place[leg.container] if leg.container is not None else -1
        obj = number[leg.object] if leg.object is not None else -1
        return [leg.kind, round(leg.t0_s, 3), round(leg.t1_s, 3), container, obj, path]

    return {
        "end": round(replay.end_s, 3),
        "objects": list(replay.objects),
        "names": list(replay.names),
        "runs": [
            {
                "end": round(run.end_s, 3),
                "cost": run.cost_s if run.cost_s is None else round(run.cost_s, 3),
                "start": sheet.point(run.trace.start),
                "robots": [[leg_of(leg) for leg in legs] for legs in run.trace.robots],
                "finds": [[round(find.t_s, 3), find.container, list(find.objects)] for find in run.finds],
                "states": [[round(t_s, 3), state] for t_s, state in run.states],
                "decisions": [
                    {
                        "t": round(decision.t_s, 3),
                        "belief": (decision.belief.T * PERMILLE).round().astype(int).tolist(),
                        "targets": [action.container for action in decision.actions],
                    }
                    for decision in run.decisions
                ],
            }
            for run in replay.runs
        ],
    }


def _floor(replay: Replay, sheet: Sheet) -> dict[str, Any]:
    """Rooms, doors, furniture."""
    home, holds = replay.home, replay.holds()
    rooms = [
        {
            "type": room.type if room.type in ROOM_COLORS else "other",
            "name": room.type,
            "points": sheet.points(room.polygon),
            "middle": sheet.point(clear_spot(home, room)),
        }
        for room in home.rooms
    ]
    containers: list[dict[str, Any]] = [
        {
            "index": index,
            "name": replay.names[index],
            "points": sheet.points(container.footprint),
            "middle": sheet.middle(container.footprint),
            "side": _side(sheet.middle(container.footprint)[0], sheet.width),
            "held": [name for name, here in zip(replay.objects, holds[index], strict=True) if here],
            "area_m2": ShapelyPolygon(container.footprint).area,
        }
        for index, container in enumerate(home.containers)
    ]
    return {
        "rooms": rooms,
        "doors": [sheet.points(line) for line in passages(home)],
        "ways_out": [sheet.points(line) for line in ways_out(home)],
        # Small furniture stands partly under large.
        "containers": sorted(containers, key=lambda view: -view["area_m2"]),
        "obstacles": [sheet.points(obstacle.footprint) for obstacle in home.obstacles],
    }


def _side(x: float, width: float) -> str:
    return " at-left" if x < EDGE_SHARE * width else " at-right" if x > (1 - EDGE_SHARE) * width else ""


def _run_view(run: Run, replay: Replay, sheet: Sheet) -> dict[str, Any]:
    ends = [legs[-1].path[-1] if legs else run.trace.start for legs in run.trace.robots]
    marks: Counter[tuple[int, int, int]] = Counter()
    stars = []
    for letter in run.trace.letters:
        x, y = sheet.point(place_at(run.trace.robots[letter.robot], letter.t_s, run.trace.start))
        above = marks[letter.robot, x, y]
        stars.append({"x": x, "y": y, "above": above, "robot": letter.robot, "t": letter.t_s, "text": letter.object})
        marks[letter.robot, x, y] += 1
    return {
        "run": run,
        "status": _status_text(run),
        "start": sheet.point(run.trace.start),
        "trails": [[sheet.points(leg.path) for leg in legs if leg.kind == "move"] for legs in run.trace.robots],
        "ends": [sheet.point(end) for end in ends],
        "finds": [
            {"number": number, "xy": sheet.point(find.place), "find": find} for number, find in enumerate(run.finds, 1)
        ],
        "stars": stars,
        "chart": _chart(run),
        "decisions": [_decision_view(decision, run) for decision in run.decisions],
        "letters": [(letter, run.trace.robots[letter.robot]) for letter in run.trace.letters],
    }


def _status_text(run: Run) -> str:
    if run.cost_s is not None:
        return f"{run.cost_s:.1f} s"
    return f"{run.status}: {run.error}" if run.error else run.status


def _decision_view(decision: Decision, run: Run) -> dict[str, Any]:
    """The decision with the scales of its bars."""
    rows = decision.candidates
    low = min((row.mean_s - row.spread_s for row in rows), default=0.0)
    high = max((row.mean_s + row.spread_s for row in rows), default=1.0)
    scale = 100 / (high - low) if high > low else 0.0
    most = max((row.visits for row in rows), default=1)
    return {
        "decision": decision,
        "bars": [
            {
                "row": row,
                "visits": 100 * row.visits / most,
                "left": (row.mean_s - row.spread_s - low) * scale,
                "width": 2 * row.spread_s * scale,
                "mean": (row.mean_s - low) * scale,
            }
            for row in rows
        ],
        "verdict": _verdict(decision),
    }


def _verdict(decision: Decision) -> str | None:
    """The time to go that the planner expected, against the time it took."""
    if decision.expected_s is None:
        return None
    expected = f"expected {decision.expected_s:.1f} s to go"
    if decision.remaining_s is None:
        return f"{expected}; the task was not finished"
    off_s = round(decision.remaining_s, 1) - round(decision.expected_s, 1)
    how = f", {abs(off_s):.1f} s {'more' if off_s > 0 else 'less'}" if off_s else ""
    return f"{expected}; it took {abs(decision.remaining_s):.1f} s{how}"


def _chart(run: Run) -> dict[str, Any] | None:
    """When the planner expected to finish, over time; None where it made no estimates."""
    known = [(one.t_s, one.t_s + one.expected_s) for one in run.decisions if one.expected_s is not None]
    if len(known) < 2:
        return None
    finishes = [finish_s for _, finish_s in known] + ([] if run.cost_s is None else [run.cost_s])
    span_s = max(max(finishes) - min(finishes), CHART_LEAST_SPAN * max(finishes)) or 1.0
    bottom_s, top_s = max(min(finishes) - CHART_SLACK * span_s, 0.0), max(finishes) + CHART_SLACK * span_s
    end_s = max(run.end_s, known[-1][0]) or 1.0

    def place(t_s: float, finish_s: float) -> tuple[float, float]:
        x = CHART_LEFT + (CHART_WIDTH - CHART_LEFT - CHART_RIGHT) * t_s / end_s
        height = (CHART_HEIGHT - CHART_TOP - CHART_BOTTOM) * (finish_s - bottom_s) / (top_s - bottom_s)
        return round(x, 1), round(CHART_HEIGHT - CHART_BOTTOM - height, 1)

    points = [place(*pair) for pair in known]
    ticks = [(place(0.0, finish_s)[1], f"{finish_s:.1f}") for finish_s in (max(finishes), min(finishes))]
    return {
        "width": CHART_WIDTH,
        "height": CHART_HEIGHT,
        "left": CHART_LEFT,
        "right": CHART_WIDTH - CHART_RIGHT,
        "top": CHART_TOP,
        "bottom": CHART_HEIGHT - CHART_BOTTOM,
        "path": f"M{points[0][0]} {points[0][1]}"
        + "".join(f"H{x}V{y}" for x, y in points[1:])
        + f"H{CHART_WIDTH - CHART_RIGHT}",
        "points": points,
        "actual": place(0.0, run.cost_s)[1] if run.cost_s is not None else None,
        "ticks": ticks if ticks[1][0] - ticks[0][0] > MIN_TICK_GAP else ticks[:1],
        "end": f"{end_s:.1f} s",
        "end_s": end_s,
    }


def _gap_text(runs: Sequence[Run]) -> str | None:
    """How the first run compares with each other one."""
    first = runs[0].cost_s if runs else None
    if first is None:
        return None
    shares = {run.label: 100 * (1 - first / run.cost_s) for run in runs[1:] if run.cost_s}
    parts = [f"{abs(share):.0f} % {'sooner' if share >= 0 else 'later'} than {name}" for name, share in shares.items()]
    return f"{runs[0].label} is done {', '.join(parts)}." if parts else None
