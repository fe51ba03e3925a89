"""Trains the model of where objects lie, from names alone, and registers it in MLflow.

It is registered as ``container-object-likelihood``. The first model takes the alias ``champion``, a later one only by
beating the present champion. A model is trained again only when dataset, model, options or code have changed.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.base.config import Config
from pipeline.base.specs import TrainingSpec
from pipeline.dataset import DatasetJob
from pipeline.inputs import homes, rows, training
from pipeline.store.records import TrainedModelRecord


@dataclass(frozen=True)
class TrainJob:
    """Which model, and the rows to train it on."""

    dataset: DatasetJob
    training: TrainingSpec

    def run(self, session: Session) -> TrainedModelRecord:
        """Return the record of the trained model."""
        training.check(self.training)
        return training.train(self.dataset.run(session), self.training)

    def found(self) -> TrainedModelRecord:
        """Return the record of the model that was trained before; raises `NotMade` where there is none."""
        spec = self.dataset.homes
        return training.find(rows.find(homes.make(spec, None), spec.datasets_dir), self.training)

    def outline(self, session: Session) -> Iterator[str]:
        """Say which model would be trained on which homes."""
        training.check(self.training)
        yield from self.dataset.outline(session)
        what = self.training.what
        yield f"would train {what} on the rows of the training homes, and register it, unless that is done"


def job(config: Config) -> TrainJob:
    """Return the configured training."""
    return TrainJob(DatasetJob(config.homes_spec), config.training_spec)


STAGE = Stage(job, locks="never")

if __name__ == "__main__":
    main("pipeline.train")
