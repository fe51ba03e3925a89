"""One Ray session and one small finished experiment for all pipeline tests."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.pipeline.harness import ROOT, SMALL, Cli, Finished, Workspace, run_stage


@pytest.fixture(scope="session", autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Maps and embeddings of tests are their own; compiled kernels stay where they are."""
    before = os.environ.get("MRTASK_CACHE_DIR")
    os.environ["MRTASK_CACHE_DIR"] = str(tmp_path_factory.mktemp("cache"))
    yield
    if before is None:
        del os.environ["MRTASK_CACHE_DIR"]
    else:
        os.environ["MRTASK_CACHE_DIR"] = before


@pytest.fixture(scope="session", autouse=True)
def _importable() -> Iterator[None]:
    """Tasks and planners that tests define can be imported in subprocesses and in Ray's workers."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), *([before] if before else [])])
    yield
    if before is None:
        del os.environ["PYTHONPATH"]
    else:
        os.environ["PYTHONPATH"] = before


@pytest.fixture(scope="session")
def ray_session(_cache: None, _importable: None) -> Iterator[None]:
    """Ray with two workers, started once; pools find it running and leave it so."""
    import ray

    from pipeline.backends import pool
    from pipeline.base.sections import Cluster

    pool._start(Cluster(address="local", cpus=2, memory_per_task_gb=0.5, retries=3))
    yield
    ray.shutdown()


@pytest.fixture
def cli(ray_session: None, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Cli:
    """``cli("evaluate", "seed=1", ...)`` in an empty folder, or ``cli(..., cwd=folder)``."""

    def call(stage: str, *overrides: str, cwd: Path = tmp_path) -> Finished:
        monkeypatch.chdir(cwd)
        capfd.readouterr()
        code = run_stage(stage, *overrides)
        said = capfd.readouterr()
        return Finished(code, said.out, said.err)

    return call


@pytest.fixture(scope="session")
def workspace(ray_session: None, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """The small experiment, reproduced once."""
    path = tmp_path_factory.mktemp("workspace")
    before = Path.cwd()
    os.chdir(path)
    try:
        code = run_stage("reproduce", *SMALL)
    finally:
        os.chdir(before)
    assert code == 0
    return Workspace(path, SMALL)


@pytest.fixture
def copied_output(workspace: Workspace, tmp_path: Path) -> Path:
    """A copy of the finished experiment's folder, to be changed."""
    return Path(shutil.copytree(workspace.output_dir, tmp_path / "copied"))
