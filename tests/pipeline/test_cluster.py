"""The same rows on a cluster of several nodes: one has other code, one is lost on the way, and one joins."""

import json
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pandas as pd

from tests.pipeline.harness import ROOT, Cli, Workspace
from tests.pipeline.test_stages import episodes

PLANNERS = "evaluation.planners=[pouct,tests.pipeline.own_planners.Gated]"
A_SECOND_MORE = """
_run_episode = run_episode


def run_episode(*arguments, **options):
    from dataclasses import replace

    result = _run_episode(*arguments, **options)
    return replace(result, cost_s=result.cost_s + 1)
"""


def other_code(folder: Path) -> Path:
    """A copy of our packages that adds a second to every cost, beside what says that it is another numba."""
    for name in ("mrtask", "pipeline"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    with (folder / "mrtask" / "execution" / "episode.py").open("a") as file:
        file.write(A_SECOND_MORE)
    (folder / "numba-0.1.dist-info").mkdir()
    (folder / "numba-0.1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: numba\nVersion: 0.1\n")
    return folder


def test_rows_do_not_depend_on_the_cluster_nor_on_its_nodes(workspace: Workspace, cli: Cli, tmp_path: Path) -> None:
    gate = tmp_path / "gate"
    overrides = [*workspace.overrides, PLANNERS, f"+planner.Gated.gate={gate}"]
    # Another process: one Ray session is all that this one can be part of.
    command = [sys.executable, "-m", "tests.pipeline.run_on_cluster", str(workspace.path), str(gate)]
    command += [str(other_code(tmp_path / "other")), *overrides]
    done = subprocess.run(command, cwd=workspace.path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    # Ray prints what it says about the lost node into the same stream.
    [line] = [line for line in done.stdout.splitlines() if line.startswith("{")]
    said = json.loads(line)
    assert (said["nodes_before"], said["nodes_after"]) == (3, 2)
    assert 0 < said["rows_before"] < 24, "the node was lost too late to matter"
    node = rf"node {socket.gethostname()} \([\d.]+, \w{{8}}\)"
    for pattern in (
        rf"left out, because its rows would not be this code's: {node}: .*other code in mrtask.execution.*numba 0.1 "
        r"instead of \d",
        rf"{node} is lost; what it ran goes to others. 1 node, 1 worker now",
        rf"{node} joined. 2 nodes, 2 workers now",
    ):
        assert pd.Series(done.stdout.splitlines()).str.contains(pattern).sum() == 1, (pattern, done.stdout)
    assert cli("evaluate", *overrides, "output_dir=outputs/no_cluster", cwd=workspace.path).code == 0
    rows = episodes(workspace.path / "outputs" / "cluster")
    undisturbed = episodes(workspace.path / "outputs" / "no_cluster")
    pd.testing.assert_frame_equal(rows.drop(columns="attempt"), undisturbed.drop(columns="attempt"))
    nodes = pd.read_parquet(workspace.path / "outputs" / "cluster" / "episodes")["node"]
    assert set(nodes) == {socket.gethostname()}


def test_rows_do_not_depend_on_the_number_of_workers(workspace: Workspace, cli: Cli) -> None:
    alone = [*workspace.overrides, "cluster.cpus=1", "output_dir=outputs/one_worker"]
    assert cli("evaluate", *alone, cwd=workspace.path).code == 0
    pd.testing.assert_frame_equal(episodes(workspace.path / "outputs" / "one_worker"), episodes(workspace.output_dir))
