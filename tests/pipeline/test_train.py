"""When a model is trained again, and what is known of it afterwards."""

from pathlib import Path

import mlflow
import pytest
import torch

from mrtask.likelihood import embeddings
from pipeline.backends import registry
from pipeline.inputs.training import find_record
from tests.pipeline.harness import Cli, Workspace


def test_a_model_that_the_registry_has_lost_is_trained_once_more(workspace: Workspace, cli: Cli) -> None:
    uri = f"sqlite:///{workspace.path}/lost.db"
    other = [*workspace.overrides, f"tracking.uri={uri}"]
    assert "version 1: promoted: the first model" in cli("train", *other, cwd=workspace.path).out
    mlflow.MlflowClient(uri).delete_model_version(registry.MODEL_NAME, "1")
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


@pytest.fixture
def offline(monkeypatch: pytest.MonkeyPatch) -> None:
    """No hub is asked, whatever network there is."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    embeddings._load.cache_clear()


@pytest.mark.usefixtures("offline")
@pytest.mark.parametrize("stage", ["train", "reproduce"])
def test_an_embedding_that_cannot_be_loaded_is_refused_before_any_work(
    workspace: Workspace, cli: Cli, tmp_path: Path, stage: str
) -> None:
    finished = cli(stage, *workspace.overrides, "model=similarity", "model.embedding=typo", cwd=tmp_path)
    assert finished.code == 2
    assert "the embedding model 'typo' cannot be loaded" in finished.err and "'bundled-minilm'" in finished.err
    assert finished.out == ""


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_device_that_is_not_there_is_refused_before_any_work(workspace: Workspace, cli: Cli, tmp_path: Path) -> None:
    finished = cli("train", *workspace.overrides, "model=mlp", "trainer.device=cuda", cwd=tmp_path)
    assert finished.code == 2
    assert finished.err == "error: device cuda: torch sees no GPU here; give auto or cpu\n"
    assert finished.out == ""


def test_a_formula_whose_automaton_grows_too_large_is_refused_before_any_work(
    workspace: Workspace, cli: Cli, tmp_path: Path
) -> None:
    formula = " & ".join(f"F a{number}" for number in range(20))
    finished = cli("evaluate", *workspace.overrides, f"evaluation.formula='{formula}'", cwd=tmp_path)
    assert finished.code == 2
    assert "is too large" in finished.err and "simplify" in finished.err
