import pytest

from mrtask.analysis.results.published import PAPERS_PLANNER, load_published, published_counterpart
from mrtask.tasks.automaton import build_automaton

CELLS = [(size_class, robots) for size_class in ("small", "medium", "large") for robots in (1, 2, 3)]


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("baseline", ["nonlearned_myopic", "learned_myopic"])
def test_printed_improvements_follow_from_printed_means(baseline, cell):
    published = load_published()
    ratio = published.cost_of("pouct", cell) / published.cost_of(baseline, cell)
    assert published.improvement_of("pouct", baseline, cell) == pytest.approx(100 * (1 - ratio), abs=0.011)


def test_table_is_whole():
    published = load_published()
    assert len(published.cost_cells) == 27
    assert len(published.improvement_percent) == 18
    assert published.cost_of("learned_myopic", ("medium", 2)) == 368.57
    assert published.cost_of(PAPERS_PLANNER, ("large", 3)) == 429.83
    assert "2603.20544" in published.citation


def test_what_stands_beside_what():
    published = load_published()
    assert published_counterpart("my_lab.planners.Mine") == PAPERS_PLANNER
    assert published.cost_of("greedy", ("small", 1)) is None
    assert published.cost_of("pouct", ("small", 4)) is None
    assert published.improvement_of("known", "learned_myopic", ("small", 1)) is None
    assert published.improvement_of("learned_myopic", "learned_myopic", ("small", 1)) is None
    assert published.improvement_of("learned_myopic", "nonlearned_myopic", ("small", 1)) == pytest.approx(
        100 * (1 - 255.34 / 312.86)
    )


def test_real_world_trials():
    first, second = load_published().real_world
    assert (first.myopic_m, first.planner_m, len(first.containers)) == (23.72, 7.79, 9)
    assert (second.myopic_m, second.planner_m, len(second.containers)) == (21.88, 8.95, 5)
    for trial in (first, second):
        assert set(trial.objects.values()) <= set(trial.containers)
    automaton = build_automaton(second.formula)
    words = {
        ("laptop", "remote", "tv"): True,
        ("wallet", "remote", "tv"): True,
        ("laptop", "tv"): False,
        ("laptop",): False,
    }
    for word, good in words.items():
        state = automaton.initial
        for name in word:
            state = automaton.transitions[state, automaton.propositions.index(name)]
        assert automaton.accepting[state] == good, word
