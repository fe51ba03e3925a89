"""Results in an S3 bucket of a local server: the same rows, also of a killed run; mistakes are told in one line."""

import importlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pandas as pd
import pytest
import ray
import s3fs
from moto.server import ThreadedMotoServer

from pipeline.base.config import UserError
from pipeline.store import folder as storage
from pipeline.store.folder import Folder
from tests.pipeline.harness import Cli, Workspace
from tests.pipeline.own_planners import Gate
from tests.pipeline.test_stages import TIMINGS, episodes

OWN = "tests.pipeline.own_planners"
RUN = "s3://results/run"


@pytest.fixture(scope="module")
def bucket() -> Iterator[s3fs.S3FileSystem]:
    """The file system of a server with one bucket, which the environment points to."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        patch.setenv("AWS_ACCESS_KEY_ID", "any")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "any")
        # So that a server that is gone is noticed at once.
        patch.setenv("AWS_MAX_ATTEMPTS", "1")
        store = fsspec.filesystem("s3")
        store.mkdir("results")
        yield store
        s3fs.S3FileSystem.clear_instance_cache()
    server.stop()


def rows_in(store: s3fs.S3FileSystem, pattern: str) -> pd.DataFrame:
    store.invalidate_cache()
    frames = []
    for name in store.glob(pattern):
        with store.open(name) as file:
            frames.append(pd.read_parquet(file))
    return pd.concat(frames) if frames else pd.DataFrame({"trial_id": [], "planner": []})


def test_a_run_in_a_bucket_is_killed_and_goes_on(
    workspace: Workspace, cli: Cli, bucket: s3fs.S3FileSystem, tmp_path: Path
) -> None:
    gate = Gate(tmp_path / "gate")
    gate.shut_after(5)
    overrides = [
        *workspace.overrides, f"evaluation.planners=[nonlearned_myopic,{OWN}.Gated]",
        f"+planner.Gated.gate={gate.folder}", f"output_dir={RUN}",
    ]  # fmt: skip
    cluster = f"cluster.address={ray.get_runtime_context().gcs_address}"
    command = [sys.executable, "-m", "pipeline.evaluate", *overrides, cluster]
    driver = subprocess.Popen(command, cwd=workspace.path, stdout=subprocess.DEVNULL, env=os.environ)
    end_s = time.monotonic() + 120
    while not (before := len(rows_in(bucket, "results/run/episodes/part-*.parquet"))) and time.monotonic() < end_s:
        assert driver.poll() is None
        time.sleep(0.2)
    refused = cli("evaluate", *overrides, cwd=workspace.path)
    assert refused.code == 2 and f"{RUN} is in use by another run (process {driver.pid} on" in refused.err
    driver.send_signal(signal.SIGKILL)
    assert driver.wait(timeout=60) == -signal.SIGKILL
    assert 0 < before < 24
    gate.open()
    resumed = cli("evaluate", *overrides, cwd=workspace.path)
    assert resumed.code == 0, resumed.err
    assert f"{RUN}/episodes" in resumed.out and "there already: " in resumed.out
    assert cli("report", *workspace.overrides, f"output_dir={RUN}", cwd=workspace.path).code == 0
    assert b"Gated" in bucket.cat_file("results/run/report/index.html")
    found = rows_in(bucket, "results/run/episodes/*.parquet")
    undisturbed = episodes(workspace.output_dir)
    undisturbed = undisturbed[undisturbed["planner"] == "nonlearned_myopic"]
    for planner in ("nonlearned_myopic", f"{OWN}.Gated"):
        rows = found[found["planner"] == planner].drop(columns=TIMINGS).sort_values("trial_id")
        ignored = ["planner", "config_hash", "attempt"]
        pd.testing.assert_frame_equal(
            rows.drop(columns=ignored).reset_index(drop=True), undisturbed.drop(columns=ignored).reset_index(drop=True)
        )
    # The run is over: nothing keeps others out.
    assert not bucket.exists("results/run/.lock")


def test_a_run_on_another_machine_keeps_out_until_it_is_silent(
    workspace: Workspace, cli: Cli, bucket: s3fs.S3FileSystem
) -> None:
    lease = {"by": "process 7 on elsewhere", "host": "elsewhere", "renewed": time.time() - 5}
    bucket.pipe_file("results/leased/.lock", json.dumps(lease).encode())
    overrides = [*workspace.overrides, "output_dir=s3://results/leased"]
    refused = cli("evaluate", *overrides, cwd=workspace.path)
    assert refused.code == 2
    assert re.search(r"in use by another run \(process 7 on elsewhere, heard of \d+ s ago\)", refused.err)
    assert bucket.ls("results/leased", detail=False, refresh=True) == ["results/leased/.lock"]
    lease["renewed"] = time.time() - storage.LEASE_S
    bucket.pipe_file("results/leased/.lock", json.dumps(lease).encode())
    assert cli("evaluate", *overrides, cwd=workspace.path).code == 0


def test_a_lock_is_renewed(bucket: s3fs.S3FileSystem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage, "RENEW_EVERY_S", 0.05)
    folder = Folder("s3://results/renewed")
    with storage.locked(folder, tmp_path):
        first = json.loads(folder.read(".lock") or b"")["renewed"]
        time.sleep(0.5)
        assert json.loads(folder.read(".lock") or b"")["renewed"] > first


@pytest.mark.parametrize(
    ("location", "environment", "said"),
    [
        ("s3://no-such-bucket/run", {}, "/no-such-bucket/run/.lock: The specified bucket does not exist"),
        (RUN, {"AWS_ENDPOINT_URL": "http://127.0.0.1:1"}, f"{RUN}/.lock: Could not connect to the endpoint"),
        (RUN, {"AWS_ACCESS_KEY_ID": None, "AWS_PROFILE": "nobody"}, "nobody"),
    ],
)
def test_a_store_that_cannot_be_used_is_told_before_any_work(
    location: str, environment: dict[str, str | None], said: str, workspace: Workspace, cli: Cli,
    bucket: s3fs.S3FileSystem, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    s3fs.S3FileSystem.clear_instance_cache()
    for name, value in environment.items():
        monkeypatch.setenv(name, value) if value else monkeypatch.delenv(name)
    refused = cli("evaluate", *workspace.overrides, "seed=5", f"output_dir={location}", cwd=workspace.path)
    s3fs.S3FileSystem.clear_instance_cache()
    assert refused.code == 2
    assert refused.err.count("\n") == 1 and refused.err.startswith("error: ") and said in refused.err, refused.err
    assert "==" not in refused.out


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "s3fs", None)
    known = importlib.import_module("fsspec.registry")._registry
    monkeypatch.delitem(known, "s3", raising=False)
    with pytest.raises(UserError, match=r"output_dir=s3://bucket/run: Install s3fs .*pip install 'mrtask\[s3\]'"):
        Folder("s3://bucket/run").names()
