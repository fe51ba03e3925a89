"""What every stage says with dry_run=true, and that it leaves nothing behind."""

import json
from pathlib import Path

import pytest

from mrtask.cli import STAGES
from mrtask.homes.generator.house import generate_house
from tests.homes.made_up_votes import write, write_splits
from tests.pipeline.harness import Cli, Workspace

SAYS = {
    "reproduce": ("would train frequency", "24 episodes", "no episode was written", "would write the report"),
    "homes": ("there already: 24 homes",),
    "dataset": ("would label",),
    "train": ("would train frequency",),
    "evaluate": ("24 episodes", " on 2 workers, ", " CPU hours; no episode was written"),
    "report": ("on 24 episodes is up to date",),
    "realism": ("would make or read procthor homes", "there already: 24 homes", "would compare them"),
    "housekeep": ("would train frequency on human",),
    "ablation": ("would compare 2 arms in 1 evaluation", "no episode was written"),
    "sensitivity": ("would compare 2 arms in 1 evaluation", "no episode was written"),
    "priors": ("would compare 1 arm in 1 evaluation", "no episode was written"),
    "optimality": ("would assess 3 trials, each in 2 worlds", "0 are done"),
    "replay": ("would replay trial small-1-000 by pouct, nonlearned_myopic",),
}
"""Of each stage in a folder where homes, model, episodes and report exist."""
OPTIONS = {
    "realism": ("homes=procthor", "homes.files=[real.jsonl]", "realism.generated_test=9"),
    "housekeep": ("housekeep.models=[frequency]", "housekeep.trained_on=[human]"),
    "ablation": (
        "ablation.switches=[]",
        "ablation.steps=[{name: first, overrides: 'planner.pouct_paper.exploration=0.7'}]",
        "planner.pouct_paper.samples=20",
    ),
    "sensitivity": ("sensitivity.factors=[{name: share, key: likelihood.uniform_mix, values: [0, 1]}]",),
    "priors": ("priors.contents=[procthor]", "priors.trained_on=[procthor]", "priors.others=[]"),
    "optimality": (
        "optimality.planners=[greedy]",
        "optimality.worlds=2",
        "optimality.trials_per_cell=1",
        "evaluation.robots=[1]",
    ),
    "replay": ("trial_id=small-1-000",),
}


def files(folder: Path) -> dict[Path, bytes]:
    """The files of a folder with their content; the database of MLflow counts its readers."""
    return {
        path: b"" if path.name.startswith("mlflow") else path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.fixture
def votes_and_houses(tmp_path: Path) -> tuple[str, ...]:
    """What some stages need besides, in a folder of its own."""
    write(tmp_path / "votes.npy")
    write_splits(tmp_path / "splits.yaml")
    (tmp_path / "real.jsonl").write_text(json.dumps(generate_house(900, "small")) + "\n")
    return (
        f"contents.file={tmp_path / 'votes.npy'}",
        "contents.sha256=null",
        f"contents.splits={tmp_path / 'splits.yaml'}",
    )


@pytest.fixture(autouse=True)
def _a_short_pilot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.episodes.runner.PILOT_S", 0.1)


@pytest.mark.parametrize("stage", STAGES)
def test_a_dry_run_says_what_the_stage_would_do_and_leaves_nothing(
    stage: str, workspace: Workspace, cli: Cli, tmp_path: Path, votes_and_houses: tuple[str, ...]
) -> None:
    options = [one.replace("real.jsonl", str(tmp_path / "real.jsonl")) for one in OPTIONS.get(stage, ())]
    before = files(workspace.path)
    done = cli(
        stage, *workspace.overrides, *votes_and_houses, *options, "dry_run=true", "draw=true", cwd=workspace.path
    )
    assert done.code == 0, done.err
    assert "== dry run: nothing is written" in done.out
    for text in SAYS[stage]:
        assert text in done.out
    assert files(workspace.path) == before


@pytest.mark.parametrize("stage", STAGES)
def test_a_dry_run_where_nothing_is_made_yet_makes_nothing(
    stage: str, workspace: Workspace, cli: Cli, tmp_path: Path, votes_and_houses: tuple[str, ...]
) -> None:
    before = files(tmp_path)
    done = cli(stage, *workspace.overrides, *votes_and_houses, *OPTIONS.get(stage, ()), "dry_run=true")
    needs_results = stage in ("report", "replay")
    assert done.code == (2 if needs_results else 0), done.err
    assert ("python -m pipeline.evaluate" in done.err) if needs_results else ("would" in done.out)
    assert files(tmp_path) == before
