"""Whatever happens to workers, planners or the driver: the rows of an undisturbed run, none lost, none twice."""

import errno
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import mlflow
import pandas as pd
import psutil
import pytest

from pipeline.backends import runs
from pipeline.store import rows as results
from tests.pipeline.harness import Cli, Workspace
from tests.pipeline.own_planners import Gate
from tests.pipeline.test_stages import episodes

OWN = "tests.pipeline.own_planners"


def assert_same_costs(rows: pd.DataFrame, undisturbed: pd.DataFrame) -> None:
    """Rows of a planner that goes by the baseline's rule are the baseline's of an undisturbed run, but for its name."""
    baseline = undisturbed[undisturbed["planner"] == "nonlearned_myopic"].set_index("trial_id").loc[rows["trial_id"]]
    other = ["planner", "config_hash"]
    pd.testing.assert_frame_equal(
        rows.set_index("trial_id").drop(columns=other), baseline.drop(columns=other), check_dtype=False
    )


def test_a_worker_killed_in_an_episode_changes_no_row(workspace: Workspace, cli: Cli, tmp_path: Path) -> None:
    planners = f"evaluation.planners=[{OWN}.Deadly,nonlearned_myopic]"
    common = [*workspace.overrides, planners, f"+planner.Deadly.marker={tmp_path}/marker"]
    done = cli("evaluate", *common, "output_dir=outputs/killed", cwd=workspace.path)
    assert done.code == 0, done.err
    killed = episodes(workspace.path / "outputs" / "killed")
    assert sorted(killed["attempt"])[-1] >= 2
    assert cli("evaluate", *common, "output_dir=outputs/not_killed", cwd=workspace.path).code == 0
    undisturbed = episodes(workspace.path / "outputs" / "not_killed")
    pd.testing.assert_frame_equal(killed.drop(columns="attempt"), undisturbed.drop(columns="attempt"))


def test_an_episode_that_raises_is_a_row_with_its_traceback(workspace: Workspace, cli: Cli) -> None:
    planners = f"evaluation.planners=[nonlearned_myopic,{OWN}.Faulty]"
    common = [*workspace.overrides, planners, "output_dir=outputs/faulty", "evaluation.max_failed_fraction=1"]
    assert cli("evaluate", *common, cwd=workspace.path).code == 0
    rows = episodes(workspace.path / "outputs" / "faulty")
    faulty = rows[(rows["planner"] == f"{OWN}.Faulty") & (rows["robots"] == 2)]
    assert len(faulty) == 6 and set(faulty["status"]) == {"error"} and set(faulty["attempt"]) == {2}
    assert faulty["error"].str.contains("this planner has a bug").all()
    assert faulty["cost_s"].isna().all()
    for _, sound in rows.drop(faulty.index).groupby("planner"):
        assert_same_costs(sound, episodes(workspace.output_dir))
    kept = cli("evaluate", *common, cwd=workspace.path)
    assert "(unchanged, skipped)" in kept.out
    for said in (kept.out, cli("report", "output_dir=outputs/faulty", cwd=workspace.path).out):
        [last] = [line for line in said.splitlines() if "without a result" in line]
        assert last.endswith(
            "6 of 24 episodes without a result: 6 error (mostly: RuntimeError: this planner has a bug)"
        )
    again = cli("evaluate", *common, "evaluation.rerun=[error]", cwd=workspace.path)
    assert "there already: 18 episodes" in again.out
    assert cli("report", "output_dir=outputs/faulty", cwd=workspace.path).code == 0


def test_a_planner_that_never_succeeds_ends_the_run_with_an_error(workspace: Workspace, cli: Cli) -> None:
    planners = f"evaluation.planners=[nonlearned_myopic,{OWN}.Faulty]"
    common = [*workspace.overrides, planners, "evaluation.robots=[2]", "evaluation.max_failed_fraction=1"]
    for stage in ("evaluate", "report", "reproduce", "evaluate"):
        done = cli(stage, *common, "output_dir=outputs/never", cwd=workspace.path)
        assert done.code == 2, "however often the command is given"
        assert done.err.startswith(f"error: no episode was accepted of {OWN}.Faulty (of 6); the rows")
        assert "Faulty 0/6" in " ".join(done.out.split()) and "6 error (mostly: RuntimeError: this planner" in done.out
    assert (workspace.path / "outputs" / "never" / "report" / "index.html").is_file()
    other = cli(
        "evaluate", *workspace.overrides, "evaluation.robots=[2]", "output_dir=outputs/never", cwd=workspace.path
    )
    assert other.code == 0, "the planners that are asked for now are judged"


def test_a_run_that_mostly_fails_is_stopped(workspace: Workspace, cli: Cli) -> None:
    planners = f"evaluation.planners=[nonlearned_myopic,{OWN}.Faulty]"
    stopped = cli(
        "evaluate", *workspace.overrides, planners, "evaluation.robots=[2]", "evaluation.trials_per_cell=12",
        "evaluation.size_classes=[small]", "output_dir=outputs/failing", cwd=workspace.path,
    )  # fmt: skip
    assert stopped.code == 2
    assert "more than evaluation.max_failed_fraction=0.1" in stopped.err and "this planner has a bug" in stopped.err
    assert len(episodes(workspace.path / "outputs" / "failing")) >= 20


def test_an_episode_that_hangs_is_a_timeout_row(workspace: Workspace, cli: Cli) -> None:
    hanging = cli(
        "evaluate", *workspace.overrides, f"evaluation.planners=[{OWN}.Hanging]", "evaluation.size_classes=[small]",
        "evaluation.trials_per_cell=1", "evaluation.episode_timeout_s=6", "output_dir=outputs/hanging",
        cwd=workspace.path,
    )  # fmt: skip
    assert hanging.code == 0
    rows = episodes(workspace.path / "outputs" / "hanging")
    assert dict(zip(rows["robots"], rows["status"], strict=True)) == {1: "accepted", 2: "timeout"}
    assert_same_costs(rows[rows["robots"] == 1], episodes(workspace.output_dir))


def test_a_run_on_a_full_disk_goes_on_when_there_is_room(
    workspace: Workspace, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results, "FLUSH_EVERY_S", 0.0)
    original = Path.write_bytes

    def short_of_room(path: Path, content: bytes) -> int:
        if path.parent.name == "episodes" and len(list(path.parent.glob("part-*.parquet"))) == 5:
            original(path, content[: len(content) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return original(path, content)

    monkeypatch.setattr(Path, "write_bytes", short_of_room)
    common = [*workspace.overrides, "output_dir=outputs/full"]
    stopped = cli("evaluate", *common, cwd=workspace.path)
    monkeypatch.undo()
    assert stopped.code == 2 and stopped.err.count("\n") == 1
    assert "No space left on device; make room" in stopped.err
    target = workspace.path / "outputs" / "full"
    before = pd.read_parquet(target / "episodes")
    assert len(before) == 5
    resumed = cli("evaluate", *common, cwd=workspace.path)
    assert resumed.code == 0 and "there already: 5 episodes" in resumed.out
    pd.testing.assert_frame_equal(episodes(target), episodes(workspace.output_dir))
    after = pd.read_parquet(target / "episodes").merge(before, on=["trial_id", "planner"], suffixes=("", "_before"))
    assert (after["planning_s"] == after["planning_s_before"]).all() and len(after) == 5


def test_a_driver_stopped_again_and_again_goes_on(workspace: Workspace, cli: Cli, tmp_path: Path) -> None:
    gate = Gate(tmp_path / "gate")
    planners = f"evaluation.planners=[nonlearned_myopic,{OWN}.Gated]"
    common = [*workspace.overrides, planners, f"+planner.Gated.gate={gate.folder}", "output_dir=outputs/stopped"]
    target, seen = workspace.path / "outputs" / "stopped", [pd.DataFrame({"planner": []})]
    for how, passing, rows_there in ((signal.SIGTERM, 2, 2), (signal.SIGKILL, 10, 13)):
        gate.shut_after(passing - (seen[-1]["planner"] == f"{OWN}.Gated").sum())
        seen.append(rows_until_stopped(how, common, workspace.path, target, max(rows_there, len(seen[-1]) + 1)))
    assert len(seen[1]) < 12 < len(seen[2]) < 24, "early and late"
    gate.open()
    resumed = cli("evaluate", *common, cwd=workspace.path)
    assert resumed.code == 0, resumed.err
    assert len(episodes(target)) == 24
    for _, found in episodes(target).groupby("planner"):
        assert_same_costs(found, episodes(workspace.output_dir))
    rows = pd.read_parquet(target / "episodes")
    for before in seen[1:]:
        finished = rows.merge(before, on=["trial_id", "planner"], suffixes=("", "_before"))
        assert len(finished) == len(before)
        assert (finished["planning_s"] == finished["planning_s_before"]).all(), "a finished row was run again"
    store = runs.open_tracking(f"sqlite:///{workspace.path}/outputs/mlflow.db", "mrtask")
    found = mlflow.MlflowClient().search_runs([store.experiment_id], f"tags.output_dir = '{target}'")
    assert sorted(run.info.status for run in found) == ["FINISHED", "KILLED", "KILLED"]


def rows_until_stopped(
    how: signal.Signals, overrides: Sequence[str], folder: Path, target: Path, rows: int
) -> pd.DataFrame:
    """Stop a driver once it has written this many rows, when no process of it runs, and return its rows."""
    command = [sys.executable, "-m", "pipeline.evaluate", *overrides, "cluster.address=local"]
    said = target.with_suffix(".err")
    with said.open("w") as said_to:
        driver = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=said_to)
    wait_for_rows(driver, target, rows)
    children = [child for child in psutil.Process(driver.pid).children(recursive=True) if is_worker(child)]
    assert children
    driver.send_signal(how)
    assert driver.wait(timeout=60) == (130 if how == signal.SIGTERM else -how)
    if how == signal.SIGTERM:
        assert not list(Path(tempfile.gettempdir(), "ray").glob(f"session_*_{driver.pid}")), "Ray's logs stay"
        text = said.read_text()
        assert "interrupted; the same command continues from here" in text and "Traceback" not in text
    _, alive = psutil.wait_procs(children, timeout=20)
    assert not alive, f"left running: {alive}"
    return pd.read_parquet(target / "episodes")


def is_worker(process: psutil.Process) -> bool:
    """Whether it computes or holds shared memory; Ray's small agents take longer to notice that they are orphans."""
    return process.name() == "raylet" or (process.name().startswith("ray::") and "Agent" not in process.name())


def wait_for_rows(driver: subprocess.Popen[bytes], target: Path, count: int) -> None:
    """Wait until the driver has written this many rows."""
    end_s = time.monotonic() + 300
    while time.monotonic() < end_s and driver.poll() is None:
        parts = list((target / "episodes").glob("part-*.parquet"))
        try:
            if parts and len(pd.read_parquet(target / "episodes", columns=["trial_id"])) >= count:
                return
        except FileNotFoundError:  # merged in between
            continue
        time.sleep(0.1)
    raise AssertionError(f"the driver ended ({driver.poll()}) or wrote nothing")
