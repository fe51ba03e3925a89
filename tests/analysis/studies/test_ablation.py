import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.results.published import load_published
from mrtask.analysis.studies.ablation import COMPARED, WAITS, ArmRows, render_ablation, waiting_shares
from tests.analysis.synthetic import in_homes


def episodes(improvements, seed=0, trials=40, cells=(("small", 1), ("small", 2))):
    """Every planner on the same trials, each cheaper than the learned baseline by its percentage."""
    rng = np.random.default_rng(seed)
    rows = []
    for size_class, robots in cells:
        for number in range(trials):
            base = rng.uniform(80, 120)
            for planner in COMPARED:
                cost_s = base * (1 - improvements.get(planner, 0) / 100) * rng.uniform(0.98, 1.02)
                rows.append(
                    {
                        "trial_id": f"{size_class}-{robots}-{number:03d}",
                        "size_class": size_class,
                        "robots": robots,
                        "planner": planner,
                        "status": "accepted",
                        "cost_s": cost_s,
                        "cost_cells": cost_s / 0.05,
                        "template": ("and2", "seq2")[number % 2],
                        WAITS: [0.25] * (robots - 1) + [0.5],
                    }
                )
    return pd.DataFrame(rows)


def table_rows(page, heading):
    """Label -> text of the entries, of the table's part under a heading."""
    parts = page.split(f"<span>{heading}</span>")
    assert len(parts) == 2, f"{heading} stands {len(parts) - 1} times"
    part = parts[1].split('class="heading"')[0].split("</tbody>")[0]
    return {row.split("</th>")[0]: row.split("</th>")[1] for row in part.split("<tr><th>")[1:]}


def make_page(times=1):
    """Each trial stands in the rows this many times, in the same home."""
    published = load_published().improvement_percent[("learned_myopic", ("small", 1))]
    paper = episodes({"pouct_paper": 0.0, "pouct": 30.0})
    same = episodes({"pouct_paper": published, "pouct": 30.0}, seed=1)
    arms = [
        ArmRows("paper", paper, (), in_detail=True),
        ArmRows("paper + luck", same, ("planner.pouct_paper.luck=true",), in_detail=False, against="paper"),
        ArmRows("step: text", paper, ("a=1",), in_detail=True, is_step=True),
        ArmRows("step: half", episodes({"pouct_paper": 15.0, "pouct": 30.0}), ("b=1",), in_detail=True, is_step=True),
    ]
    return render_ablation([replace(arm, episodes=in_homes(arm.episodes, times)) for arm in arms], "test")


@pytest.fixture(scope="module")
def page():
    return make_page()


def test_repeating_trials_in_their_homes_narrows_no_interval(page):
    again = make_page(times=3)
    for heading in (
        "Points of improvement over learned_myopic",
        "Saved by pouct against each step",
        "Improvement of pouct_paper over learned_myopic",
    ):
        assert table_rows(again, heading) == table_rows(page, heading), heading


def test_waiting_is_what_is_left_of_the_episode():
    legs = [
        [("move", 0, 6), ("wait", 6, 10)],
        [("wait", 0, 1), ("search", 1, 4), ("interact", 4, 5), ("move", 5, 10)],
    ]
    robots = [[{"kind": kind, "t0_s": t0, "t1_s": t1} for kind, t0, t1 in one] for one in legs]
    assert waiting_shares(json.dumps({"robots": robots})) == pytest.approx([0.1, 0.4])
    assert waiting_shares(json.dumps({"robots": [[], []]})) == [0.0, 0.0]


def test_the_answer_counts_published_improvements_inside_some_arms_interval(page):
    published = load_published()
    answer = page.split('class="answer"')[1].split("</section>")[0]
    assert f"1 of {len(published.improvement_percent)}" in answer
    assert "small, 2 robots, over learned_myopic: 8.97 % is in no arm" in answer.replace("&#39;", "'")
    assert "small, 1 robot, over learned_myopic" not in answer


def test_verdicts_stand_beside_every_arm(page):
    rows = table_rows(page.split('id="ours"')[0], "Improvement over learned_myopic")
    assert list(rows) == ["paper", "paper + luck", "step: text", "step: half"]
    assert "<b>0 0 2</b>" in rows["paper"]  # no improvement: below both published ones
    assert "<b>1 1 0</b>" in rows["paper + luck"]  # as published with one robot, more with two
    assert "paper 15.71 %" in rows["paper"]


def test_arms_that_leave_our_planner_as_it_is_are_shown_once(page):
    rows = table_rows(page.split('id="ours"')[1].split('id="switches"')[0], "Improvement over learned_myopic")
    assert list(rows) == ["paper", "paper + luck"]  # the steps change the other planner alone


def test_switches_are_compared_with_the_arm_without_them(page):
    published = load_published().improvement_percent[("learned_myopic", ("small", 1))]
    rows = table_rows(page, "Points of improvement over learned_myopic")
    assert list(rows) == ["paper + luck"]
    points = [float(entry.split("</b>")[0]) for entry in rows["paper + luck"].split("<b>")[1:]]
    assert points == pytest.approx([published] * 3, abs=1)


def test_cells_that_a_switch_moves_are_shown_apart_from_those_it_does_not():
    cells = (("small", 1), ("small", 2), ("large", 1))
    before, moved = (episodes({"pouct_paper": percent}, cells=cells) for percent in (0.0, 20.0))
    as_before = before["trial_id"].str.startswith("small-1")
    after = pd.concat([before[as_before], moved[~as_before]])
    arms = [ArmRows("paper", before, (), True), ArmRows("paper + more", after, (), False, against="paper")]
    rows = table_rows(render_ablation(arms, "test"), "Points of improvement over learned_myopic")
    points = [float(entry.split("</b>")[0]) for entry in rows["paper + more"].split("<b>")[1:]]
    assert points == pytest.approx([0, 20, 20, 20 * 2 / 3], abs=1)


def test_steps_add_up_and_end_at_our_planner(page):
    rows = table_rows(page, "Saved by pouct against each step")
    assert list(rows) == ["step: text", "step: half"]
    assert float(rows["step: text"].split("<b>")[1].split(" %")[0]) == pytest.approx(30, abs=1)
    assert float(rows["step: half"].split("<b>")[1].split(" %")[0]) == pytest.approx(100 * (1 - 70 / 85), abs=1)


def test_templates_and_waiting_are_shown_for_arms_in_detail(page):
    assert list(table_rows(page, "Improvement of pouct over learned_myopic")) == ["paper", "step: text", "step: half"]
    waiting = page.split('id="waiting"')[1]
    assert "<b>25 %</b>" in waiting and "<b>50 %</b>" in waiting
    assert "planner.pouct_paper.luck=true" in page
