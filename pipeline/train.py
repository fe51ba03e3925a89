"""Trains the model of where objects lie, from names alone, and registers it in MLflow.

It is registered as ``container-object-likelihood``. The first model takes the alias ``champion``, a later one only by
beating the present champion. A model is trained again only when dataset, model, options or code have changed.
"""

from collections.abc import Iterator

from pipeline import dataset
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.base.config import Config
from pipeline.inputs import training
from pipeline.store.records import TrainedModelRecord


def run(config: Config, session: Session) -> TrainedModelRecord:
    """Return the record of the trained model."""
    wanted = training.training(config)
    wanted.check()
    return training.train(dataset.run(config, session), wanted)


def outline(config: Config, session: Session) -> Iterator[str]:
    """Say which model would be trained on which homes."""
    wanted = training.training(config)
    wanted.check()
    yield from dataset.outline(config, session)
    yield f"would train {wanted.what} on the rows of the training homes, and register it, unless that is done"


STAGE = Stage(run, outline, locks="never")

if __name__ == "__main__":
    main("pipeline.train")
