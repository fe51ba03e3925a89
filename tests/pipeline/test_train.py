"""When a model is trained again, and what is known of it afterwards."""

import json
from dataclasses import replace
from pathlib import Path

import mlflow
import pandas as pd
import pytest
import torch

from mrtask.likelihood import embeddings
from pipeline.backends import registry
from pipeline.base.sections import Frequency
from pipeline.base.specs import TrainingSpec
from pipeline.inputs import training
from pipeline.inputs.training import find_record
from pipeline.store.records import TrainedModelRecord
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


FEW = ("evaluation.size_classes=[small]", "evaluation.robots=[1]", "evaluation.planners=[nonlearned_myopic]")


def test_reproduce_plans_with_the_version_that_it_trained_whatever_the_champion(
    workspace: Workspace, cli: Cli, tmp_path: Path
) -> None:
    store = f"tracking.uri=sqlite:///{tmp_path}/champions.db"
    common = [*workspace.overrides, *FEW, store]
    assert "version 1: promoted" in cli("train", *common, cwd=workspace.path).out
    done = cli("reproduce", *common, "model.smoothing=5000", "output_dir=outputs/own_model", cwd=workspace.path)
    assert done.code == 0, done.err
    assert "version 2: refused" in done.out
    assert "planners use version 2 of the model; the champion is version 1" in done.out
    target = workspace.path / "outputs" / "own_model"
    assert set(pd.read_parquet(target / "episodes")["model_version"]) == {"2"}
    assert "no, the champion was version 1; this run did not plan with it" in (target / "report/index.html").read_text()
    champions = cli("evaluate", *common, "model.smoothing=5000", "output_dir=outputs/champion", cwd=workspace.path)
    assert champions.code == 0 and "the champion is version" not in champions.out
    assert set(pd.read_parquet(workspace.path / "outputs/champion/episodes")["model_version"]) == {"1"}


def test_the_better_of_the_models_that_one_command_trained_plans(
    workspace: Workspace, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def coarse(wanted: TrainingSpec, kind: str) -> TrainingSpec:
        return replace(wanted, model=Frequency(kind="frequency", smoothing=5000.0))

    monkeypatch.setattr(training, "rival", coarse)  # a network would take a minute
    monkeypatch.setattr("pipeline.episodes.runner.PILOT_S", 0.1)
    store = f"tracking.uri=sqlite:///{tmp_path}/rivals.db"
    common = [*workspace.overrides, *FEW, store, "rivals=[mlp]"]
    done = cli("reproduce", *common, "output_dir=outputs/rivals", cwd=workspace.path)
    assert done.code == 0, done.err
    assert (
        "frequency plans (version 1): log loss 0." in done.out and "of frequency on the same 9 test homes" in done.out
    )
    manifest = json.loads((workspace.path / "outputs/rivals/evaluation.json").read_bytes())
    assert (manifest["model_version"], [one["model_version"] for one in manifest["rivals"]]) == ("1", ["2"])
    assert manifest["model"]["metrics"]["log_loss"] < manifest["rivals"][0]["metrics"]["log_loss"]
    page = (workspace.path / "outputs/rivals/report/index.html").read_text()
    assert "frequency, version 2" in page and "The same command trained frequency beside it" in page
    outline = cli("reproduce", *common, "dry_run=true", "output_dir=outputs/rivals", cwd=workspace.path)
    assert "would train frequency beside it" in outline.out


def test_of_equal_models_the_one_that_was_asked_for_plans(capsys: pytest.CaptureFixture[str]) -> None:
    record = TrainedModelRecord.model_construct(kind="mlp", model_version="3", test_homes=9, metrics={"log_loss": 0.3})
    other = record.model_copy(update={"kind": "paper_fcnn", "model_version": "4"})
    better = other.model_copy(update={"metrics": {"log_loss": 0.2}})
    assert training.choose([record, other]) is record
    assert training.choose([record, better]) is better
    assert "paper_fcnn plans (version 4): log loss 0.20000 against 0.30000 of mlp" in capsys.readouterr().out
    assert training.choose([record]) is record and capsys.readouterr().out == ""
