"""Trains the model of where objects lie, from names alone, and registers it; finds a model that was trained before."""

import shutil
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from omegaconf import OmegaConf
from pydantic import TypeAdapter

from mrtask.errors import without_secrets
from mrtask.likelihood.dataset import Dataset, read_dataset, read_manifest
from mrtask.likelihood.embeddings import check_embedding
from mrtask.likelihood.options import EpochMetrics, NetworkOptions, TrainingOptions
from mrtask.likelihood.training import TrainedModel, fit, score, train_model
from pipeline.backends import registry, runs
from pipeline.base import console, interrupt
from pipeline.base.config import CONF_DIR, content_hash
from pipeline.base.sections import Frequency, Model, Network
from pipeline.base.specs import TrainingSpec
from pipeline.store import artifacts
from pipeline.store.artifacts import NotMade
from pipeline.store.records import TrainedModelRecord
from pipeline.store.version import code_version, source_hash

SHOWN_METRICS = ("log_loss", "roc_auc")


def check(wanted: TrainingSpec) -> None:
    """Refuse, before any work, an embedding that cannot be loaded and a device that this machine does not have.

    Raises:
        InputError: with what is wrong and what is allowed.
    """
    if not isinstance(wanted.model, Frequency):
        check_embedding(wanted.model.embedding)
    if isinstance(wanted.model, Network) and wanted.trainer.device != "auto":
        from mrtask.likelihood.network_training import find_device  # torch takes seconds to import

        find_device(wanted.trainer.device)


def options(wanted: TrainingSpec) -> TrainingOptions:
    """Return model and trainer as the library's options; checkpoints go to the cache."""
    of_network = {"layers", "dropout"}
    network = wanted.trainer.model_dump() | wanted.model.model_dump(include=of_network)
    return TrainingOptions(
        **wanted.model.model_dump(exclude=of_network),
        network=NetworkOptions(seed=wanted.seed, **network),
        cache_dir=wanted.cache_dir,
        checkpoint_dir=wanted.cache_dir / "checkpoints",
    )


def preset(wanted: TrainingSpec, kind: str) -> TrainingOptions:
    """Return the options of a kind's own preset, on the configured embedding and without checkpoints."""
    return replace(options(rival(wanted, kind)), checkpoint_dir=None)


def rival(wanted: TrainingSpec, kind: str) -> TrainingSpec:
    """Return the training of another kind of model by its own preset, on the configured embedding."""
    preset = OmegaConf.to_container(OmegaConf.load(CONF_DIR / "model" / f"{kind}.yaml"))
    model = TypeAdapter[Model](Model).validate_python(preset)
    configured = wanted.model.model_dump(include=type(model).model_fields.keys() - {"kind", "layers"})
    return replace(wanted, model=model.model_copy(update=configured))


def train(rows_folder: Path, wanted: TrainingSpec) -> TrainedModelRecord:
    """Return the record of the model trained on a dataset: trained and registered, unless the registry has it already.

    Raises:
        TrackingError: MLflow's store cannot be used.
        DatasetError: the dataset is missing or damaged.
    """
    began_s, (key, folder) = time.monotonic(), _place(rows_folder, wanted)
    console.headline("train", wanted.what)
    tracking = runs.open_tracking(wanted.tracking.uri, wanted.tracking.experiment_name)
    record = artifacts.find_manifest(folder, TrainedModelRecord)
    if record is not None and registry.is_registered(tracking, record.model_version):
        console.skipped(f"{registry.MODEL_NAME} version {record.model_version}")
        return record
    if record is not None:  # of a version that is no longer in the registry
        shutil.rmtree(folder)
    record = artifacts.make(folder, lambda _: _register(wanted, rows_folder, tracking, key))
    _say(record)
    console.result(f"{registry.MODEL_NAME} version {record.model_version}", time.monotonic() - began_s)
    return record


def choose(trained: Sequence[TrainedModelRecord]) -> TrainedModelRecord:
    """Return the version with the least log loss on the test homes, the first of equals; of several, say which.

    All were trained on one dataset, so they were measured on the same homes, which none of them has seen.
    """
    best, *others = sorted(trained, key=lambda record: record.metrics["log_loss"])
    if others:
        beaten = ", ".join(f"{one.metrics['log_loss']:.5f} of {one.kind}" for one in others)
        console.line(
            f"{best.kind} plans (version {best.model_version}): log loss {best.metrics['log_loss']:.5f} against "
            f"{beaten} on the same {best.test_homes} test homes"
        )
    return best


def find(rows_folder: Path, wanted: TrainingSpec) -> TrainedModelRecord:
    """Return the record of the model trained on a dataset; raises `NotMade` where it was not trained yet."""
    record = artifacts.find_manifest(_place(rows_folder, wanted)[1], TrainedModelRecord)
    if record is None:
        raise NotMade(f"{wanted.what} is not trained yet; python -m pipeline.train trains it")
    return record


def find_record(datasets_dir: Path, tracking_uri: str, model_version: str) -> TrainedModelRecord | None:
    """Return the record of a registered version; None where it was trained elsewhere."""
    wanted = (model_version, without_secrets(tracking_uri))
    for path in (datasets_dir / "models").glob(f"*/{artifacts.MANIFEST}"):
        record = artifacts.find_manifest(path.parent, TrainedModelRecord)
        if record is not None and (record.model_version, without_secrets(record.tracking_uri)) == wanted:
            return record
    return None


def _place(rows_folder: Path, wanted: TrainingSpec) -> tuple[str, Path]:
    """Return the hash of all that a training on these rows depends on, and the folder of its record."""
    rows_hash, code = read_manifest(rows_folder).content_hash, source_hash("mrtask/likelihood")
    key = content_hash([rows_hash, *wanted.params.values(), code, wanted.tracking.model_dump()])
    return key, wanted.datasets_dir / "models" / f"{wanted.model.kind}-{key}"


def _register(wanted: TrainingSpec, rows_folder: Path, tracking: runs.Tracking, key: str) -> TrainedModelRecord:
    data = read_dataset(rows_folder)
    tags = {"stage": "train", "training_key": key, "code_version": code_version()}
    with runs.run(tracking, f"train {wanted.model.kind}", wanted.params, tags) as run:
        runs.log_dataset(run, data, rows_folder)
        trained = _train(options(wanted), data, run)
        runs.log_training(run, trained, data)
        console.line("registering")
        registration = registry.register_model(run, trained, data)
        return _record(trained, data, registration, run, key)


def _train(options: TrainingOptions, data: Dataset, run: runs.Run) -> TrainedModel:
    done = 0
    with console.Progress(options.network.max_epochs, "epochs (at most)") as progress:

        def on_epoch(epoch: int, metrics: EpochMetrics) -> None:
            nonlocal done
            interrupt.check()
            if epoch > done + 1:
                console.line(f"an interrupted training continues after epoch {epoch - 1}")
            runs.log_metrics(run, metrics, step=epoch)
            progress.update(epoch - done, f"validation log loss {metrics['validation_loss']:.4f}")
            done = epoch

        trained = train_model(data, options, on_epoch, console.line)
    for split, metrics in trained.metrics.items():
        runs.log_metrics(run, {f"{split}_{name}": value for name, value in metrics.items()})
    return trained


def _record(
    trained: TrainedModel, data: Dataset, registration: registry.Registration, run: runs.Run, key: str
) -> TrainedModelRecord:
    """Return the record of a newly registered model, beside the frequency table on the same homes."""
    options, metrics = trained.options, trained.metrics["test"]
    table, _ = fit(data.triples("train"), data.triples("validation"), replace(options, kind="frequency"))
    frequency = score(table, data.triples("test"))
    return TrainedModelRecord(
        name=registry.MODEL_NAME,
        model_version=registration.version,
        kind=options.kind,
        embedding=options.embedding,
        champion=registration.promoted,
        training_homes=len(data.manifest.split["train"]),
        test_homes=len(data.manifest.split["test"]),
        metrics=metrics,
        frequency_metrics=frequency,
        beats_frequency=metrics["log_loss"] < frequency["log_loss"],
        note=registration.reason,
        dataset=data.manifest.content_hash,
        tracking_uri=run.tracking.uri,
        run_id=run.run_id,
        key=key,
    )


def _say(record: TrainedModelRecord) -> None:
    own, table = (
        ", ".join(f"{name} {metrics[name]:.4f}" for name in SHOWN_METRICS)
        for metrics in (record.metrics, record.frequency_metrics)
    )
    console.line(f"test homes: {own}; the frequency table: {table}")
    console.line(f"version {record.model_version}: {record.note}")
    if not record.champion:
        uri = registry.version_uri(record.model_version)
        console.line(f"evaluations use the champion; to use this version all the same: evaluation.model_uri={uri}")
