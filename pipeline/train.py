"""Trains the model of where objects lie, from names alone, and registers it in MLflow.

Registered as ``container-object-likelihood``; the first takes the alias ``champion``, a later one only by beating the
present champion. Trained anew only when dataset, model, options or code changed.
"""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mrtask.likelihood.dataset import Dataset, read_dataset, read_manifest
from mrtask.likelihood.frequency import FrequencyModel
from mrtask.likelihood.network import EpochMetrics, NetworkOptions
from mrtask.likelihood.training import TrainedModel, TrainingOptions, score, train_model
from pipeline import dataset
from pipeline.app.main import main
from pipeline.backends import tracking
from pipeline.backends.pool import Pool
from pipeline.backends.tracking import ChampionError
from pipeline.base import console, interrupt
from pipeline.base.config import Config, content_hash
from pipeline.store import artifacts
from pipeline.store.version import code_version, source_hash

SHOWN_METRICS = ("log_loss", "roc_auc")


def run(config: Config, pool: Pool) -> dict[str, Any]:
    """The stage: returns the manifest of the trained model."""
    return train(config, dataset.run(config, pool))


def train(config: Config, rows_folder: Path) -> dict[str, Any]:
    """Trains on a dataset and registers the model, unless that very model is in the registry."""
    began_s = time.monotonic()
    options = training_options(config)
    key = content_hash(
        [
            read_manifest(rows_folder).content_hash,
            config.model.model_dump(mode="json"),
            config.trainer.model_dump(mode="json"),
            config.seed,
            source_hash("mrtask/likelihood"),
            config.tracking.model_dump(),
        ]
    )
    folder = config.datasets_dir / "models" / f"{config.model.kind}-{key}"
    console.headline("train", f"{config.model.kind} on {config.model.embedding}")
    store = tracking.open_tracking(config.tracking.uri, config.tracking.experiment_name)
    if artifacts.ready(folder) and _registered(store, artifacts.read_manifest(folder)["version"]):
        manifest = artifacts.read_manifest(folder)
        console.skipped(f"{tracking.MODEL_NAME} version {manifest['version']}")
        return manifest
    data = read_dataset(rows_folder)
    params = {
        "model": config.model.model_dump(mode="json"),
        "trainer": config.trainer.model_dump(mode="json"),
        "seed": config.seed,
    }
    tags = {"stage": "train", "training_key": key, "code_version": code_version()}
    with tracking.run(store, f"train {config.model.kind}", params, tags) as run_:
        tracking.log_dataset(run_, data, rows_folder)
        trained = _train(config, options, data, run_)
        frequency = score(FrequencyModel(data.triples("train"), options.smoothing), data.triples("test"))
        tracking.log_training(run_, trained, data)
        console.line("registering")
        registration = tracking.register_model(run_, trained, data)
        manifest = _manifest(config, data, trained, frequency, registration) | {"run_id": run_.run_id, "key": key}
    artifacts.make(folder, lambda temporary: manifest)
    test = ", ".join(f"{name} {manifest['metrics'][name]:.4f}" for name in SHOWN_METRICS)
    table = ", ".join(f"{name} {frequency[name]:.4f}" for name in SHOWN_METRICS)
    console.line(f"test homes: {test}; the frequency table: {table}")
    console.line(f"version {registration.version}: {registration.reason}")
    console.result(f"{tracking.MODEL_NAME} version {registration.version}", time.monotonic() - began_s)
    return manifest


def _train(config: Config, options: TrainingOptions, data: Dataset, run: tracking.Run) -> TrainedModel:
    done = 0
    with console.Progress(config.trainer.max_epochs, "epochs (at most)") as progress:

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


def training_options(config: Config) -> TrainingOptions:
    """The configured model and trainer as the library's options."""
    model, trainer = config.model, config.trainer
    return TrainingOptions(
        kind=model.kind,
        embedding=model.embedding,
        network=NetworkOptions(layers=model.layers, dropout=model.dropout, seed=config.seed, **trainer.model_dump()),
        regularisation=model.regularisation,
        smoothing=model.smoothing,
        cache_dir=config.cache_dir,
        checkpoint_dir=config.cache_dir / "checkpoints",
    )


def _registered(store: tracking.Tracking, version: str) -> bool:
    try:
        tracking.load_registered(store, f"models:/{tracking.MODEL_NAME}/{version}")
    except ChampionError:
        return False
    return True


def _manifest(
    config: Config,
    data: Dataset,
    trained: TrainedModel,
    frequency: Mapping[str, float],
    registration: tracking.Registration,
) -> dict[str, Any]:
    """What the report says about the model."""
    metrics = trained.metrics["test"]
    return {
        "name": tracking.MODEL_NAME,
        "version": registration.version,
        "kind": config.model.kind,
        "embedding": config.model.embedding,
        "champion": registration.promoted,
        "training_homes": len(data.manifest.split["train"]),
        "test_homes": len(data.manifest.split["test"]),
        "metrics": metrics,
        "frequency_metrics": dict(frequency),
        "beats_frequency": metrics["log_loss"] < frequency["log_loss"],
        "note": registration.reason,
        "dataset": data.manifest.content_hash,
        "tracking_uri": config.tracking.uri,
    }


def model_facts(config: Config, version: str) -> dict[str, Any]:
    """What was written about a registered version when it was trained here; else no more than its name."""
    for path in (config.datasets_dir / "models").glob(f"*/{artifacts.MANIFEST}"):
        manifest = artifacts.read_manifest(path.parent)
        if manifest["version"] == version and manifest["tracking_uri"] == config.tracking.uri:
            return manifest
    return {"name": tracking.MODEL_NAME, "version": version}


if __name__ == "__main__":
    main("pipeline.train")
