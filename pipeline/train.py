"""Trains the model of where objects lie, from names alone, and registers it in MLflow.

It is registered as ``container-object-likelihood``. The first model takes the alias ``champion``, a later one only by
beating the present champion. A model is trained again only when dataset, model, options or code have changed.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.train")

from collections.abc import Iterator
from dataclasses import dataclass

from pipeline.app.stage import Session, Stage
from pipeline.backends import runs
from pipeline.base.config import Config
from pipeline.base.specs import HomesSpec, TrainingSpec
from pipeline.dataset import DatasetJob
from pipeline.inputs import homes, rows, training
from pipeline.store.records import TrainedModelRecord


@dataclass(frozen=True)
class TrainJob:
    """Which model, and the homes to train it on."""

    homes: HomesSpec
    training: TrainingSpec

    def run(self, session: Session) -> TrainedModelRecord:
        """Return the record of the trained model."""
        return training.train(DatasetJob(self.homes).run(session), self.training)

    def found(self) -> TrainedModelRecord:
        """Return the record of the model that was trained before; raises `NotMade` where none was trained."""
        return training.find(rows.find(homes.make(self.homes, None), self.homes.datasets_dir), self.training)

    def outline(self, session: Session) -> Iterator[str]:
        """Say which model would be trained on which homes."""
        yield from DatasetJob(self.homes).outline(session)
        what = self.training.what
        yield f"would train {what} on the rows of the training homes, and register it, unless that is done"


def check(config: Config) -> None:
    """Refuse an embedding or a device that is not there, and a store that cannot be used."""
    training.check(config.training_spec)
    runs.check_store(config)


STAGE = Stage(lambda config: TrainJob(config.homes_spec, config.training_spec), check, locks="never")
