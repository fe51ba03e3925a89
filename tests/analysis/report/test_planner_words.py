"""The planners in words: what each row says follows from the options that the run recorded."""

import dataclasses

import pytest

from mrtask.analysis.report.planner_words import (
    DESCRIPTIONS,
    departures,
    describe_planners,
    homes_sentence,
    known_sentence,
    protocol,
)
from mrtask.analysis.report.report_data import collect_report_data
from mrtask.analysis.report.report_page import render_report
from mrtask.analysis.report.sections import SECTIONS
from mrtask.planning.paper.planner import PaperOptions
from mrtask.planning.planners import PLANNERS
from tests.analysis.synthetic import make_episodes

TEXT = PaperOptions(leaf="nearest", max_actions=None, exists=False)
"""A reading of the paper's text."""


def manifest(**options):
    return {"planner_options": {"pouct_paper": options, "pouct": {"samples": 100000, "reassign": "all"}}}


def words(options):
    data = collect_report_data(make_episodes(2), manifest(**dataclasses.asdict(options)), {})
    return dict(describe_planners(data))["pouct_paper"], protocol(data, "pouct_paper")


def test_every_planner_of_ours_has_a_description():
    assert set(DESCRIPTIONS) == set(PLANNERS)


def test_the_papers_planner_by_default_is_not_the_papers_as_written():
    text, name = words(PaperOptions())
    assert "It is not the planner as the paper's text has it, but has our own value of leaves" in text
    for part in ("our condition that every object is somewhere", "the authors' code's cut to the 8 likeliest actions"):
        assert part in text and part in name
    text, name = words(TEXT)
    assert "Its options are a reading of the paper's text." in text and name == "pouct_paper"


@pytest.mark.parametrize("option", [field.name for field in dataclasses.fields(PaperOptions) if "|" not in field.name])
def test_each_switch_of_the_protocol_is_named(option):
    """A switch added later must be put into words too; those that only tune the search are listed here."""
    other = {
        "leaf": "revealed",
        "choice": "visits",
        "max_actions": 8,
        "avoid_targets": True,
        "advance_when_alone": True,
        "round_decimals": 2,
        "exists": True,
        "reassign": "all",
    }
    if option not in other:
        assert option in ("samples", "time_limit_s", "exploration", "max_nodes", "exploration_unit")
        return
    changed = dataclasses.replace(TEXT, **{option: other[option]})
    assert len(departures(dataclasses.asdict(changed))) == 1 and not departures(dataclasses.asdict(TEXT))


def test_samples_are_at_most_what_was_allowed_with_the_mean_over_decisions():
    frame = make_episodes(2, ["pouct", "greedy"]).assign(samples=640, decisions=10)
    found = dict(describe_planners(collect_report_data(frame, manifest(), {})))
    assert "At most 100,000 samples a decision, 64 on average" in found["pouct"]
    assert "samples" not in found["greedy"]


def test_a_variant_is_described_as_what_it_is_and_a_users_planner_by_its_path():
    frame = make_episodes(2, ["pouct", "quick", "mine"])
    behind = {"behind": {"quick": "pouct", "mine": "my_lab.Mine"}, "planner_options": {"quick": {"reassign": "free"}}}
    found = dict(describe_planners(collect_report_data(frame, behind, {})))
    assert found["quick"].startswith("Our planner:") and "redirect" not in found["quick"]
    assert "my_lab.Mine" in found["mine"]


def test_baselines_costs_are_compared_with_the_published_ones():
    frame = make_episodes(2, ["nonlearned_myopic", "pouct"], ["small", "large"], [1])
    for size_class, cells in (("small", 156.43), ("large", 706.81)):
        frame.loc[(frame["size_class"] == size_class) & (frame["planner"] == "nonlearned_myopic"), "cost_cells"] = cells
    data = collect_report_data(frame, {}, {})
    text = homes_sentence(data.summary, data.published)
    assert "50 to 50 % in small homes and 50 to 50 % in large homes of what the paper prints" in text
    only_ours = collect_report_data(make_episodes(2, ["pouct"]), {}, {})
    assert homes_sentence(only_ours.summary, only_ours.published) is None


def test_the_page_says_it_all():
    facts = manifest(**dataclasses.asdict(PaperOptions())) | {"model": {"kind": "similarity"}}
    page = render_report(make_episodes(3), facts, {}).page
    method, checklist = page[page.index('id="method"') :], page[page.index('id="claims"') :]
    assert "the model similarity: not the paper&#39;s network" in method
    assert "pouct_paper (the paper&#39;s text with our own value of leaves" in checklist
    assert "which our simulations do not repeat" not in page and "pipeline.scenario</code> plays them" in method


def test_known_is_a_reference_where_it_was_searched_and_a_bound_where_it_was_exact():
    frame = make_episodes(2, ["pouct", "known"], ["small"], [1, 2])
    own, small_teams = frame["planner"] == "known", frame["robots"] == 1
    assert known_sentence(frame) == "known was searched in all of its 4 episodes: it is a reference here, not a bound."
    frame.loc[own & small_teams, "samples"] = 0
    assert "exactly in 2 of its 4 episodes (0 samples)" in known_sentence(frame)
    assert "a reference, not a bound, in the others" in known_sentence(frame)
    frame.loc[own, "samples"] = 0
    assert "exactly in all of its 4 episodes" in known_sentence(frame) and "bound" not in known_sentence(frame)
    assert known_sentence(frame[~own]) is None
    assert "did not record" in known_sentence(frame.drop(columns="samples"))


def test_known_is_explained_beside_every_gap_to_it():
    data = collect_report_data(make_episodes(2, ["learned_myopic", "pouct", "known"]), {}, {})
    said = "it is a reference here, not a bound"
    for name in ("table", "planners", "method", "papers"):
        section = next(one for one in SECTIONS if one.anchor == name)
        assert said in section.content(data).html, name
    figures = next(one for one in SECTIONS if one.anchor == "figures").content(data)
    assert said in next(one for one in figures.pictures if one.name == "improvement").caption
