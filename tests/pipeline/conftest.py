"""One Ray session and one small finished experiment for all pipeline tests."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mlflow
import pytest

from mrtask.analysis.page import exhibits
from pipeline.backends import runs
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
    from pipeline.backends.pool import Pool
    from pipeline.base.sections import Cluster

    with Pool(Cluster(address="local", cpus=2, memory_per_task_gb=0.5, retries=3)) as pool:
        pool.start()
        yield


@contextmanager
def _no_pictures() -> Iterator[None]:
    """Reports have all their figures, but these are not drawn, which takes most of a report's time.

    The library's tests check which figures exist and how they look; the wheel's tests draw them.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exhibits, "svg_bytes", lambda figure: b"<svg xmlns='http://www.w3.org/2000/svg'/>")
        patch.setattr(exhibits, "pdf_bytes", lambda figure: b"%PDF")
        yield


@pytest.fixture(autouse=True)
def _tests_draw_nothing() -> Iterator[None]:
    with _no_pictures():
        yield


@pytest.fixture(scope="session")
def _empty_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """MLflow's store as it is when it is new; it makes its tables in some 70 migrations, which takes seconds."""
    folder = tmp_path_factory.mktemp("store")
    mlflow.MlflowClient(f"sqlite:///{folder}/mlflow.db").search_experiments()
    return folder / "mlflow.db"


@pytest.fixture(autouse=True)
def _stores_made_once(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A new store is a copy; those of other processes are made as they come."""
    opened = runs.open_tracking

    def open_tracking(uri: str, experiment: str) -> runs.Tracking:
        database = Path(uri.removeprefix("sqlite:///"))
        if uri.startswith("sqlite:///") and database.parent.is_dir() and not database.exists():
            shutil.copy(request.getfixturevalue("_empty_store"), database)
        return opened(uri, experiment)

    monkeypatch.setattr(runs, "open_tracking", open_tracking)


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
        with _no_pictures():
            code = run_stage("reproduce", *SMALL)
    finally:
        os.chdir(before)
    assert code == 0
    return Workspace(path, SMALL)


@pytest.fixture
def copied_output(workspace: Workspace, tmp_path: Path) -> Path:
    """A copy of the finished experiment's folder, to be changed."""
    return Path(shutil.copytree(workspace.output_dir, tmp_path / "copied"))


@pytest.fixture
def _houses_are_there(workspace: Workspace, tmp_path: Path) -> None:
    """The finished experiment's generated houses in an empty folder, where a stage finds them."""
    shutil.copytree(workspace.path / "datasets" / "generated", tmp_path / "datasets" / "generated")
