"""Priors from the command line, in small."""

from pathlib import Path

import pandas as pd
import pytest

from tests.homes.made_up_votes import write
from tests.pipeline.harness import SMALL, Cli

CONTENTS = ("contents.file=votes.npy", "contents.sha256=null")
PRIORS = ("priors.contents=[housekeep]", "priors.trained_on=[procthor]", "priors.others=[truth]")


@pytest.mark.usefixtures("_houses_are_there")
def test_every_prior_runs_the_same_trials_and_one_page_compares_them(cli: Cli, tmp_path: Path) -> None:
    """In a folder of its own: other models in the shared workspace would become its champion."""
    write(tmp_path / "votes.npy")
    few = ("evaluation.robots=[1]", "evaluation.size_classes=[small]", "evaluation.tasks_per_home=2")
    command = (*SMALL, *CONTENTS, *PRIORS, *few, "evaluation.trials_per_cell=4", "output_dir=out")
    done = cli("priors", *command)
    assert done.code == 0, done.err
    beliefs = {path.stem: pd.read_parquet(path) for path in tmp_path.glob("out/runs/*/beliefs/*")}
    assert set(beliefs) == {"housekeep-truth", "housekeep-procthor", "housekeep-procthor-adapting"}
    plain, adapting = beliefs["housekeep-procthor"], beliefs["housekeep-procthor-adapting"]
    first = plain["task"] == 0
    pd.testing.assert_frame_equal(plain[first], adapting[first])
    assert not plain["prob"].equals(adapting["prob"]), "the second task begins with what the first one showed"
    assert not plain["prob"].equals(beliefs["housekeep-truth"]["prob"])
    runs = pd.concat([pd.read_parquet(folder) for folder in tmp_path.glob("out/runs/*/episodes")])
    pouct = runs[runs["planner"].str.startswith("pouct:")]
    assert pouct.groupby("trial_id")[["home_id", "formula", "seed"]].nunique().eq(1).all(axis=None)
    assert pouct.groupby("trial_id").size().eq(3).all() and pouct["trial_id"].nunique() == 4
    page = (tmp_path / "out/report/index.html").read_text()
    assert "ProcTHOR, adapting" in page and "nonlearned_myopic" in page
    times = [path.stat().st_mtime_ns for path in sorted(tmp_path.glob("out/runs/*/episodes/*"))]
    assert cli("priors", *command).code == 0
    assert times == [path.stat().st_mtime_ns for path in sorted(tmp_path.glob("out/runs/*/episodes/*"))]


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("priors.others=[flat]", "priors.others.0=flat: allowed: 'uniform', 'truth'"),
        ("evaluation.unsearched_share=[0.5,1.0]", "nothing is known from the start"),
    ],
)
def test_mistakes_are_refused(override: str, message: str, cli: Cli) -> None:
    done = cli("priors", *SMALL, override)
    assert done.code == 2 and message in done.err
