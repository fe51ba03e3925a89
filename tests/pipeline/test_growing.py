"""A run that is asked for more in the same output_dir adds what is missing and changes no existing row."""

import json
from pathlib import Path

import pandas as pd

from tests.pipeline.harness import Cli, Workspace
from tests.pipeline.test_stages import episodes, evaluation_manifest

MORE = (
    "evaluation.trials_per_cell=4",
    "evaluation.robots=[1,3]",
    "evaluation.planners=[nonlearned_myopic,pouct,greedy,eager]",
    "+planner_variants.eager={planner: pouct, options: {exploration: 0.5}, likelihood: {source: truth}}",
)


def test_a_grown_run_equals_one_that_was_asked_for_all_at_once(
    workspace: Workspace, cli: Cli, copied_output: Path, tmp_path: Path
) -> None:
    before = episodes(copied_output)
    first_manifest = json.loads((copied_output / "evaluation.json").read_bytes())
    base = [one for one in workspace.overrides if not one.startswith("evaluation.")]
    grown = cli("evaluate", *base, *MORE, f"output_dir={copied_output}", cwd=workspace.path)
    assert grown.code == 0, grown.err
    # With one robot, two trials by two planners were there; those with two are there too, and not asked for now.
    assert "there already: 12 episodes" in grown.out
    assert "grows from 24 to 108 episodes: 4 trials a cell, small, medium and large, 1 and 3 robots" in grown.out
    fresh = cli("evaluate", *base, *MORE, f"output_dir={tmp_path / 'fresh'}", cwd=workspace.path)
    assert fresh.code == 0, fresh.err
    after, whole = episodes(copied_output), episodes(tmp_path / "fresh")
    assert len(whole) == 3 * 2 * 4 * 4 and set(whole["status"]) == {"accepted"}
    pd.testing.assert_frame_equal(after[after["robots"] != 2].reset_index(drop=True), whole)
    old = pd.MultiIndex.from_frame(before[["trial_id", "planner"]])
    kept = pd.MultiIndex.from_frame(after[["trial_id", "planner"]]).isin(old)
    pd.testing.assert_frame_equal(after[kept].reset_index(drop=True), before)
    manifest = evaluation_manifest(copied_output)
    assert manifest.expected_episodes == len(after) == 108
    assert set(manifest.planners) == {"nonlearned_myopic", "pouct", "greedy", "eager"}

    # The first command again asks for less: nothing is run, nothing is taken away.
    command = (*workspace.overrides, f"output_dir={copied_output}")
    less = cli("evaluate", *command, cwd=workspace.path)
    assert less.code == 0 and "84 episodes that are not asked for now; they are kept" in less.out
    assert "(unchanged, skipped)" in less.out
    pd.testing.assert_frame_equal(episodes(copied_output), after)
    assert cli("report", *command, cwd=workspace.path).code == 0
    page = (copied_output / "report" / "index.html").read_text()
    assert "grown, request by request" in page
    assert "2 trials a cell, small, medium and large, 1 and 2 robots, by nonlearned_myopic and pouct; then" in page
    # A planner of one command and a trial of another, which neither command's own configuration has together.
    replayed = cli("replay", "trial_id=small-1-003", "planners=[eager,pouct]", *command[-1:], cwd=workspace.path)
    assert replayed.code == 0, replayed.err

    # As an interrupt leaves it: the run was asked for more, has some of it, and the manifest is that of its first end;
    # but for the MLflow run, since that of the first end is the workspace's, which other tests look at.
    interrupted = {**first_manifest, "run_id": manifest.run_id}
    (copied_output / "evaluation.json").write_text(json.dumps(interrupted))
    [part] = (copied_output / "episodes").glob("*.parquet")
    pd.read_parquet(part).query("robots != 3 or planner != 'greedy'").to_parquet(part)
    assert cli("report", *command, cwd=workspace.path).code == 0
    page = (copied_output / "report" / "index.html").read_text()
    assert "12 of 108 episodes are missing: the evaluation has not finished" in page
