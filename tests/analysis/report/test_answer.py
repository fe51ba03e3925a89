import numpy as np
import pandas as pd
import pytest

from mrtask.analysis.report.answer import find, mixture_warnings, partial_results
from mrtask.analysis.results.episodes import checked_episodes
from mrtask.analysis.results.published import load_published
from mrtask.analysis.results.roles import main_planner
from mrtask.analysis.results.statistics import summarise
from tests.analysis.synthetic import fail, make_episodes, rows


def findings_of(frame: pd.DataFrame, planner: str | None = "pouct"):
    found = find(summarise(checked_episodes(frame)), load_published(), planner)
    clean = [text.replace("\N{NO-BREAK SPACE}", " ") for text in (found.headline, *found.sentences, *found.warnings)]
    return found, " ".join(clean)


def cell_costs(**factors):
    """40 trials in which each planner's cost is its factor times a common one, with 5 % of noise."""
    rng = np.random.default_rng(3)
    common = rng.uniform(10, 20, 40)
    return rows("medium", 2, {name: common * factor * rng.lognormal(0, 0.05, 40) for name, factor in factors.items()})


@pytest.mark.parametrize(
    ("factors", "verdict"),
    [
        ({"learned_myopic": 1.5, "nonlearned_myopic": 2.0}, "Yes"),
        ({"learned_myopic": 0.8, "nonlearned_myopic": 0.7}, "No"),
        ({"learned_myopic": 0.8, "nonlearned_myopic": 1.5}, "Only in part"),
        ({"learned_myopic": 1.0, "nonlearned_myopic": 1.5}, "Only in part"),
        ({"learned_myopic": 1.0, "nonlearned_myopic": 1.0}, "Not shown"),
        ({"learned_myopic": 1.5}, "Yes"),
        ({"greedy": 1.5}, "No answer"),
    ],
)
def test_verdict(factors, verdict):
    assert findings_of(cell_costs(pouct=1.0, **factors))[0].verdict == verdict


def test_words_of_a_planner_that_wins():
    costs = {"pouct": [3.0], "learned_myopic": [5.0], "known": [2.0], "greedy": [4.0]}
    _, text = findings_of(rows("medium", 2, {planner: 12 * cost for planner, cost in costs.items()}))
    assert "Over 12 paired trials, pouct's mean time is 40.0 % lower than learned_myopic's (95 %" in text
    assert "95 % interval 40.0 to 40.0" in text
    assert "better in 1 of 1 cell of size class and team size, clearly (the interval excludes zero) in 1." in text
    assert "of 1 published improvement for these cells, ours is above 1 (its whole interval in 1)" in text
    assert "on average 40.0 % against 17.5 % published" in text
    assert "Its mean time is 25.0 % lower than greedy's" in text
    assert "Of what knowing all contents would save over learned_myopic, it saves 66.7 %" in text
    assert "Fewer than 30 paired trials in 1 of 1 cell (the fewest: 12 in medium, 2 robots)" in text


def test_the_headline_says_what_the_mean_hides():
    baseline = [10.0, 10.0, 10.0, 10.0, 100.0]
    _, text = findings_of(rows("medium", 2, {"pouct": [10.0, 10.0, 9.0, 12.0, 20.0], "learned_myopic": baseline}))
    assert "pouct's mean time is 56.4 % lower than learned_myopic's" in text
    assert "the median saving is 0.0 %, 40 % are ties, and in 20 % it is later." in text


def test_words_of_a_planner_that_loses():
    frame = rows("medium", 2, {"pouct": [6.0] * 10, "learned_myopic": [5.0] * 10})
    found, text = findings_of(frame)
    assert found.verdict == "No"
    assert "20.0 % higher than learned_myopic's (improvement -20.0 %, 95 % interval -20.0 to -20.0)" in text
    assert "better in 0 of 1 cell" in text and "and clearly worse in 1." in text


def test_words_of_equals():
    _, text = findings_of(rows("small", 1, {"pouct": [2.0, 3.0], "learned_myopic": [2.0, 3.0]}))
    assert "mean time is equal to learned_myopic's" in text


def test_no_episodes_and_none_finished():
    empty = make_episodes(1).head(0)
    assert findings_of(empty, None)[0].headline == "There are no episodes yet."
    frame = rows("small", 1, {"pouct": [None, 1.0], "learned_myopic": [2.0, None]})
    _, text = findings_of(frame)
    assert "cannot be compared with the baselines: no trial was finished by both it and a baseline" in text
    assert "learned_myopic finished 1 trial that pouct did not" in text


def test_one_planner_only():
    _, text = findings_of(make_episodes(2, ["pouct"]))
    assert "none of the baselines nonlearned_myopic and learned_myopic ran" in text
    _, text = findings_of(make_episodes(2, ["nonlearned_myopic"]), "nonlearned_myopic")
    assert "none of the baselines learned_myopic ran" in text


@pytest.mark.parametrize("count", [1, 2, 9])
def test_too_few_trials_show_nothing(count):
    found, text = findings_of(rows("small", 1, {"pouct": [1.0] * count, "learned_myopic": [2.0] * count}))
    assert found.verdict == "Not shown" and "too few trials for an interval" in text


def test_a_users_planner_is_measured_against_the_papers():
    frame = make_episodes(4, ["learned_myopic", "my_lab.planners.Mine"], ["small"])
    _, text = findings_of(frame, "my_lab.planners.Mine")
    assert "Mine's mean time is" in text and "of 3 published improvements" in text


def test_errors_and_timeouts_are_named():
    frame = make_episodes(4, ["learned_myopic", "pouct"], ["small"], [1])
    frame = fail(fail(frame, frame.index.to_series() < 3, "error"), frame.index.to_series() == 7, "timeout")
    _, text = findings_of(frame)
    assert "3 episodes ended with status error (learned_myopic 2, pouct 1)." in text
    assert "1 episode ended with status timeout (pouct 1)." in text


def test_mixed_runs_are_named():
    frame = make_episodes(4, ["pouct"], ["small"], [1]).assign(config_hash="a", code_version="v1")
    frame.loc[0, "code_version"] = "v2"
    assert mixture_warnings(frame) == ["The episodes mix 2 values of code_version (v1, v2); compare with care."]
    assert mixture_warnings(frame.assign(sweep=["a", "b", "a", "b"], config_hash=list("xyxy"), code_version="v1")) == []


@pytest.mark.parametrize(
    ("planners", "wanted", "main"),
    [
        (("learned_myopic", "greedy", "pouct", "known"), None, "pouct"),
        (("learned_myopic", "greedy", "pouct"), "greedy", "greedy"),
        (("learned_myopic", "greedy", "pouct"), "absent", "pouct"),
        (("greedy", "my_lab.Mine"), None, "my_lab.Mine"),
        (("nonlearned_myopic", "learned_myopic"), None, "learned_myopic"),
        ((), None, None),
    ],
)
def test_main_planner(planners, wanted, main):
    assert main_planner(planners, wanted) == main


def partial(frame: pd.DataFrame) -> list[str]:
    return list(partial_results(summarise(checked_episodes(frame))))


def test_a_whole_run_lacks_nothing():
    assert partial(make_episodes(3, ["learned_myopic", "pouct"])) == []
    one_unlucky = rows("small", 1, {"pouct": [1.0] * 39 + [None]})
    assert partial(one_unlucky) == [], "the table counts it; a warning would hide worse"


def test_what_is_partial_is_said():
    whole = {"learned_myopic": [1.0, 2.0, 3.0, 4.0]}
    assert partial(rows("small", 1, whole | {"pouct": [None] * 4})) == [
        "pouct finished none of its 4 episodes: it has no mean cost."
    ]
    assert partial(rows("small", 1, whole | {"pouct": [1.0, 2.0, 3.0, None]})) == [
        "pouct finished 3 of 4 episodes: the others are in no mean."
    ]
    large = rows("large", 1, {"learned_myopic": [1.0], "pouct": [None]})
    assert partial(pd.concat([rows("small", 1, whole | {"pouct": [1.0] * 4}), large])) == [
        "pouct finished 4 of 5 episodes and none in large, 1 robot: means over all cells leave these out."
    ]


def test_missing_cells_are_named_or_counted():
    small, large = (rows(size, 1, {"learned_myopic": [1.0] * 2}) for size in ("small", "large"))
    own = rows("small", 1, {"pouct": [1.0] * 2})
    assert partial(pd.concat([small, large, own])) == [
        "pouct did not run in large, 1 robot: it is compared on fewer trials."
    ]
    more = [rows("medium", team, {"learned_myopic": [1.0] * 2}) for team in (1, 2, 3)]
    assert partial(pd.concat([small, large, own, *more])) == [
        "pouct did not run in 4 cells: it is compared on fewer trials."
    ]


def test_a_single_trial_is_called_one():
    assert partial(rows("small", 1, {"pouct": [1.0], "learned_myopic": [2.0]})) == [
        "There is a single trial: it shows what happened once, not what to expect."
    ]
