"""When a model is trained again, and what is known of it afterwards."""

from pathlib import Path

import mlflow

from pipeline.backends import tracking
from pipeline.train import find_record
from tests.pipeline.harness import Cli, Workspace


def test_a_model_that_the_registry_has_lost_is_trained_once_more(workspace: Workspace, cli: Cli) -> None:
    uri = f"sqlite:///{workspace.path}/lost.db"
    other = [*workspace.overrides, f"tracking.uri={uri}"]
    assert "version 1: promoted: the first model" in cli("train", *other, cwd=workspace.path).out
    mlflow.MlflowClient(uri).delete_model_version(tracking.MODEL_NAME, "1")
    assert "version 2: promoted" in cli("train", *other, cwd=workspace.path).out
    assert "version 2 (unchanged, skipped)" in cli("train", *other, cwd=workspace.path).out


def test_the_record_of_a_version_is_that_of_its_registry(workspace: Workspace, tmp_path: Path) -> None:
    datasets, uri = workspace.path / "datasets", f"sqlite:///{workspace.path}/outputs/mlflow.db"
    record = find_record(datasets, uri, "1")
    assert record is not None and record.tracking_uri == uri
    assert (record.kind, record.champion, record.training_homes, record.test_homes) == ("frequency", True, 12, 9)
    assert record.metrics.keys() == record.frequency_metrics.keys()
    assert find_record(datasets, uri, "99") is None
    assert find_record(datasets, "sqlite:///elsewhere.db", "1") is None
    assert find_record(tmp_path, uri, "1") is None
