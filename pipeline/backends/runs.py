"""MLflow's runs: open the tracking store, begin and end runs, log what they make.

By default everything is in one SQLite file with the artifacts beside it, made once by ``open_tracking`` in the driver.
Models are in `pipeline.backends.registry`; no other module imports MLflow but ``likelihood_pyfunc``, which MLflow runs.
"""

import contextlib
import hashlib
import logging
import os
import re
import sqlite3
import tempfile
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mlflow
import numpy as np
import pandas as pd
from filelock import FileLock
from mlflow.data.pandas_dataset import from_pandas
from mlflow.data.sources import LocalArtifactDatasetSource  # type: ignore[attr-defined]  # made at run time
from mlflow.entities import Experiment, LoggedModelInput
from mlflow.exceptions import MlflowException
from sqlalchemy.exc import SQLAlchemyError

from mrtask.errors import without_secrets
from mrtask.likelihood.dataset import CARD_FILE, MANIFEST_FILE, Dataset
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.metrics import evaluate_by, reliability
from mrtask.likelihood.rows import SPLITS, TRIPLE
from mrtask.likelihood.training import TrainedModel, score
from pipeline.backends.addresses import (
    FIRST_CONNECTION_S,
    SQLITE,
    UnusableError,
    check_usable,
    database_file,
)
from pipeline.base import console
from pipeline.base.config import Config, UserError

for _name in ("mlflow", "alembic"):
    logging.getLogger(_name).setLevel(logging.ERROR)

LOCK_TIMEOUT_S = 600.0
_PARAM_LENGTH = 6000
_DIGEST_LENGTH = 36
_DESCRIPTION, _PARENT = "mlflow.note.content", "mlflow.parentRunId"
SWEEP = "sweep"
"""The tag with a cell's values of the swept keys."""
HEADLINE = re.compile(r"/all/percent_better_than_\w+(?<!_low)(?<!_high)$")
"""The metrics of an evaluation that its sweep shows too."""
_FAULTS = (MlflowException, SQLAlchemyError, sqlite3.Error)
"""What MLflow raises when its store fails."""
_KIND, _MODEL_TRAINING = "mlflow.experimentKind", "custom_model_development"
"""The tag by which MLflow's pages open on runs and models instead of on language models' traces."""


_ENVIRONMENT = threading.Lock()
"""Held by whoever changes the process's environment for a moment: cells of a sweep may run in several threads."""


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

    Artifacts of an SQLite store go to ``mlflow-artifacts`` beside it; a server decides for itself.

    Raises:
        TrackingError: the store cannot be reached within `FIRST_CONNECTION_S`, opened or written, or it was moved.
    """
    location = None
    lock_name = f"mrtask-mlflow-{os.getuid()}-{hashlib.sha256(uri.encode()).hexdigest()[:16]}.lock"
    lock_path = Path(tempfile.gettempdir()) / lock_name
    try:
        check_usable(uri)
        if uri.startswith(SQLITE):
            database = database_file(uri)
            database.parent.mkdir(parents=True, exist_ok=True)
            uri, lock_path = f"{SQLITE}{database}", database.with_suffix(".lock")
            location = (database.parent / "mlflow-artifacts").as_uri()
        found = _experiment(uri, experiment, location, lock_path)
    except (*_FAULTS, UnusableError, OSError) as error:
        raise TrackingError(
            f"tracking.uri={uri}: MLflow's store cannot be opened or made there: {_first_line(error)}"
        ) from error
    if location and found.artifact_location != location:
        raise TrackingError(
            f"tracking.uri={uri}: this store was moved: it keeps its artifacts in {found.artifact_location} (MLflow's "
            "paths are absolute). Move it back, or give another tracking.uri or tracking.experiment_name"
        )
    return Tracking(uri, str(found.experiment_id), lock_path)


def _experiment(uri: str, name: str, location: str | None, lock_path: Path) -> Experiment:
    """Return the experiment, made if it is new. A lock lets one process make a new database; servers need none."""
    mlflow.set_tracking_uri(uri)
    with _impatient(), FileLock(lock_path, timeout=LOCK_TIMEOUT_S) if location else contextlib.nullcontext():
        client = mlflow.MlflowClient()
        found = client.get_experiment_by_name(name)
        if found is None:
            try:
                found = client.get_experiment(client.create_experiment(name, location))
            except MlflowException as error:
                found = client.get_experiment_by_name(name)  # another process was faster
                if error.error_code != "RESOURCE_ALREADY_EXISTS" or found is None:
                    raise
        if found.tags.get(_KIND) != _MODEL_TRAINING:
            client.set_experiment_tag(found.experiment_id, _KIND, _MODEL_TRAINING)
    return found


@contextlib.contextmanager
def _impatient() -> Iterator[None]:
    """Let a server's first answer take `FIRST_CONNECTION_S`; MLflow by itself would ask again for minutes."""
    limits = {"MLFLOW_HTTP_REQUEST_TIMEOUT": f"{FIRST_CONNECTION_S:.0f}", "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "0"}
    with _ENVIRONMENT:
        before = {name: os.environ.get(name) for name in limits}
        os.environ.update(limits)
        try:
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


def _first_line(error: BaseException) -> str:
    """Return what an exception says, without SQLAlchemy's statements and links."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def check_store(config: Config) -> None:
    """Open the configured store before any work; a dry run does not make one. Raises `TrackingError`."""
    if not (config.dry_run and is_new(config.tracking.uri)):
        open_tracking(config.tracking.uri, config.tracking.experiment_name)


def is_new(uri: str) -> bool:
    """Tell whether opening the store would make its file."""
    return uri.startswith(SQLITE) and not database_file(uri).exists()


@contextlib.contextmanager
def run(
    tracking: Tracking, name: str, params: Mapping[str, Any], tags: Mapping[str, str], parent_run_id: str | None = None
) -> Iterator[Run]:
    """Begin a run that ends FINISHED, FAILED (exception) or KILLED (interrupt), depending on how the block ends.

    ``params`` may be nested; they are logged as ``a.b``. Empty tags are left out. With ``parent_run_id`` the run is
    shown below that one.

    Raises:
        TrackingError: the store fails while the block runs.
    """
    mlflow.set_tracking_uri(tracking.uri)
    active = mlflow.start_run(
        experiment_id=tracking.experiment_id,
        run_name=name,
        tags={key: without_secrets(value) for key, value in tags.items() if value},
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
    except _FAULTS as error:
        raise _failed(tracking, error) from error
    finally:
        try:
            mlflow.end_run(status)
        except _FAULTS as error:  # where the block ended by an exception, that one says more
            if status == "FINISHED":
                raise _failed(tracking, error) from error


def _failed(tracking: Tracking, error: BaseException) -> TrackingError:
    return TrackingError(f"tracking.uri={tracking.uri}: MLflow's store failed: {_first_line(error)}")


class SweepRecord:
    """A sweep in MLflow: the run that is the parent of its cells' runs."""

    def __init__(self, uri: str, experiment: str, output_dir: str, overrides: Sequence[str]) -> None:
        """Begin the run.

        Raises:
            TrackingError: MLflow's store cannot be used.
        """
        self._tracking = open_tracking(uri, experiment)
        self._open = contextlib.ExitStack()
        tags = {"stage": SWEEP, "output_dir": output_dir}
        params = {"overrides": " ".join(overrides)}
        self._run = self._open.enter_context(run(self._tracking, name_of(output_dir), params, tags))

    @property
    def run_id(self) -> str:
        """Of the parent."""
        return self._run.run_id

    def note_failure(self, cell: str, title: str, error: str) -> None:
        """Keep a run for a cell that failed before it had one."""
        client = mlflow.MlflowClient(self._tracking.uri)
        if cell not in self._children():
            tags = {SWEEP: cell, _PARENT: self.run_id, _DESCRIPTION: error}
            failed = client.create_run(self._tracking.experiment_id, tags=tags, run_name=title or cell)
            client.set_terminated(failed.info.run_id, "FAILED")

    def end(self, error: BaseException | None) -> None:
        """End the run as FINISHED, FAILED or KILLED, with the headline metrics of all cells."""
        if not isinstance(error, KeyboardInterrupt):
            with contextlib.suppress(*_FAULTS) if error else contextlib.nullcontext():
                self._log_headlines()
        self._open.__exit__(type(error) if error else None, error, error.__traceback__ if error else None)

    def _log_headlines(self) -> None:
        for cell, metrics in self._children().items():
            of_cell = re.sub(r"[^\w\-. ]", " ", cell)
            found = {f"{of_cell}/{name}": value for name, value in metrics.items() if HEADLINE.search(name)}
            log_metrics(self._run, found)

    def _children(self) -> dict[str, dict[str, float]]:
        """Return the metrics of the cells that have a run."""
        children = mlflow.MlflowClient(self._tracking.uri).search_runs(
            [self._tracking.experiment_id], f"tags.`{_PARENT}` = '{self.run_id}'"
        )
        return {child.data.tags.get(SWEEP, ""): child.data.metrics for child in children}


def name_of(output_dir: str) -> str:
    """Return the name of a run that leaves its results there: the folder's."""
    return output_dir.rstrip("/").rsplit("/", 1)[-1]


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
    """Record the dataset's splits as the run's inputs, its manifest and card as files.

    Of each split these are the distinct triples with their counts; tags say how many rows of how many homes they are.
    """
    for split in SPLITS:
        frame = dataset.triples(split).astype({"positives": "float64", "count": "float64"})
        triples = from_pandas(
            frame,
            source=LocalArtifactDatasetSource(str(folder.absolute())),
            name=f"labelled-rows-{split}",
            digest=hashlib.sha256(frame.to_csv(index=False).encode()).hexdigest()[:_DIGEST_LENGTH],
        )
        counts = {name: f"{dataset.manifest.counts[split][name]:.0f}" for name in ("rows", "homes")}
        mlflow.log_input(triples, context="training" if split == "train" else split, tags=counts)
    for path in (folder / MANIFEST_FILE, folder / CARD_FILE):
        if path.is_file():
            mlflow.log_artifact(str(path), "dataset", run_id=run.run_id)


def log_evaluated(run: Run, homes: pd.DataFrame, source: str, digest: str, model_id: str | None) -> None:
    """Record the homes of an evaluation, one row each, and the model that it used as the run's inputs."""
    dataset = from_pandas(
        homes, source=LocalArtifactDatasetSource(source), name="evaluation-homes", digest=digest[:_DIGEST_LENGTH]
    )
    mlflow.log_input(dataset, context="evaluation")
    if model_id:
        mlflow.MlflowClient().log_inputs(run.run_id, models=[LoggedModelInput(model_id)])


def describe(run: Run, text: str) -> None:
    """Show a text as the run's description."""
    mlflow.MlflowClient().set_tag(run.run_id, _DESCRIPTION, text)


def log_training(run: Run, trained: TrainedModel, dataset: Dataset) -> None:
    """Keep loss curves, the reliability plot and the metrics per object and container type on the test homes."""
    from mrtask.analysis.studies.training_figures import loss_curves, reliability_plot  # what draws imports slowly

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
