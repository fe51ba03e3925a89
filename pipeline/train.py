"""Trains the model of where objects lie, from names alone, and registers it in MLflow.

It is registered as ``container-object-likelihood``. The first model takes the alias ``champion``, a later one only by
beating the present champion. A model is trained again only when dataset, model, options or code have changed.
"""

import shutil
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from pydantic import TypeAdapter

from mrtask.likelihood.dataset import Dataset, read_dataset, read_manifest
from mrtask.likelihood.embeddings import check_embedding
from mrtask.likelihood.options import EpochMetrics, NetworkOptions, TrainingOptions
from mrtask.likelihood.training import TrainedModel, fit, score, train_model
from pipeline import dataset
from pipeline.app.main import CONF_DIR, main
from pipeline.app.stage import Session, Stage
from pipeline.backends import tracking
from pipeline.backends.tracking import ChampionError
from pipeline.base import console, interrupt
from pipeline.base.config import Config, content_hash
from pipeline.base.sections import Frequency, Model, Network, Tracking, Trainer
from pipeline.store import artifacts
from pipeline.store.records import TrainedModelRecord
from pipeline.store.version import code_version, source_hash

SHOWN_METRICS = ("log_loss", "roc_auc")


def run(config: Config, session: Session) -> TrainedModelRecord:
    """The stage: the record of the trained model."""
    check(config.model, config.trainer)
    return train_on(dataset.run(config, session), config)


def check(model: Model, trainer: Trainer) -> None:
    """Refuses, before any work, an embedding that cannot be loaded and a device that this machine does not have.

    Raises:
        InputError: with what is wrong and what is allowed.
    """
    if not isinstance(model, Frequency):
        check_embedding(model.embedding)
    if isinstance(model, Network) and trainer.device != "auto":
        from mrtask.likelihood.network_training import find_device  # torch takes seconds to import

        find_device(trainer.device)


def train_on(rows_folder: Path, config: Config) -> TrainedModelRecord:
    """`train` as configured."""
    return train(
        rows_folder, config.model, config.trainer, config.seed, config.tracking, config.datasets_dir, config.cache_dir
    )


def train(
    rows_folder: Path,
    model: Model,
    trainer: Trainer,
    seed: int,
    registry: Tracking,
    datasets_dir: Path,
    cache_dir: Path,
) -> TrainedModelRecord:
    """The record of the model trained on a dataset: trained and registered, unless it is in the registry already.

    Raises:
        TrackingError: MLflow's store cannot be used.
        DatasetError: the dataset is missing or damaged.
    """
    began_s = time.monotonic()
    params = {"model": model.model_dump(mode="json"), "trainer": trainer.model_dump(mode="json"), "seed": seed}
    rows_hash = read_manifest(rows_folder).content_hash
    key = content_hash([rows_hash, *params.values(), source_hash("mrtask/likelihood"), registry.model_dump()])
    folder = datasets_dir / "models" / f"{model.kind}-{key}"
    console.headline("train", model.kind if isinstance(model, Frequency) else f"{model.kind} on {model.embedding}")
    store = tracking.open_tracking(registry.uri, registry.experiment_name)
    record = artifacts.find_manifest(folder, TrainedModelRecord)
    if record is not None and _registered(store, record.model_version):
        console.skipped(f"{tracking.MODEL_NAME} version {record.model_version}")
        return record
    if record is not None:  # of a version that is no longer in the registry
        shutil.rmtree(folder)
    options = training_options(model, trainer, seed, cache_dir)
    record = artifacts.make(folder, lambda _: _train_and_register(options, rows_folder, store, params, key))
    _say(record)
    console.result(f"{tracking.MODEL_NAME} version {record.model_version}", time.monotonic() - began_s)
    return record


def _train_and_register(
    options: TrainingOptions, rows_folder: Path, store: tracking.Tracking, params: Mapping[str, Any], key: str
) -> TrainedModelRecord:
    data = read_dataset(rows_folder)
    tags = {"stage": "train", "training_key": key, "code_version": code_version()}
    with tracking.run(store, f"train {options.kind}", params, tags) as run_:
        tracking.log_dataset(run_, data, rows_folder)
        trained = _train(options, data, run_)
        tracking.log_training(run_, trained, data)
        console.line("registering")
        registration = tracking.register_model(run_, trained, data)
        return _record(trained, data, registration, run_, key)


def _train(options: TrainingOptions, data: Dataset, run: tracking.Run) -> TrainedModel:
    done = 0
    with console.Progress(options.network.max_epochs, "epochs (at most)") as progress:

        def on_epoch(epoch: int, metrics: EpochMetrics) -> None:
            nonlocal done
            interrupt.check()
            if epoch > done + 1:
                console.line(f"an interrupted training goes on after epoch {epoch - 1}")
            tracking.log_metrics(run, metrics, step=epoch)
            progress.update(epoch - done, f"validation log loss {metrics['validation_loss']:.4f}")
            done = epoch

        trained = train_model(data, options, on_epoch, console.line)
    for split, metrics in trained.metrics.items():
        tracking.log_metrics(run, {f"{split}_{name}": value for name, value in metrics.items()})
    return trained


def training_options(model: Model, trainer: Trainer, seed: int, cache_dir: Path) -> TrainingOptions:
    """The configured model and trainer as the library's options; checkpoints go to the cache."""
    of_network = {"layers", "dropout"}
    return TrainingOptions(
        **model.model_dump(exclude=of_network),
        network=NetworkOptions(seed=seed, **trainer.model_dump(), **model.model_dump(include=of_network)),
        cache_dir=cache_dir,
        checkpoint_dir=cache_dir / "checkpoints",
    )


def preset_options(config: Config, kind: str) -> TrainingOptions:
    """The options of a kind's own preset, on the configured embedding; a comparison leaves no checkpoints."""
    preset = OmegaConf.to_container(OmegaConf.load(CONF_DIR / "model" / f"{kind}.yaml"))
    model = TypeAdapter[Model](Model).validate_python(preset)
    given = config.model.model_dump(include=type(model).model_fields.keys() - {"kind", "layers"})
    return replace(
        training_options(model.model_copy(update=given), config.trainer, config.seed, config.cache_dir),
        checkpoint_dir=None,
    )


def _registered(store: tracking.Tracking, version: str) -> bool:
    try:
        tracking.load_registered(store, f"models:/{tracking.MODEL_NAME}/{version}")
    except ChampionError:
        return False
    return True


def _record(
    trained: TrainedModel, data: Dataset, registration: tracking.Registration, run: tracking.Run, key: str
) -> TrainedModelRecord:
    """The record of a model that has just been registered, beside the frequency table on the same homes."""
    options, metrics = trained.options, trained.metrics["test"]
    table, _ = fit(data.triples("train"), data.triples("validation"), replace(options, kind="frequency"))
    frequency = score(table, data.triples("test"))
    return TrainedModelRecord(
        name=tracking.MODEL_NAME,
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


def find_record(datasets_dir: Path, tracking_uri: str, model_version: str) -> TrainedModelRecord | None:
    """The record of a registered version, written when it was trained; None where that was not here."""
    for path in (datasets_dir / "models").glob(f"*/{artifacts.MANIFEST}"):
        record = artifacts.find_manifest(path.parent, TrainedModelRecord)
        if record is not None and (record.model_version, record.tracking_uri) == (model_version, tracking_uri):
            return record
    return None


STAGE = Stage(run)

if __name__ == "__main__":
    main("pipeline.train")
