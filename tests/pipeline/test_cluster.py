"""The same rows on a cluster of several nodes, one of which is lost on the way."""

import json
import subprocess
import sys
from pathlib import Path

import pandas as pd

from tests.pipeline.harness import Cli, Workspace
from tests.pipeline.test_stages import episodes

PLANNERS = "evaluation.planners=[pouct,tests.pipeline.own_planners.Gated]"


def test_rows_do_not_depend_on_the_cluster_nor_on_a_lost_node(workspace: Workspace, cli: Cli, tmp_path: Path) -> None:
    gate = tmp_path / "gate"
    overrides = [*workspace.overrides, PLANNERS, f"+planner.Gated.gate={gate}"]
    # Another process: one Ray session is all that this one can be part of.
    command = [sys.executable, "-m", "tests.pipeline.run_on_cluster", str(workspace.path), str(gate), *overrides]
    done = subprocess.run(command, cwd=workspace.path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    # Ray prints what it says about the lost node into the same stream.
    [line] = [line for line in done.stdout.splitlines() if line.startswith("{")]
    said = json.loads(line)
    assert (said["nodes_before"], said["nodes_after"]) == (3, 2)
    assert 0 < said["rows_before"] < 24, "the node was lost too late to matter"
    assert cli("evaluate", *overrides, "output_dir=outputs/no_cluster", cwd=workspace.path).code == 0
    rows = episodes(workspace.path / "outputs" / "cluster")
    undisturbed = episodes(workspace.path / "outputs" / "no_cluster")
    pd.testing.assert_frame_equal(rows.drop(columns="attempt"), undisturbed.drop(columns="attempt"))


def test_rows_do_not_depend_on_the_number_of_workers(workspace: Workspace, cli: Cli) -> None:
    alone = [*workspace.overrides, "cluster.cpus=1", "output_dir=outputs/one_worker"]
    assert cli("evaluate", *alone, cwd=workspace.path).code == 0
    pd.testing.assert_frame_equal(episodes(workspace.path / "outputs" / "one_worker"), episodes(workspace.output_dir))
