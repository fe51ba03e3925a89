"""The table of planners: one entry is all that a planner needs to be run, ordered, compared and drawn."""

import pytest

from mrtask.analysis.page.style import planner_label, planner_looks
from mrtask.analysis.results.roles import main_planner
from mrtask.planning.greedy import Greedy
from mrtask.planning.planners import (
    PAPERS_PLANNER,
    PLANNERS,
    PlannerEntry,
    Role,
    make_planner,
    planner_role,
    planners_in_order,
    published_counterpart,
)


@pytest.fixture
def extended(monkeypatch):
    monkeypatch.setitem(
        PLANNERS, "paper_text", PlannerEntry("greedy.Greedy", Role.REFERENCE, published_as=PAPERS_PLANNER)
    )
    monkeypatch.setitem(PLANNERS, "lower_bound", PlannerEntry("greedy.Greedy", Role.BOUND))


def test_a_new_entry_is_ordered_compared_and_drawn(extended):
    names = ["lower_bound", "lab.Mine", "paper_text", *PLANNERS]
    assert planners_in_order(names)[-5:] == ("pouct", "paper_text", "lab.Mine", "known", "lower_bound")
    assert published_counterpart("paper_text") == PAPERS_PLANNER and published_counterpart("lower_bound") is None
    assert main_planner(["learned_myopic", "paper_text", "lower_bound"]) == "paper_text"
    assert isinstance(make_planner("paper_text"), Greedy)
    looks = planner_looks(names)
    assert len(set(looks.values())) == len(set(names))
    assert planner_looks(["lower_bound"]) == {"lower_bound": looks["lower_bound"]}


def test_a_planner_outside_the_table_has_defaults():
    assert planner_role("lab.Mine") is Role.OURS and planner_label("lab.Mine") == "Mine"
    assert published_counterpart("lab.Mine") == PAPERS_PLANNER
    own = [f"lab.Planner{number}" for number in range(20)]
    assert len(set(planner_looks([*PLANNERS, *own]).values())) == len(PLANNERS) + len(own)
