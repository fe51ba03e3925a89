"""The measure of how far planners are from optimal: its rows, going on where it stopped, and the report."""

from pathlib import Path

import pandas as pd

from tests.pipeline.harness import Cli, Workspace

OPTIONS = ("optimality.planners=[greedy]", "optimality.worlds=2", "evaluation.size_classes=[small]")


def test_rows_by_trial_and_a_section_of_the_report(cli: Cli, workspace: Workspace, copied_output: Path) -> None:
    shared = (*workspace.overrides, f"output_dir={copied_output}")
    one = cli("optimality", *shared, *OPTIONS, "optimality.trials_per_cell=1", cwd=workspace.path)
    assert one.code == 0, one.err
    assert "2 trials, each in 2 worlds" in one.out
    table = copied_output / "optimality.csv"
    first = pd.read_csv(table)
    assert list(first["trial_id"]) == ["small-1-000", "small-2-000"]
    assert set(first["planner"]) == {"greedy"}
    assert first["bound_s"].gt(0).all()
    two = cli("optimality", *shared, *OPTIONS, "optimality.trials_per_cell=2", cwd=workspace.path)
    assert two.code == 0, two.err
    both = pd.read_csv(table)
    assert list(both["trial_id"]) == ["small-1-000", "small-1-001", "small-2-000", "small-2-001"]
    kept = both[both["trial_id"].isin(first["trial_id"])].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, first)  # CPU times too: nothing was computed again
    again = cli("optimality", *shared, *OPTIONS, "optimality.trials_per_cell=2", cwd=workspace.path)
    assert "(unchanged, skipped)" in again.out
    assert cli("report", *shared, cwd=workspace.path).code == 0
    assert "How far from optimal" in (copied_output / "report" / "index.html").read_text()


def test_a_planner_that_is_none_is_refused(cli: Cli) -> None:
    done = cli("optimality", "optimality.planners=[pouctt]")
    assert done.code == 2
    assert "optimality.planners: unknown planner 'pouctt'" in done.err
