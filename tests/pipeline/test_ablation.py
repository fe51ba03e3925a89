"""The ablation: which arms share an evaluation, and one in small from the command line."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pytest

from mrtask.analysis.studies.ablation import COMPARED
from pipeline.ablation import AUTHORS, PAPER, WHAT, protocols
from pipeline.arms import SharedRun, lay_out
from pipeline.base.config import Config, UserError
from pipeline.base.studies import Arm
from tests.pipeline.configured import configured
from tests.pipeline.harness import Cli, Workspace

PATIENT = "planner.nonlearned_myopic.return_to_known=when_complete"
PART_KNOWN = "'evaluation.unsearched_share=[0.5,1.0]'"
SWITCHES = (
    f"ablation.switches=[{{name: patient, overrides: '{PATIENT}'}}, {{name: part known, overrides: {PART_KNOWN}}}]"
)
STEPS = "ablation.steps=[{name: first, overrides: 'planner.pouct_paper.exploration=0.7'}]"


def laid_out(config: Config) -> Sequence[SharedRun]:
    return lay_out(config, [(arm.name, arm.overrides) for arm in protocols(config.ablation)], COMPARED, WHAT)


def test_arms_with_the_same_trials_share_an_evaluation_and_the_rows_of_equal_planners() -> None:
    config = configured(SWITCHES, STEPS)
    names = [arm.name for arm in protocols(config.ablation)]
    assert names == [
        PAPER,
        "paper + patient",
        "paper + part known",
        AUTHORS,
        "authors - patient",
        "authors - part known",
        "step: first",
    ]
    whole, part = laid_out(config)
    assert [arm for arm, _ in whole.arms] == [PAPER, "paper + patient", "authors - part known", "step: first"]
    assert [arm for arm, _ in part.arms] == ["paper + part known", AUTHORS, "authors - patient"]
    # Four planners, one more for the patient baseline and one for the step.
    assert len(whole.variants) == 6 and len(part.variants) == 5
    by_arm = dict(whole.arms)
    assert by_arm["paper + patient"]["pouct"] == by_arm[PAPER]["pouct"] == "pouct:paper"
    assert by_arm["paper + patient"]["nonlearned_myopic"] == by_arm["authors - part known"]["nonlearned_myopic"]
    assert by_arm["paper + patient"]["nonlearned_myopic"] != by_arm[PAPER]["nonlearned_myopic"]
    applied = part.configured()
    assert applied.evaluation.unsearched_share == (0.5, 1.0)
    assert applied.evaluation.planners == tuple(part.variants)
    assert applied.spec("nonlearned_myopic:authors").options["return_to_known"] == "when_complete"
    assert applied.output_dir != whole.configured().output_dir


def test_an_ablation_that_is_asked_for_more_goes_on_in_the_same_folders() -> None:
    folders = [one.configured().output_dir for one in laid_out(configured(SWITCHES))]
    more = configured(SWITCHES, STEPS, "evaluation.trials_per_cell=200", "evaluation.robots=[1,2,3,4]")
    assert [one.configured().output_dir for one in laid_out(more)] == folders
    for other in ("seed=1", "planner.pouct.samples=10", "belief.adapt=true", "likelihood.uniform_mix=0.5"):
        assert not set(folders) & {one.configured().output_dir for one in laid_out(configured(SWITCHES, other))}, other


def test_arms_can_differ_in_what_planners_are_given() -> None:
    config = configured()
    arms = [("as it is", ()), ("noisy", ("likelihood.noise_sd=2",)), ("same", ("likelihood.noise_sd=0",))]
    [shared] = lay_out(config, arms, ("pouct",), "test")
    assert list(shared.variants) == ["pouct:as-it-is", "pouct:noisy"]
    applied = shared.configured()
    assert applied.likelihood.noise_sd == 0
    assert [applied.spec(name).likelihood.noise_sd for name in shared.variants] == [0, 2]


def test_arms_whose_robots_see_otherwise_are_evaluations_of_their_own() -> None:
    poor = ("perception.true_positive_prob=0.7",)
    arms = [("sees all", ()), ("misses", poor), ("same", ("planner.known.samples=9",))]
    sees_all, misses = lay_out(configured(), arms, ("pouct",), "test")
    assert [arm for arm, _ in sees_all.arms] == ["sees all", "same"]
    assert misses.configured().perception.true_positive_prob == 0.7
    assert misses.configured().output_dir != sees_all.configured().output_dir


def test_all_switches_together_are_the_preset_authors() -> None:
    """But for where homes and likelihoods come from."""
    every = [override for switch in configured().ablation.switches for override in switch.overrides]
    switched, preset = configured(*every), configured("experiment=authors", "homes=generated", "model=similarity")
    assert switched.evaluation == preset.evaluation
    assert switched.map == preset.map
    assert switched.planner == preset.planner


def test_mistakes_in_arms_are_refused_before_any_work() -> None:
    config = configured(SWITCHES)
    wrong = Arm(name="wrong", overrides=("evaluation.unsearched_share=[2,3]",))
    with pytest.raises(UserError, match=r"ablation, arm paper \+ wrong: evaluation.unsearched_share"):
        laid_out(config.model_copy(update={"ablation": config.ablation.model_copy(update={"switches": (wrong,)})}))
    twice = tuple(Arm(name=name, overrides=(PATIENT,)) for name in ("a b", "a-b"))
    with pytest.raises(UserError, match="two arms are called"):
        laid_out(config.model_copy(update={"ablation": config.ablation.model_copy(update={"switches": twice})}))


def test_an_ablation_runs_each_planner_once_and_shows_every_arm(workspace: Workspace, cli: Cli, tmp_path: Path) -> None:
    out = tmp_path / "ablation"
    small = [one for one in workspace.overrides if not one.startswith("evaluation.planners")]
    small += ["evaluation.size_classes=[small]", "planner.pouct_paper.samples=20"]
    command = [*small, SWITCHES, STEPS, f"output_dir={out}"]
    finished = cli("ablation", *command, cwd=workspace.path)
    assert finished.code == 0, finished.err
    page = (out / "report" / "index.html").read_text()
    for name in ("paper", "paper + patient", "authors - part known", "step: first"):
        assert name in page
    frames = [pd.read_parquet(folder / "episodes") for folder in sorted((out / "runs").iterdir())]
    assert sorted(len(frame) for frame in frames) == [5 * 4, 6 * 4]
    assert all((frame["status"] == "accepted").all() for frame in frames)
    again = cli("ablation", *command, cwd=workspace.path)
    assert again.code == 0
    kept = [pd.read_parquet(folder / "episodes") for folder in sorted((out / "runs").iterdir())]
    assert all(one.equals(other) for one, other in zip(frames, kept, strict=True))
