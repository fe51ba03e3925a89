"""The paper's apartments as scenarios: quick planners on the shipped maps, and what the table says."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from mrtask.analysis.results.published import load_published
from mrtask.errors import InputError
from mrtask.execution.episode import run_episode
from mrtask.execution.scenario import drawn_worlds, make_scenario
from mrtask.execution.team_spec import Team
from mrtask.maps.home_map import build_map
from mrtask.maps.ros_map import read_ros_map
from mrtask.planning.planners import make_planner
from pipeline import scenario
from pipeline.app.map_task import SCENARIOS, scenario_names
from pipeline.app.tool import main


def run(monkeypatch: pytest.MonkeyPatch, folder: Path, *arguments: str) -> int:
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["pipeline.scenario", *arguments])
    try:
        main(scenario.run, scenario.__doc__ or "")
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


@pytest.mark.parametrize(
    ("name", "number"), [("apartment1", 1), ("apartment1_study", 1), ("apartment2", 2), ("apartment2_study", 2)]
)
def test_the_apartments_hold_what_the_paper_says(name: str, number: int) -> None:
    folder = SCENARIOS / name
    home = read_ros_map(folder / "map.yaml", folder / "containers.yaml")
    (trial,) = [one for one in load_published().real_world if one.name == f"apartment {number}"]
    assert {container.id for container in home.containers} == set(trial.containers)
    held = {name: container.id for container in home.containers for name in container.objects}
    assert held == dict(trial.objects)


@pytest.mark.parametrize("number", [1, 2])
def test_ways_through_the_apartments_are_as_long_as_the_published_ones(number: int) -> None:
    """Who knows where things are drives about what the paper's planner drove, the myopic planner what its one did."""
    folder = SCENARIOS / f"apartment{number}"
    options = yaml.safe_load((folder / "scenario.yaml").read_text())
    home = read_ros_map(folder / "map.yaml", folder / "containers.yaml")
    (trial,) = [one for one in load_published().real_world if one.name == options["published"]]
    given = make_scenario(
        "plan",
        home,
        build_map(home),
        None,
        options["task"],
        Team(options["robots"]),
        start_m=tuple(options["start"]),
        objects=options.get("objects", ()),
    )
    for planner, published_m in (("nonlearned_myopic", trial.myopic_m), ("known", trial.planner_m)):
        own = {"samples": 100} if planner == "known" else {}
        result = run_episode(given.trial, given.home, given.home_map, given.likelihood, make_planner(planner, own))
        assert scenario.metres(result)[0] == pytest.approx(published_m, abs=0.2)


def test_a_scenario_prints_metres_beside_the_published_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    quick = ("likelihood=uniform", "planners=[nonlearned_myopic, learned_myopic]")
    assert run(monkeypatch, tmp_path, "name=apartment2", *quick) == 0
    said = capsys.readouterr().out
    assert "(((!remote & !tv) U laptop) | ((!remote & !tv) U wallet)) & (!tv U remote) & F tv" in said
    assert [line.split() for line in said.splitlines() if line.split()[:1] == ["bed"]] == [
        ["bed", "*0.100", "0.100", "0.100", "0.100"]
    ]
    assert "myopic 21.88 m, the paper's planner 8.95 m, 59% saved" in said
    assert (tmp_path / "outputs/scenario/apartment2/plans.png").stat().st_size > 10_000
    assert (tmp_path / "outputs/scenario/apartment2/traces/learned_myopic.json").is_file()
    page = (tmp_path / "outputs/scenario/apartment2/replay.html").read_text()
    assert "<h1>laptop or wallet, then remote, then tv</h1>" in page
    assert all(label in page for label in ("learned_myopic", "nonlearned_myopic", "pipeline.scenario"))


def test_objects_and_places_may_have_names_that_formulas_quote() -> None:
    folder = SCENARIOS / "apartment1"
    home = read_ros_map(folder / "map.yaml", folder / "containers.yaml")
    first, *others = home.containers
    renamed = replace(first, id="desk-1", objects=("c-clamp",))
    home = replace(home, containers=(renamed, *others))
    given = make_scenario("dash", home, build_map(home), None, "bring the c-clamp to desk 1", Team(1))
    assert given.trial.formula == 'F ("c-clamp" & X F "desk-1")' and given.trial.objects == ("c-clamp", "desk-1")
    assert given.likelihood[:, 1].tolist() == [1.0] + [0.0] * len(others)
    result = run_episode(given.trial, given.home, given.home_map, given.likelihood, "greedy")
    assert result.status == "accepted" and [one.object for one in result.trace.letters] == ["c-clamp", "desk-1"]


def test_worlds_are_drawn_by_the_likelihoods_with_every_object_somewhere() -> None:
    folder = SCENARIOS / "apartment2"
    home = read_ros_map(folder / "map.yaml", folder / "containers.yaml")
    scenario = make_scenario("drawn", home, build_map(home), None, "laptop and tv", Team(2))
    likelihood = np.array([[0.0, 0.0], [0.1, 0.0], [0.5, 0.0], [0.0, 0.0], [0.0, 0.2]])
    worlds = drawn_worlds(replace(scenario, likelihood=likelihood), 2000, seed=1)
    held = np.array(
        [[[name in one.objects for name in ("laptop", "tv")] for one in world.containers] for world in worlds]
    )
    assert held.any(axis=1).all()
    somewhere = 1 - np.prod(1 - likelihood, axis=0)
    assert np.abs(held.mean(axis=0) - likelihood / somewhere).max() < 0.04
    with pytest.raises(InputError, match="tv can be nowhere"):
        drawn_worlds(replace(scenario, likelihood=likelihood * [1.0, 0.0]), 1, seed=1)


def test_drawn_worlds_are_told_beside_the_given_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    quick = ("likelihood=uniform", "planners=[nonlearned_myopic]", "drawn_worlds=3", "seeds=1")
    assert run(monkeypatch, tmp_path, "name=apartment2", *quick) == 0
    told = capsys.readouterr().out.split("over 3 worlds drawn from these likelihoods")
    assert len(told) == 2
    assert "nonlearned_myopic" in told[1]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["name=apartment9"], "no such scenario; allowed: apartment1, apartment1_study"),
        ([], "a value is needed for map, containers, task"),
        (["name=apartment1", "task=bring the pillow to the couch"], "deliveries (to couch) are for one robot"),
        (["name=apartment1", "task=lamp"], "'lamp' is not an object here"),
        (["name=apartment1", "start=[0, 60]"], "the nearest such place is"),
        (["name=apartment1", "robot=2"], "robot: no such key; did you mean robots?"),
        (["name=apartment1", "planners=[best]"], "unknown planner 'best'"),
    ],
)
def test_mistakes_are_told(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(monkeypatch, tmp_path, "likelihood=uniform", *arguments) == 2
    assert said in capsys.readouterr().err


def test_every_scenario_is_named() -> None:
    assert scenario_names() == ["apartment1", "apartment1_study", "apartment2", "apartment2_study"]
