"""The record of a replay and its page's text: against brute force and against what the episode itself says."""

import itertools
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from mrtask.analysis.drawing.automaton import draw_automaton
from mrtask.analysis.drawing.replay_content import (
    Episode,
    Recorder,
    container_names,
    existence_belief,
    make_replay,
    task_in_words,
)
from mrtask.analysis.drawing.replay_page import page_data, render_replay, script_json
from mrtask.analysis.drawing.sheet import Sheet
from mrtask.execution.episode import run_episode
from mrtask.execution.team_spec import RobotSpec, Team
from mrtask.execution.trials import Trial
from mrtask.homes.home import Container, Home, Room
from mrtask.planning.planners import make_planner
from mrtask.planning.problem import WAIT, Plan
from mrtask.tasks.automaton import build_automaton
from mrtask.tasks.templates import TEMPLATES, make_formula

PROBS = np.array([[0.6, 0.1], [0.3, 0.2], [0.2, 0.7]])
OBJECTS = ("Egg", "Pillow")


def trial_of(home, home_map, robots=2, objects=OBJECTS):
    return Trial(
        trial_id="small-2-000",
        home_id=home.id,
        size_class=home.size_class,
        team=Team.alike(robots, RobotSpec(1.0, 1.0, 0.5)),
        template="seq2",
        formula=make_formula("seq2", objects),
        objects=objects,
        start_cell=home_map.cell_of((2.0, 1.5)),
        seed=7,
    )


def played(trial, home, home_map, planner, options=None):
    recorder = Recorder()
    result = run_episode(trial, home, home_map, PROBS, make_planner(planner, options), observe=recorder)
    return result, recorder, Episode(
        planner, result.status, result.cost_s, result.error, result.trace, recorder.decisions
    )  # fmt: skip


@pytest.fixture(scope="module")
def replay(two_room_home, two_room_map):
    trial = trial_of(two_room_home, two_room_map)
    episodes = [
        played(trial, two_room_home, two_room_map, name, options)[2]
        for name, options in (("pouct", {"samples": 200}), ("learned_myopic", None))
    ]
    automaton = build_automaton(trial.formula, trial.objects)
    return make_replay(trial.trial_id, trial.size_class, trial.template, automaton, two_room_home, episodes)


def test_watching_changes_nothing_and_sees_every_decision(two_room_home, two_room_map):
    trial = trial_of(two_room_home, two_room_map)
    alone = run_episode(trial, two_room_home, two_room_map, PROBS, make_planner("pouct", {"samples": 200}))
    result, recorder, _ = played(trial, two_room_home, two_room_map, "pouct", {"samples": 200})
    assert (result.cost_s, result.trace, result.decisions) == (alone.cost_s, alone.trace, alone.decisions)
    assert len(recorder.decisions) == result.decisions
    times = [one.t_s for one in recorder.decisions]
    assert times == sorted(times) and times[0] == 0.0 and times[-1] <= result.cost_s
    assert sum(one.plan.info.samples for one in recorder.decisions) == result.samples


def test_the_record_says_what_the_trace_says(replay, two_room_home):
    run = replay.runs[0]
    automaton = replay.automaton
    assert run.states[0] == (0.0, automaton.initial) and automaton.accepting[run.states[-1][1]]
    assert [state for _, state in run.states[1:]] == [
        automaton.run([letter.object for letter in run.trace.letters[: count + 1]])
        for count in range(len(run.trace.letters))
    ]
    for find in run.finds:
        held = {OBJECTS[index] for index in find.objects}
        assert held == set(OBJECTS) & set(two_room_home.containers[find.container].objects)
    searches = sum(leg.kind == "search" for legs in run.trace.robots for leg in legs)
    assert len(run.finds) == searches > 0
    assert run.end_s == pytest.approx(run.cost_s)
    for decision in run.decisions:
        assert decision.remaining_s == pytest.approx(run.cost_s - decision.t_s)
        assert [action.robot for action in decision.actions] == [0, 1]
        assert sum(candidate.chosen for candidate in decision.candidates) == 1
    assert not any(decision.candidates for decision in replay.runs[1].decisions)


def test_candidates_are_the_searchs(two_room_home, two_room_map):
    trial = trial_of(two_room_home, two_room_map)
    _, recorder, episode = played(trial, two_room_home, two_room_map, "pouct", {"samples": 200})
    automaton = build_automaton(trial.formula, trial.objects)
    run = make_replay("t", "small", "seq2", automaton, two_room_home, [episode]).runs[0]
    first, seen = run.decisions[0], recorder.decisions[0]
    assert [(row.visits, row.mean_s) for row in first.candidates] == [row[1:3] for row in seen.plan.info.root]
    assert sum(row.visits for row in first.candidates) == seen.plan.info.samples
    names = container_names(two_room_home)
    for action in first.actions:
        given = seen.plan.assignments[action.robot]
        assert action.text == ("wait" if given.container == WAIT else names[given.container])


def test_of_many_candidates_the_most_visited_and_the_chosen_are_listed(two_room_home, two_room_map):
    trial = trial_of(two_room_home, two_room_map, robots=1)
    _, recorder, episode = played(trial, two_room_home, two_room_map, "pouct", {"samples": 200})
    observed = recorder.decisions[0]
    chosen = next(iter(observed.plan.assignments.values()))
    others = [replace_container(chosen, container) for container in range(3) if container != chosen.container]
    rows = [(others[index % 2], 100 - index, 5.0, 1.0) for index in range(20)] + [(chosen, 3, 4.0, 1.0)]
    info = replace(observed.plan.info, root=tuple(rows))
    changed = replace(observed, plan=Plan(observed.plan.assignments, info))
    automaton = build_automaton(trial.formula, trial.objects)
    episode = replace(episode, decisions=[changed])
    [decision] = make_replay("t", "small", "seq2", automaton, two_room_home, [episode]).runs[0].decisions
    assert len(decision.candidates) == 12 and decision.unlisted == 9
    assert [row.visits for row in decision.candidates] == [*range(100, 89, -1), 3]
    assert [row.chosen for row in decision.candidates] == [False] * 11 + [True]


def replace_container(assignment, container):
    return assignment._replace(container=container)


def naive_belief(prob, searched):
    """Goes through all worlds of one object in which it is somewhere."""
    weights = np.zeros(len(prob))
    total = 0.0
    for world in itertools.product([0, 1], repeat=len(prob)):
        if any(world):
            weight = np.prod([p if here else 1 - p for p, here in zip(prob, world, strict=True)])
            total += weight
            weights += weight * np.array(world)
    return weights / total


def test_belief_by_going_through_all_worlds():
    searched = np.array([False, True, False, False])
    prob = np.array([[0.2, 0.5], [0.0, 1.0], [0.6, 0.25], [0.05, 0.1]])
    belief = existence_belief(prob, searched)
    np.testing.assert_allclose(belief[:, 0], naive_belief(prob[:, 0], searched))
    np.testing.assert_allclose(belief[:, 1], prob[:, 1], err_msg="found: nothing to infer")
    assert (existence_belief(np.zeros((2, 1)), np.array([True, False])) == 0).all()


@pytest.mark.parametrize(
    ("template", "words"),
    [
        ("and_or", "Mug, and Book or Pen"),
        ("or_seq", "Mug or Book, then Pen, then Cup"),
        ("seq3", "Mug then Book then Pen"),
    ],
)
def test_tasks_in_words(template, words):
    objects = ("Mug", "Book", "Pen", "Cup")[: TEMPLATES[template].arity]
    assert task_in_words(template, make_formula(template, objects), objects) == words
    assert task_in_words("formula", "F Mug & F a", ("Mug", "a")) == "F Mug & F a"


def test_equal_types_are_told_apart():
    square = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    home = Home(
        "test",
        (Room("r", "Kitchen", square),),
        (),
        tuple(Container(str(i), kind, "r", square, ()) for i, kind in enumerate(["Chair", "Bed", "Chair"])),
        (),
    )
    assert container_names(home) == ("Chair 1", "Bed", "Chair 2")


@pytest.mark.parametrize("template", TEMPLATES)
def test_the_drawing_has_every_advancing_step_and_no_overlap(template):
    objects = ("Mug", "Book", "Pen", "Cup")[: TEMPLATES[template].arity]
    automaton = build_automaton(make_formula(template, objects), objects)
    drawing = draw_automaton(automaton)
    states = {node.state for node in drawing.nodes}
    assert states == set(range(len(automaton.accepting))) - {automaton.sink}
    names = sum(line.removeprefix("or ") in objects for edge in drawing.edges for line in edge.lines)
    assert names == automaton.advancing[sorted(states)].sum()
    for one, other in itertools.combinations(drawing.nodes, 2):
        assert np.hypot(one.x - other.x, one.y - other.y) > 40
    for node in drawing.nodes:
        assert 18 < node.x < drawing.width - 18 and 18 < node.y < drawing.height - 18
    steps = {node.state: node.x for node in drawing.nodes}
    for state, obj in zip(*np.nonzero(automaton.advancing), strict=True):
        if state != automaton.sink:
            assert steps[int(automaton.transitions[state, obj])] > steps[int(state)], "steps lead to the right"


def test_no_drawing_where_there_is_nothing_to_draw():
    assert draw_automaton(build_automaton("F a & !a & X false")) is None
    wide = build_automaton(" & ".join(f"F o{index}" for index in range(6)))
    assert len(wide.accepting) == 64 and draw_automaton(wide) is None
    assert len(draw_automaton(build_automaton("true | F a")).nodes) == 1


def test_automata_with_cycles_are_drawn():
    automaton = build_automaton("F (a & X b)", ("a", "b", "c"))
    drawing = draw_automaton(automaton)
    assert {node.state for node in drawing.nodes} == {0, 1, 2}


def test_data_in_a_script_stays_data():
    evil = "</script><script>alert(1)</script><!-- & \u2028"
    text = script_json({"name": evil})
    assert "<" not in text and "&" not in text and json.loads(text) == {"name": evil}
    with pytest.raises(ValueError, match="not JSON compliant"):
        script_json(float("nan"))


def test_names_with_markup_show_as_text(replay):
    evil = '<script>alert("x")</script>'
    home = replace(
        replay.home,
        rooms=tuple(replace(room, type=evil) for room in replay.home.rooms),
        containers=tuple(replace(one, type=evil) for one in replay.home.containers),
    )
    page = render_replay(
        replace(replay, home=home, trial_id=evil, task=evil, names=(evil,) * 3,
                runs=tuple(replace(run, planner=evil, error=evil, cost_s=None) for run in replay.runs)),
        command=evil,
    )  # fmt: skip
    assert page.count("<script") == 2 and page.count("</script>") == 2
    assert page.count("&lt;script&gt;alert(&#34;x&#34;)&lt;/script&gt;") > 10


def test_the_page_holds_every_decision(replay):
    page = render_replay(replay)
    for run in replay.runs:
        for number in range(1, len(run.decisions) + 1):
            assert f"decision {number} of {len(run.decisions)}" in page
    assert re.search(r"expected \d+\.\d s to go; it took \d+\.\d s", page)
    assert "Egg then Pillow" in page and len(page.encode()) < 1_000_000


def test_the_scripts_data_is_in_the_pictures_place(replay):
    sheet = Sheet.of(replay.home)
    data = json.loads(script_json(page_data(replay, sheet)))
    assert data["runs"][0]["cost"] == pytest.approx(replay.runs[0].cost_s, abs=1e-3)
    for run in data["runs"]:
        for legs in run["robots"]:
            for before, after in itertools.pairwise(legs):
                assert after[1] == pytest.approx(before[2], abs=2e-3)
                assert np.abs(np.subtract(before[5][-2:], after[5][:2])).max() <= 1
            for leg in legs:
                assert min(leg[5]) >= 0 and max(leg[5][::2]) <= sheet.width and max(leg[5][1::2]) <= sheet.height
    belief = np.array(data["runs"][0]["decisions"][0]["belief"])
    assert belief.shape == (2, 3) and belief.max() <= 1000


def test_an_episode_without_decisions_still_shows_its_drives(replay):
    bare = replace(replay, runs=tuple(replace(run, decisions=()) for run in replay.runs))
    page = render_replay(bare)
    assert "polyline" in page and "decision 1 of" not in page


def test_a_failed_episode_says_so(two_room_home, two_room_map):
    trial = trial_of(two_room_home, two_room_map, objects=("Egg", "Unicorn"))
    result, _, episode = played(trial, two_room_home, two_room_map, "pouct", {"samples": 50})
    automaton = build_automaton(trial.formula, trial.objects)
    replay = make_replay("t", "small", "seq2", automaton, two_room_home, [episode])
    page = render_replay(replay)
    assert result.status == "failed" and "failed: found in no container that can be reached: Unicorn" in page
    assert "the task was not finished" in page


def test_a_trace_of_another_home_is_refused(replay):
    other = replace(replay.home, containers=replay.home.containers[:1])
    run = replay.runs[0]
    episode = Episode(run.planner, run.status, run.cost_s, None, run.trace)
    with pytest.raises(ValueError, match=r"names .* which home .* lacks"):
        make_replay("t", "small", "seq2", replay.automaton, other, [episode])
