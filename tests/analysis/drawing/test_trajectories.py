import pandas as pd
import pytest
from matplotlib.figure import Figure

from mrtask.analysis.drawing.trajectories import (
    Pick,
    draw_searched_home,
    draw_trace,
    draw_trial,
    instructive_trials,
    task_objects,
)
from mrtask.analysis.page.style import svg_bytes
from mrtask.execution.trace import Leg, Letter, Trace
from mrtask.homes.home import Container, Home, Room
from tests.analysis.synthetic import fail, rows


@pytest.fixture
def trace(two_room_home):
    """Two robots; the second searches first, the first waits with the egg and then finds the pillow."""
    fridge, table, bed = (container.id for container in two_room_home.containers)
    first = (
        Leg("move", 0, 2, fridge, None, ((2, 1), (1, 1), (0.4, 0.9))),
        Leg("search", 2, 3, fridge, None, ((0.4, 0.9),)),
        Leg("interact", 3, 3, fridge, "Egg", ((0.4, 0.9),)),
        Leg("wait", 3, 5, None, None, ((0.4, 0.9),)),
        Leg("move", 5, 11, bed, None, ((0.4, 0.9), (5.9, 1.2))),
        Leg("search", 11, 12, bed, None, ((5.9, 1.2),)),
        Leg("interact", 12, 12, bed, "Pillow", ((5.9, 1.2),)),
    )
    second = (Leg("move", 0, 1.5, table, None, ((2, 1), (2, 2.5))), Leg("search", 1.5, 2.5, table, None, ((2, 2.5),)))
    return Trace((2.0, 1.0), (first, second), (Letter(3, 0, "Egg", fridge), Letter(12, 0, "Pillow", bed)))


def drawn_texts(axes):
    return [text.get_text() for text in axes.texts if text.get_text()]


def test_draws_what_happened(two_room_home, trace):
    axes = Figure().subplots()
    draw_searched_home(axes, two_room_home, ("Egg", "Pillow"), ())
    draw_trace(axes, trace, two_room_home)
    texts = drawn_texts(axes)
    assert {"Kitchen", "Bedroom", "Fridge\n[Egg]", "Bed\n[Pillow]", "DiningTable", "Egg 3 s", "Pillow 12 s"} <= set(
        texts
    )
    places = {text.get_text(): text.get_position() for text in axes.texts}
    assert places["1"] == (2, 2.5) and places["2"] == (0.4, 0.9) and places["3"] == (5.9, 1.2)
    lines = [tuple(map(tuple, line.get_xydata())) for line in axes.lines]
    assert ((2, 1), (1, 1), (0.4, 0.9)) in lines and ((2, 1), (2, 2.5)) in lines
    squares = [line.get_xydata().tolist() for line in axes.lines if line.get_marker() == "s"]
    assert squares == [[[0.4, 0.9]]]


def test_legend_names_all_robots(two_room_home, trace):
    row = {"trace": trace.to_json(), "cost_s": 12.0, "objects": ["Egg"]}
    figure = draw_trial(two_room_home, {"pouct": row, "my_lab.Mine": row})
    assert [axes.get_title() for axes in figure.axes] == ["pouct: 12.0 s", "Mine: 12.0 s"]
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend[:2] == ["robot 1", "robot 2"] and "waits" in legend
    assert b"<svg" in svg_bytes(figure)


def test_names_may_hold_anything(two_room_home, trace):
    odd = Trace(
        trace.start,
        trace.robots,
        tuple(
            Letter(1, 0, "$x_{<\N{SNOWMAN}\N{CJK UNIFIED IDEOGRAPH-6F22}", letter.container) for letter in trace.letters
        ),
    )
    svg_bytes(draw_trial(two_room_home, {"$\\frac": {"trace": odd.to_json(), "cost_s": 12.0}}))


def test_idle_robots_and_empty_traces(two_room_home):
    trace = Trace((1.0, 1.0), ((), ()), ())
    svg_bytes(draw_trial(two_room_home, {"pouct": {"trace": trace.to_json(), "cost_s": 0.0}}))


@pytest.mark.parametrize("size_m", [(2, 12), (12, 2), (9, 12)])
def test_nothing_is_cut_off(size_m):
    width, depth = size_m
    corner = ((width - 0.6, depth - 0.6), (width, depth - 0.6), (width, depth), (width - 0.6, depth))
    home = Home(
        "test",
        (Room("room", "Kitchen", ((0, 0), (width, 0), (width, depth), (0, depth))),),
        (),
        (Container("table", "DiningTable", "room", corner, ("AlarmClock", "Statue")),),
        (),
    )
    row = {"trace": Trace((1.0, 1.0), ((),), ()).to_json(), "cost_s": 1.0, "objects": ["AlarmClock", "Statue"]}
    figure = draw_trial(home, {"pouct": row, "learned_myopic": row})
    figure.canvas.draw()
    for text in [text for axes in figure.axes for text in (axes.title, *axes.texts)] + figure.legends[0].get_texts():
        box = text.get_window_extent()
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1


def traced(robots, costs):
    frame = rows("small", robots, costs)
    return frame.assign(home_id="home" + frame["trial_id"].str[-1], trace="{}")


COSTS = {"pouct": [5.0, 1.0, 9.0, 4.0, 5.0], "learned_myopic": [6.0, 8.0, 7.0, 4.0, 7.0]}


def test_picks_by_hand():
    # Saved: 1, 7, -2, 0, 2: ranked 1, 4, 0, 3, 2.
    picks = instructive_trials(traced(2, COSTS), "pouct", "learned_myopic")
    assert picks == [
        Pick("small-2-001", "home1", "most saved"),
        Pick("small-2-000", "home0", "median saved"),
        Pick("small-2-002", "home2", "most lost"),
    ]
    won = {"pouct": [1.0, 1.0, 1.0], "learned_myopic": [2.0, 3.0, 4.0]}
    assert instructive_trials(traced(2, won), "pouct", "learned_myopic")[-1] == Pick(
        "small-2-000", "home0", "least saved"
    )


def test_picks_without_baseline():
    picks = instructive_trials(traced(1, {"pouct": [3.0, 1.0, 2.0]}), "pouct", None)
    assert [(pick.trial_id[-1], pick.reason) for pick in picks] == [
        ("0", "the longest"),
        ("2", "the median"),
        ("1", "the shortest"),
    ]


def test_picks_pass_over_homes_that_are_gone():
    picks = instructive_trials(traced(2, COSTS), "pouct", "learned_myopic", {"home0", "home3"})
    assert [(pick.home_id, pick.reason) for pick in picks] == [
        ("home0", "near most saved"),
        ("home3", "near median saved"),
    ]
    assert instructive_trials(traced(2, COSTS), "pouct", "learned_myopic", ()) == []


def test_picks_come_from_the_largest_team_and_from_finished_pairs():
    frame = pd.concat([traced(1, {"pouct": [1.0], "learned_myopic": [99.0]}), traced(3, COSTS)], ignore_index=True)
    frame = fail(frame, (frame["trial_id"] == "small-3-001") & (frame["planner"] == "learned_myopic"))
    trials = [pick.trial_id for pick in instructive_trials(frame, "pouct", "learned_myopic")]
    assert trials == ["small-3-004", "small-3-000", "small-3-002"]


def test_nothing_to_pick():
    frame = traced(1, COSTS)
    assert instructive_trials(frame.drop(columns="home_id"), "pouct", "learned_myopic") == []
    assert instructive_trials(frame.assign(trace=None), "pouct", "learned_myopic") == []
    assert instructive_trials(frame, "pouct", "greedy") == []
    assert instructive_trials(frame.head(0), "pouct", None) == []


@pytest.mark.parametrize("raw", [["Mug", "Book"], ("Mug", "Book"), '["Mug", "Book"]', "Mug, Book"])
def test_task_objects(raw):
    assert task_objects(raw) == ("Mug", "Book")
    assert task_objects(None) == ()
