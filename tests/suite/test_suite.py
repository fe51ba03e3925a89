"""The frozen suite: it is what was published, scores do not depend on workers, and the card says what it should."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mrtask.errors import InputError
from mrtask.planning.myopic import NonlearnedMyopic
from mrtask.planning.problem import Plan, PlanningProblem
from mrtask.suite import frozen, score
from mrtask.suite.card import render_card
from mrtask.suite.frozen import SUITES, SuiteError, load_suite, read_suite, write_suite
from mrtask.suite.recorded import PLANNERS, recorded_episodes
from mrtask.suite.score import Request, score_planner
from tests.analysis.synthetic import in_homes

FOLDER = Path(frozen.__file__).parent
SOME = (0, 59, 60, 119, 121, 179)
"""Trials of every size class, of one to three robots."""


@pytest.fixture(autouse=True, scope="module")
def _maps(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Maps are made once for this module's tests."""
    folder = tmp_path_factory.mktemp("maps")
    score._map_cache.cache_clear()
    patch = pytest.MonkeyPatch()
    patch.setenv("MRTASK_CACHE_DIR", str(folder))


class FailsInLargeHomes:
    """The non-learned baseline with a bug."""

    def __init__(self) -> None:
        self._rule = NonlearnedMyopic()

    def plan(self, problem: PlanningProblem, seed: int) -> Plan:
        if len(problem.robots) == 3:
            raise RuntimeError("this planner has a bug")
        return self._rule.plan(problem, seed)


@pytest.mark.parametrize("name", SUITES)
def test_a_suite_is_whole(name: str) -> None:
    suite = load_suite(name)
    assert {trial.home_id for trial in suite.trials} <= set(suite.homes)
    assert len({trial.trial_id for trial in suite.trials}) == len(suite.trials) == 180
    cells = pd.Series([(trial.size_class, trial.team.robots) for trial in suite.trials]).value_counts()
    assert set(cells) == {20} and len(cells) == 9
    for trial in suite.trials:
        home = suite.homes[trial.home_id]
        assert home.size_class == trial.size_class
        probs = suite.table.matrix(home, trial.objects)
        assert probs.shape == (len(home.containers), len(trial.objects)) and (probs > 0).all() and (probs < 1).all()


def test_the_card_is_the_same_on_any_number_of_workers() -> None:
    suite, recorded = load_suite(), recorded_episodes(load_suite())
    one, two = (score_planner(Request("nonlearned_myopic", workers=workers, trials_per_cell=3)) for workers in (1, 2))
    assert len(one) == 27
    recorded = recorded[recorded["trial_id"].isin(one["trial_id"])]
    homes = {trial.trial_id: trial.home_id for trial in suite.trials}
    assert one["cost_s"].tolist() == two["cost_s"].tolist()
    cards = [render_card("nonlearned_myopic", {}, rows, recorded, suite.name, homes) for rows in (one, two)]
    assert cards[0] == cards[1]
    assert "27 trials" in cards[0] and "not finished" not in cards[0]
    # And it is the recorded one, to the last bit.
    known = recorded[recorded["planner"] == "nonlearned_myopic"].set_index("trial_id")["cost_s"]
    assert known[one["trial_id"]].tolist() == one["cost_s"].tolist()


@pytest.mark.parametrize("planner", PLANNERS)
def test_recorded_scores_are_those_of_this_version(planner: str) -> None:
    known = recorded_episodes(load_suite()).set_index(["planner", "trial_id"])["cost_s"]
    for number in SOME:
        row = score._episode(Request(planner, PLANNERS[planner]), number)
        assert row["cost_s"] == known[planner, row["trial_id"]], "run benchmarks/record_scores.py"


def test_a_bug_in_a_planner_is_a_row_and_is_told() -> None:
    rows = [score._episode(Request(f"{__name__}.FailsInLargeHomes"), number) for number in SOME]
    episodes = pd.DataFrame(rows)
    assert (episodes["status"] == "error").tolist() == (episodes["robots"] == 3).tolist()
    recorded = recorded_episodes(load_suite())
    recorded = recorded[recorded["trial_id"].isin(episodes["trial_id"])]
    card = render_card(rows[0]["planner"], {}, episodes, recorded, "x", dict.fromkeys(episodes["trial_id"], "home"))
    unfinished = int((episodes["robots"] == 3).sum())
    assert f"{unfinished} trials were not finished" in card


def test_the_card_by_hand() -> None:
    """Four trials: means, improvements and profiles that can be checked in one's head."""
    costs = {
        "nonlearned_myopic": [10.0, 20.0, 30.0, 40.0],
        "learned_myopic": [10.0, 10.0, 20.0, 40.0],
        "known": [1.0, 1.0, 1.0, 1.0],
        "my_lab.Mine": [5.0, 10.0, 30.0, np.nan],
    }
    rows = pd.DataFrame(
        [
            {"trial_id": f"small-1-{number:03d}", "planner": name, "cost_s": cost, "size_class": "small", "robots": 1}
            for name, values in costs.items()
            for number, cost in enumerate(values)
        ]
    )
    mine = rows["planner"] == "my_lab.Mine"
    homes = dict(zip(rows["trial_id"], rows["trial_id"].str[-1:].replace("3", "2"), strict=True))
    card = render_card("my_lab.Mine", {"margin_s": 2}, rows[mine], rows[~mine], "a-suite", homes)
    assert card.startswith("my_lab.Mine (margin_s=2) on a-suite: 4 trials in 3 homes")
    lines = [re.sub(r"[\[\],]", "", line).split() for line in card.splitlines()]
    # 45 / 60 and 45 / 40 on the three trials that it finished.
    assert [">", "Mine", "3", "15.000", "25.0", "-12.5"] in lines
    # Best of those that do not know: 5, 10, 20, 40. Mine: 1, 1, 1.5, never.
    assert [">", "Mine", "50.0%", "50.0%", "50.0%", "75.0%", "75.0%"] in lines
    assert ["learned_myopic", "75.0%", "75.0%", "75.0%", "75.0%", "100.0%"] in lines
    assert "1 trials were not finished" in card


def test_the_card_knows_that_trials_share_homes() -> None:
    """Twelve trials, each three times in its home, have the intervals of twelve trials."""
    rng = np.random.default_rng(0)
    rows = [
        {"trial_id": f"small-1-{number:03d}", "planner": name, "cost_s": cost, "size_class": "small", "robots": 1}
        for number in range(12)
        for name, cost in (("learned_myopic", rng.uniform(5, 15)), ("my_lab.Mine", rng.uniform(3, 12)))
    ]
    cards = []
    for times in (1, 3):
        frame = in_homes(pd.DataFrame(rows), times)
        mine = frame["planner"] == "my_lab.Mine"
        homes = dict(zip(frame["trial_id"], frame["home_id"], strict=True))
        cards.append(render_card("my_lab.Mine", {}, frame[mine], frame[~mine], "a-suite", homes))
    found = [re.findall(r"\[.*?\]", card) for card in cards]
    assert found[0] == found[1] and len(found[0]) == 2


def test_homes_mapped_otherwise_are_refused() -> None:
    suite = load_suite()
    home_id = suite.trials[0].home_id
    assert suite.map_of(home_id).home_id == home_id
    longer = suite.travel_mm[home_id].copy()
    longer[longer > 0] += 2
    other = dataclasses.replace(suite, travel_mm={home_id: longer})
    with pytest.raises(SuiteError, match=rf"maps home {home_id} in another way"):
        other.map_of(home_id)


def test_a_suite_comes_back_as_it_was_written(tmp_path: Path) -> None:
    suite = load_suite()
    homes = list(suite.homes.values())[:2]
    trials = [trial for trial in suite.trials if trial.home_id in {home.id for home in homes}]
    first, second = (write_suite(tmp_path / name, "x", homes, trials, suite.table) for name in ("a", "b"))
    assert first == second
    again = read_suite(tmp_path / "a")
    assert list(again.homes.values()) == homes and list(again.trials) == trials
    assert (again.table.probs == suite.table.probs).all()
    assert all((again.travel_mm[home.id] == suite.travel_mm[home.id]).all() for home in homes)


def test_what_is_wrong_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SuiteError, match=r"unknown suite 'mrtask-0'; allowed: mrtask-1"):
        load_suite("mrtask-0")
    monkeypatch.setitem(SUITES, "mrtask-2", "0" * 64)  # type: ignore[arg-type]
    with pytest.raises(SuiteError, match=r"mrtask-2\.json\.gz is missing; install mrtask again"):
        load_suite("mrtask-2")
    for given, said in (
        ([], "give one planner to score, not none"),
        (["pouct", "speed=3"], "speed: no such key; allowed: options, suite, workers, trials_per_cell, out"),
        (["pouct", "workers=0"], "workers=0: must be a whole number, at least 1"),
        (["pouct", "options=[1]"], r"options=\[1\]: must be names and values"),
        (["pouct", "options={a: ["], r"options=\{a: \[: must be names and values"),
    ):
        with pytest.raises(InputError, match=said):
            Request.parse(given)
    assert score.main(["nobody"]) == 2
    assert "unknown planner 'nobody'" in capsys.readouterr().err
    assert Request.parse(["pouct", "options={samples: 5}", "workers=3"]) == Request(
        "pouct", {"samples": 5}, "mrtask-1", 3
    )
    assert len(Request("pouct", trials_per_cell=2).trial_numbers()) == 18
