"""MLflow's store and registry: what is recorded, who becomes champion, and what happens to damaged or rival models."""

import json
import shutil
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mrtask.likelihood.dataset import build_dataset, write_dataset
from mrtask.likelihood.options import NetworkOptions, TrainingOptions
from mrtask.likelihood.training import train_model
from tests.likelihood.made_up_world import draw_homes

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import mlflow
    import mlflow.pyfunc

    from pipeline.backends import registry, runs

pytestmark = pytest.mark.filterwarnings(
    "ignore::UserWarning:mlflow", "ignore:.*noload.*", "ignore:Operation with range"
)

PROBS = {
    ("Fridge", "Kitchen"): {"Apple": 0.8, "Book": 0.1, "Mug": 0.3},
    ("Bed", "Bedroom"): {"Book": 0.5, "Pillow": 0.9},
}
HOMES = {"train": 60, "validation": 20, "test": 40}
NAMES = pd.DataFrame({"object": ["Apple", "Duvet"], "container": ["Fridge", "Bed"], "room": ["Kitchen", "Bedroom"]})


@pytest.fixture(scope="module")
def homes():
    return {name: draw_homes(number, seed, PROBS) for seed, (name, number) in enumerate(HOMES.items(), 1)}


@pytest.fixture(scope="module")
def dataset(homes):
    return build_dataset(homes, source="made-up", seed=0, code_version="test")


@pytest.fixture(scope="module")
def good(dataset):
    return train_model(dataset, TrainingOptions("frequency"))


@pytest.fixture(scope="module")
def poor(dataset):
    return train_model(dataset, TrainingOptions("frequency", smoothing=300.0))


@pytest.fixture(scope="module")
def empty_store(tmp_path_factory):
    """A fresh store, made once; making its tables takes seconds."""
    folder = tmp_path_factory.mktemp("store")
    open_in(folder)
    return folder


@pytest.fixture
def store(empty_store, tmp_path):
    """A fresh store of one's own, in a folder whose name needs care in URIs."""
    folder = tmp_path / "runs of Zoë"
    folder.mkdir()
    shutil.copy(empty_store / "mlflow.db", folder)
    return open_in(folder, "mine")


def open_in(folder, experiment="mrtask"):
    return runs.open_tracking(f"sqlite:///{folder}/mlflow.db", experiment)


def register(store, trained, dataset, name="train"):
    with runs.run(store, name, {}, {}) as run:
        return registry.register_model(run, trained, dataset)


def artifact(store, version, name):
    source = mlflow.MlflowClient().get_model_version(registry.MODEL_NAME, version).source
    return Path(mlflow.artifacts.download_artifacts(artifact_uri=source)) / "artifacts" / name


def test_new_store_lies_in_one_folder(empty_store):
    assert (empty_store / "mlflow.db").is_file()
    assert open_in(empty_store) == open_in(empty_store)


def test_store_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(runs.TrackingError, match=r"tracking.uri=.*MLflow's store cannot be opened or made there"):
        open_in(tmp_path / "file")


def test_moved_store_is_noticed(store, tmp_path):
    shutil.move(tmp_path / "runs of Zoë", tmp_path / "elsewhere")
    with pytest.raises(runs.TrackingError, match="this store was moved"):
        open_in(tmp_path / "elsewhere", "mine")


def test_run_records_all_it_is_given(store, dataset, good, tmp_path):
    write_dataset(dataset, tmp_path / "rows")
    (tmp_path / "note.txt").write_text("hello")
    with runs.run(store, "train", {"model": {"kind": "frequency"}, "seed": 3}, {"git": "abc", "sweep": ""}) as run:
        for epoch, loss in enumerate([0.5, 0.25], 1):
            runs.log_metrics(run, {"loss": loss, "nothing": float("nan")}, step=epoch)
        runs.log_artifact(run, tmp_path / "note.txt", "notes")
        runs.log_dataset(run, dataset, tmp_path / "rows")
        runs.log_training(run, good, dataset)
    client = mlflow.MlflowClient()
    found = client.get_run(run.run_id)
    assert found.info.status == "FINISHED"
    assert found.data.params == {"model.kind": "frequency", "seed": "3"}
    assert found.data.tags["git"] == "abc" and "sweep" not in found.data.tags
    assert [(m.step, m.value) for m in client.get_metric_history(run.run_id, "loss")] == [(1, 0.5), (2, 0.25)]
    assert "nothing" not in found.data.metrics
    inputs = {item.dataset.name: item for item in found.inputs.dataset_inputs}
    assert set(inputs) == {"labelled-rows-train", "labelled-rows-validation", "labelled-rows-test"}
    assert len({item.dataset.digest for item in inputs.values()}) == 3, "each split has a digest of its own"
    for split, homes in HOMES.items():
        tags = {tag.key: tag.value for tag in inputs[f"labelled-rows-{split}"].tags}
        assert (tags["homes"], tags["rows"]) == (str(homes), f"{dataset.manifest.counts[split]['rows']:.0f}")
    assert str(tmp_path / "rows") in inputs["labelled-rows-train"].dataset.source
    files = {
        f"{folder}/{Path(item.path).name}"
        for folder in ("notes", "dataset", "figures", "metrics")
        for item in client.list_artifacts(run.run_id, folder)
    }
    assert {"notes/note.txt", "dataset/manifest.json", "figures/reliability.png", "metrics/test_by_object.csv"} <= files


def test_a_table_is_replaced_and_shown_beside_others(store):
    first = pd.DataFrame({"planner": ["pouct", "greedy"], "mean_cost_s": [1.5, float("nan")]})
    with runs.run(store, "evaluate", {}, {}) as run:
        runs.log_table(run, first, "table.json")
    runs.log_table(run, first.head(1).assign(mean_cost_s=2.5), "table.json")
    kept = mlflow.MlflowClient().load_table(store.experiment_id, "table.json", run_ids=[run.run_id])
    assert kept.to_dict("records") == [{"planner": "pouct", "mean_cost_s": 2.5}]
    shown = json.loads(mlflow.MlflowClient().get_run(run.run_id).data.tags["mlflow.loggedArtifacts"])
    assert shown == [{"path": "table.json", "type": "table"}]


def test_runs_end_as_they_were_left_and_have_children(store):
    client = mlflow.MlflowClient()
    with runs.run(store, "parent", {}, {}) as parent, runs.run(store, "child", {}, {}, parent.run_id) as child:
        pass
    assert client.get_run(child.run_id).data.tags["mlflow.parentRunId"] == parent.run_id
    for error, status in ((RuntimeError, "FAILED"), (KeyboardInterrupt, "KILLED")):
        with pytest.raises(error), runs.run(store, "broken", {}, {}) as run:
            raise error
        assert client.get_run(run.run_id).info.status == status
    assert mlflow.active_run() is None


def test_a_store_that_fails_under_way_is_told_in_one_line(store):
    message = r"^tracking\.uri=sqlite:.*: MLflow's store failed: no such run$"
    with pytest.raises(runs.TrackingError, match=message), runs.run(store, "broken", {}, {}):
        raise mlflow.exceptions.MlflowException("no such run\n[SQL: select]")
    assert mlflow.active_run() is None


def test_first_model_is_champion_and_only_a_better_one_follows(store, dataset, poor, good):
    with pytest.raises(registry.ChampionError, match=r"no usable model models:/container-object-likelihood@champion"):
        registry.load_registered(store)
    first = register(store, poor, dataset)
    assert first == registry.Registration("1", True, "promoted: the first model")
    second = register(store, good, dataset)
    numbers = (
        f"log loss {good.metrics['test']['log_loss']:.5f} against {poor.metrics['test']['log_loss']:.5f} of version 1"
    )
    assert second == registry.Registration("2", True, f"promoted: {numbers} on the same 40 test homes")
    third = register(store, poor, dataset)
    assert not third.promoted and third.reason.startswith("refused: log loss")
    assert not register(store, good, dataset).promoted
    champion = registry.load_registered(store)
    assert champion.version == "2"
    assert registry.logged_model_id(store, "2") in artifact(store, "2", "model").parts
    assert registry.logged_model_id(store, "99") is None
    assert champion.training_homes == {*dataset.manifest.split["train"], *dataset.manifest.split["validation"]}
    assert np.array_equal(champion.model.predict(NAMES), good.model.predict(NAMES))

    registry.set_champion(store, "1")
    assert registry.load_registered(store).version == "1"
    assert registry.load_registered(store, f"models:/{registry.MODEL_NAME}/2").version == "2"
    with pytest.raises(registry.ChampionError, match="no usable model models:/container-object-likelihood/99"):
        registry.set_champion(store, "99")
    assert registry.load_registered(store).version == "1"


def test_champion_is_not_judged_on_homes_it_was_trained_on(store, homes, dataset, poor, good):
    other = build_dataset(
        {"train": homes["test"][:20], "test": homes["train"]}, source="made-up", seed=0, code_version="test"
    )
    register(store, poor, dataset)
    found = register(store, train_model(other, TrainingOptions("frequency")), other)
    assert not found.promoted
    assert found.reason == "refused: no test homes that the champion (version 1) was not trained on"


def test_registered_model_works_by_itself_in_another_process(store, dataset, embedding_cache_dir, tmp_path):
    network = NetworkOptions(layers=(8,), max_epochs=2, device="cpu", threads=1)
    trained = train_model(dataset, TrainingOptions("mlp", network=network, cache_dir=embedding_cache_dir))
    register(store, trained, dataset)
    expected = trained.model.predict(NAMES).tolist()
    NAMES.to_json(tmp_path / "names.json", orient="records")
    code = f"""
import mlflow, pandas as pd, json
mlflow.set_tracking_uri({store.uri!r})
model = mlflow.pyfunc.load_model("models:/container-object-likelihood@champion")
print(json.dumps(model.predict(pd.read_json({str(tmp_path / "names.json")!r})).tolist()))
"""
    environment = {"PATH": "/usr/bin", "MRTASK_CACHE_DIR": str(embedding_cache_dir)}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        cwd="/",
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout) == pytest.approx(expected, abs=1e-6)


def test_stored_model_has_a_signature_an_example_its_requirements_and_no_pickle(store, dataset, good):
    register(store, good, dataset)
    info = mlflow.models.get_model_info(registry.CHAMPION_URI)
    assert [(column.name, column.type.name) for column in info.signature.inputs] == [
        ("object", "string"),
        ("container", "string"),
        ("room", "string"),
    ]
    folder = Path(mlflow.artifacts.download_artifacts(artifact_uri=registry.CHAMPION_URI))
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert {"requirements.txt", "input_example.json", "likelihood_pyfunc.py", "MLmodel"} <= {
        path.name for path in files
    }
    assert not [path for path in files if path.suffix in (".pkl", ".pickle", ".pt", ".pth", ".bin", ".joblib")]
    requirements = (folder / "requirements.txt").read_text()
    assert "torch==" in requirements and "+" not in requirements


@pytest.mark.parametrize("damage", ["truncated", "description", "missing"])
def test_damaged_champion_is_refused_and_makes_way(store, dataset, good, poor, damage):
    register(store, good, dataset)
    folder = artifact(store, "1", "model")
    if damage == "missing":
        shutil.rmtree(folder)
    elif damage == "truncated":
        (folder / "counts.csv").write_bytes((folder / "counts.csv").read_bytes()[:-10])
    else:
        (folder / "model.json").write_text("{")
    with pytest.raises(registry.ChampionError, match=r"@champion \(version 1\) is damaged: .*model"):
        registry.load_registered(store)
    second = register(store, poor, dataset)
    assert second.promoted and second.reason.startswith("promoted: the present champion cannot be used")
    assert registry.load_registered(store).version == "2"


def test_champion_of_another_signature_is_refused(store, tmp_path):
    (tmp_path / "other.py").write_text(
        "import mlflow\nimport pandas as pd\n"
        "class Other(mlflow.pyfunc.PythonModel):\n"
        "    def predict(self, context, model_input: pd.DataFrame, params=None):\n"
        "        return model_input\n"
        "mlflow.models.set_model(Other())\n"
    )
    signature = mlflow.models.infer_signature(pd.DataFrame({"x": [1.0]}), np.zeros(1))
    with runs.run(store, "other", {}, {}) as run:
        info = mlflow.pyfunc.log_model(
            name="model", python_model=str(tmp_path / "other.py"), signature=signature, pip_requirements=["mlflow"]
        )
        client = mlflow.MlflowClient()
        client.create_registered_model(registry.MODEL_NAME)
        client.create_model_version(registry.MODEL_NAME, info.model_uri, run.run_id)
        client.set_registered_model_alias(registry.MODEL_NAME, "champion", "1")
    with pytest.raises(
        registry.ChampionError, match=r"\(version 1\) is no container-object likelihood: its inputs are .*x"
    ):
        registry.load_registered(store)


def test_two_trainings_at_once_lose_nothing(dataset, tmp_path):
    """Both make the store, and each registers two models: all are whole and the best of the four is champion."""
    write_dataset(dataset, tmp_path / "rows")
    script = tmp_path / "register.py"
    script.write_text(f"""
import sys
from pathlib import Path
from pipeline.backends import registry, runs
from mrtask.likelihood.dataset import read_dataset
from mrtask.likelihood.training import TrainingOptions, train_model
store = runs.open_tracking("sqlite:///{tmp_path}/mlflow.db", "mrtask")
dataset = read_dataset(Path({str(tmp_path / "rows")!r}))
for smoothing in map(float, sys.argv[1:]):
    trained = train_model(dataset, TrainingOptions("frequency", smoothing=smoothing))
    with runs.run(store, "train", {{}}, {{}}) as run:
        registry.register_model(run, trained, dataset)
""")
    strengths = [["900", "4"], ["300", "12"]]
    both = [
        subprocess.Popen([sys.executable, str(script), *two], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for two in strengths
    ]
    assert [(*process.communicate(), process.returncode) for process in both] == [("", "", 0)] * 2
    store, losses = open_in(tmp_path), {}
    for version in range(1, 5):
        model = registry.load_registered(store, f"models:/{registry.MODEL_NAME}/{version}").model
        losses[str(version)] = registry.score(model, dataset.triples("test"))["log_loss"]
    assert len(set(losses.values())) == 4
    assert registry.load_registered(store).version == min(losses, key=lambda version: losses[version])


@pytest.fixture(scope="module")
def embedding_cache_dir(tmp_path_factory):
    return tmp_path_factory.mktemp("embeddings")


def test_a_served_model_is_copied_once_a_version(store, good, poor, dataset, tmp_path, monkeypatch):
    register(store, good, dataset)
    copied, download = [], mlflow.artifacts.download_artifacts

    def downloading(**options):
        copied.append(options["artifact_uri"].rpartition("/")[2])
        return download(**options)

    def load(version):
        return registry.load_registered(store, registry.version_uri(version), tmp_path / "cache").model.predict(NAMES)

    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    monkeypatch.setattr(mlflow.artifacts, "download_artifacts", downloading)
    monkeypatch.setattr(registry, "SQLITE", "no store is on this machine")
    first = load("1")
    assert copied == ["MLmodel", "artifacts"]
    np.testing.assert_array_equal(load("1"), first)
    assert len(copied) == 2, "it was downloaded again"
    [folder] = (tmp_path / "cache" / "models").iterdir()
    next(path for path in folder.rglob("*.csv")).unlink()  # to make room in the cache
    np.testing.assert_array_equal(load("1"), first)
    assert len(copied) == 4
    register(store, poor, dataset)
    assert not np.array_equal(load("2"), first)
    assert len(list((tmp_path / "cache" / "models").iterdir())) == 2
    assert list((tmp_path / "tmp").iterdir()) == []
