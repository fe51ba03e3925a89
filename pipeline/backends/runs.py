"""MLflow's runs: open the tracking store, begin and end runs, log what they make.

By default everything is in one SQLite file with the artifacts beside it, made once by ``open_tracking`` in the driver.
Models are in `pipeline.backends.registry`; no other module imports MLflow but ``likelihood_pyfunc``, which MLflow runs.
"""

import contextlib
import logging
import os
import tempfile
import threading
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mlflow
import numpy as np
import pandas as pd
from filelock import FileLock
from mlflow.data.pandas_dataset import from_pandas
from mlflow.data.sources import LocalArtifactDatasetSource  # type: ignore[attr-defined]  # made at run time
from mlflow.exceptions import MlflowException

from mrtask.analysis.studies.training_figures import loss_curves, reliability_plot
from mrtask.errors import without_secrets
from mrtask.likelihood.dataset import CARD_FILE, MANIFEST_FILE, Dataset
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.metrics import evaluate_by, reliability
from mrtask.likelihood.rows import SPLITS, TRIPLE
from mrtask.likelihood.training import TrainedModel, score
from pipeline.base import console
from pipeline.base.config import UserError

for _name in ("mlflow", "alembic"):
    logging.getLogger(_name).setLevel(logging.ERROR)

LOCK_TIMEOUT_S = 600.0
_SQLITE = "sqlite:///"
_DIGEST_LENGTH = 36
_PARAM_LENGTH = 6000


class TrackingError(UserError, ValueError):
    """MLflow's store cannot be used as configured."""


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


def open_tracking(uri: str, experiment: str) -> Tracking:
    """Open the store, making it (``sqlite:///<file>``) and the experiment when they are new; for the driver, once.

    Artifacts of an SQLite store go to ``mlflow-artifacts`` beside it; a server decides for itself. Raises
    ``TrackingError`` when the store cannot be opened or written, or when the SQLite file was moved.
    """
    location = None
    lock_path = Path(tempfile.gettempdir()) / f"mrtask-mlflow-{os.getuid()}.lock"
    try:
        if uri.startswith(_SQLITE):
            database = _database(uri)
            database.parent.mkdir(parents=True, exist_ok=True)
            uri, lock_path = f"{_SQLITE}{database}", database.with_suffix(".lock")
            location = (database.parent / "mlflow-artifacts").as_uri()
        with FileLock(lock_path, timeout=LOCK_TIMEOUT_S):
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


def is_new(uri: str) -> bool:
    """Tell whether opening the store would make its file."""
    return uri.startswith(_SQLITE) and not _database(uri).is_file()


def _database(uri: str) -> Path:
    return Path(uri.removeprefix(_SQLITE)).expanduser().absolute()


@contextlib.contextmanager
def run(
    tracking: Tracking, name: str, params: Mapping[str, Any], tags: Mapping[str, str], parent_run_id: str | None = None
) -> Iterator[Run]:
    """Begin a run that ends FINISHED, FAILED (exception) or KILLED (interrupt), depending on how the block ends.

    ``params`` may be nested; they are logged as ``a.b``. With ``parent_run_id`` it is shown below that run.
    """
    mlflow.set_tracking_uri(tracking.uri)
    active = mlflow.start_run(
        experiment_id=tracking.experiment_id,
        run_name=name,
        tags={key: without_secrets(value) for key, value in tags.items()},
        nested=mlflow.active_run() is not None,
        parent_run_id=parent_run_id,
    )
    status = "FAILED"
    try:
        mlflow.log_params({key: without_secrets(str(value))[:_PARAM_LENGTH] for key, value in _flat(params).items()})
        yield Run(tracking, active.info.run_id)
        status = "FINISHED"
    except KeyboardInterrupt:
        status = "KILLED"
        raise
    finally:
        mlflow.end_run(status)


def has_run(tracking: Tracking, run_id: str) -> bool:
    """Tell whether the tracking store holds the run; a run may be recorded in another one."""
    return _status(tracking, run_id) is not None


def end_abandoned(tracking: Tracking, run_id: str) -> None:
    """Mark a run as KILLED if its driver died without ending it; the run that continues its work calls this."""
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


class LiveMetrics:
    """Logs numbers of a run under way from a thread, so that a slow or dead server holds nobody up."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._thread: threading.Thread | None = None
        self._step = 0

    def log(self, metrics: Mapping[str, float]) -> None:
        """Log them as the next step; they are left out where the last ones are still on their way."""
        if self._thread is None or not self._thread.is_alive():
            self._step += 1
            self._thread = threading.Thread(target=self._log, args=(metrics, self._step), daemon=True)
            self._thread.start()

    def _log(self, metrics: Mapping[str, float], step: int) -> None:
        try:
            log_metrics(self._run, metrics, step)
        except MlflowException as error:
            console.line(f"MLflow does not take live metrics: {str(error).splitlines()[0]}")


def log_artifact(run: Run, path: Path, folder: str | None = None) -> None:
    """Keep a file, or a folder's content, with the run under ``folder``."""
    log = mlflow.log_artifacts if path.is_dir() else mlflow.log_artifact
    log(str(path), folder, run_id=run.run_id)


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
    test, client = dataset.triples("test"), mlflow.MlflowClient()
    if trained.history:
        table = score(FrequencyModel(dataset.triples("train")), dataset.triples("validation"))
        client.log_figure(run.run_id, loss_curves(trained.history, table["log_loss"]), "figures/loss_curves.png")
    if not len(test):
        return
    probs = trained.model.predict(test)
    client.log_figure(run.run_id, reliability_plot(reliability(probs, test)), "figures/reliability.png")
    for column in TRIPLE:
        text = evaluate_by(probs, test, column).to_csv(index=False)
        client.log_text(run.run_id, text, f"metrics/test_by_{column}.csv")


def _flat(params: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in params.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return flat
