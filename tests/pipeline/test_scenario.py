"""The paper's apartments as scenarios: quick planners on the shipped maps, and what the table says."""

import sys
from pathlib import Path

import pytest

from mrtask.analysis.published import load_published
from mrtask.maps.ros_map import read_ros_map
from pipeline import scenario
from pipeline.app.given import SCENARIOS, scenario_names
from pipeline.app.tool import main


def run(monkeypatch: pytest.MonkeyPatch, folder: Path, *arguments: str) -> int:
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["pipeline.scenario", *arguments])
    try:
        main(scenario.run, scenario.__doc__ or "")
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


@pytest.mark.parametrize("number", [1, 2])
def test_the_apartments_hold_what_the_paper_says(number: int) -> None:
    folder = SCENARIOS / f"apartment{number}"
    home = read_ros_map(folder / "map.yaml", folder / "containers.yaml")
    (trial,) = [one for one in load_published().real_world if one.name == f"apartment {number}"]
    assert {container.id for container in home.containers} == set(trial.containers)
    held = {name: container.id for container in home.containers for name in container.objects}
    assert held == dict(trial.objects)


def test_a_scenario_prints_metres_beside_the_published_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    quick = ("likelihood=uniform", "planners=[nonlearned_myopic, learned_myopic]")
    assert run(monkeypatch, tmp_path, "name=apartment2", *quick) == 0
    said = capsys.readouterr().out
    assert "(((!remote & !tv) U laptop) | ((!remote & !tv) U wallet)) & (!tv U remote) & F tv" in said
    assert "myopic 21.88 m, the paper's planner 8.95 m, 59% saved" in said
    assert (tmp_path / "outputs/scenario/apartment2/plans.png").stat().st_size > 10_000
    assert (tmp_path / "outputs/scenario/apartment2/traces/learned_myopic.json").is_file()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["name=apartment9"], "no such scenario; allowed: apartment1, apartment2"),
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
    assert scenario_names() == ["apartment1", "apartment2"]
