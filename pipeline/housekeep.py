"""Measures likelihood models on where people put objects that the models never saw (Housekeep's benchmark).

Each is trained on the votes on the training objects, on the training homes of the homes group, or on both, and asked
about the test objects. Leaves ``<output_dir>/housekeep.csv``. ``map`` is Housekeep's measure (mean average precision
over pairs of object and room), ``map_val`` that on the validation objects, by which choices are made.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.housekeep")

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from mrtask.homes.votes import Votes
from mrtask.likelihood.dataset import read_dataset
from mrtask.likelihood.housekeep import PUBLISHED, mean_average_precision, predict_votes, vote_triples
from mrtask.likelihood.options import TrainingOptions
from mrtask.likelihood.training import fit, score
from pipeline.app.stage import Session, Stage
from pipeline.base import console, interrupt
from pipeline.base.config import Config, UserError
from pipeline.base.studies import TrainedOn
from pipeline.dataset import DatasetJob
from pipeline.inputs.training import preset
from pipeline.store.folder import Folder
from pipeline.store.layout import HOUSEKEEP
from pipeline.store.voted_contents import votes_by_split

METRICS = ("log_loss", "best_log_loss", "roc_auc", "ece")
ROUNDED = "{:.4f}".format

Triples = tuple[pd.DataFrame, pd.DataFrame]
"""For training, and for early stopping."""


@dataclass(frozen=True)
class HousekeepJob:
    """The options of each kind of model, what they are trained on, and where the homes, votes and table are."""

    dataset: DatasetJob
    presets: Mapping[str, TrainingOptions]
    trained_on: Sequence[TrainedOn]
    target: Folder

    def run(self, session: Session) -> None:
        """Train the models and write the table."""
        began_s = time.monotonic()
        votes = votes_by_split(self.dataset.homes.contents, self.dataset.homes.datasets_dir)
        data = {"human": (vote_triples(votes["train"]), vote_triples(votes["val"]))}
        if set(self.trained_on) - {"human"}:
            homes = read_dataset(self.dataset.run(session))
            data["homes"] = (homes.triples("train"), homes.triples("validation"))
            training, stopping = (pd.concat(parts) for parts in zip(data["human"], data["homes"], strict=True))
            data["both"] = (training, stopping)
        console.headline("housekeep", f"{len(votes['test'].objects)} objects that no model has seen")
        table = measure(self.presets, votes, {name: data[name] for name in self.trained_on})
        self.target.write(HOUSEKEEP, table.to_csv(index=False).encode())
        console.text(table.to_string(index=False, float_format=ROUNDED))
        console.line("published: " + ", ".join(f"{name} {value:.3f}" for name, value in PUBLISHED.items()))
        console.result(self.target / HOUSEKEEP, time.monotonic() - began_s)

    def outline(self, session: Session) -> Iterator[str]:
        """Say which models would be trained on what."""
        yield f"would train {', '.join(self.presets)} on {', '.join(self.trained_on)} and write {HOUSEKEEP}"


def job(config: Config) -> HousekeepJob:
    """Return the configured measurement; raises `UserError` where models would see the test objects in homes."""
    if (contents := config.homes.contents) != "procthor":
        raise UserError(f"homes.contents={contents}: models may not see the test objects in homes; use procthor")
    presets: dict[str, TrainingOptions] = {kind: preset(config.training_spec, kind) for kind in config.housekeep.models}
    return HousekeepJob(DatasetJob(config.homes_spec), presets, config.housekeep.trained_on, Folder(config.output_dir))


def measure(
    options: Mapping[str, TrainingOptions], votes: Mapping[str, Votes], data: Mapping[str, Triples]
) -> pd.DataFrame:
    """Return the table of all kinds of models, trained on each of the data."""
    rows, test = [], vote_triples(votes["test"])
    for name, triples in data.items():
        for kind, of_kind in options.items():
            model, _ = fit(*triples, of_kind, lambda epoch, metrics: interrupt.check())
            metrics = score(model, test)
            precision, pairs = mean_average_precision(predict_votes(model, votes["test"]), votes["test"])
            on_validation, _ = mean_average_precision(predict_votes(model, votes["val"]), votes["val"])
            rows.append((kind, name, precision, on_validation, pairs, *(metrics[metric] for metric in METRICS)))
            console.line(f"{kind} trained on {name}: {precision:.4f}")
    return pd.DataFrame(rows, columns=["model", "trained_on", "map", "map_val", "pairs", *METRICS])


STAGE = Stage(job)
