"""Measures likelihood models on where people put objects that the models never saw (Housekeep's benchmark).

Each is trained on the votes on the training objects, on the training homes of the homes group, or on both, and asked
about the test objects. Leaves ``<output_dir>/housekeep.csv``. ``map`` is Housekeep's measure (mean average precision
over pairs of object and room), ``map_val`` that on the validation objects, by which choices are to be made.
"""

import time
from collections.abc import Mapping

import pandas as pd

from mrtask.homes.votes import Votes
from mrtask.likelihood.dataset import read_dataset
from mrtask.likelihood.housekeep import PUBLISHED, mean_average_precision, predict_votes, vote_triples
from mrtask.likelihood.training import fit, score
from pipeline import dataset
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.base import console, interrupt
from pipeline.base.config import Config, UserError
from pipeline.store.folder import Folder
from pipeline.store.layout import HOUSEKEEP
from pipeline.store.voted_contents import votes_by_split
from pipeline.train import preset_options

METRICS = ("log_loss", "best_log_loss", "roc_auc", "ece")
ROUNDED = "{:.4f}".format

Triples = tuple[pd.DataFrame, pd.DataFrame]
"""To train on, and to stop the training by."""


def run(config: Config, session: Session) -> pd.DataFrame:
    """The stage: the table that it writes."""
    if config.homes.contents != "procthor":
        raise UserError(
            f"homes.contents={config.homes.contents}: models may not see the test objects in homes; use procthor"
        )
    votes = votes_by_split(config.contents, config.datasets_dir)
    data = {"human": (vote_triples(votes["train"]), vote_triples(votes["val"]))}
    if set(config.housekeep.trained_on) - {"human"}:
        homes = read_dataset(dataset.run(config, session))
        data["homes"] = (homes.triples("train"), homes.triples("validation"))
        first, second = data["human"], data["homes"]
        data["both"] = (pd.concat([first[0], second[0]]), pd.concat([first[1], second[1]]))
    return measure(config, votes, data)


def measure(config: Config, votes: Mapping[str, Votes], data: Mapping[str, Triples]) -> pd.DataFrame:
    """The table of all configured models, trained on each of the configured data."""
    began_s, rows = time.monotonic(), []
    console.headline("housekeep", f"{len(votes['test'].objects)} objects that no model has seen")
    test = vote_triples(votes["test"])
    for name in config.housekeep.trained_on:
        for kind in config.housekeep.models:
            options = preset_options(config, kind)
            model, _ = fit(*data[name], options, lambda epoch, metrics: interrupt.check())
            metrics = score(model, test)
            precision, pairs = mean_average_precision(predict_votes(model, votes["test"]), votes["test"])
            on_validation, _ = mean_average_precision(predict_votes(model, votes["val"]), votes["val"])
            rows.append((kind, name, precision, on_validation, pairs, *(metrics[metric] for metric in METRICS)))
            console.line(f"{kind} trained on {name}: {precision:.4f}")
    table = pd.DataFrame(rows, columns=["model", "trained_on", "map", "map_val", "pairs", *METRICS])
    target = Folder(config.output_dir)
    target.write(HOUSEKEEP, table.to_csv(index=False).encode())
    for line in table.to_string(index=False, float_format=ROUNDED).splitlines():
        console.line(line)
    console.line("published: " + ", ".join(f"{name} {value:.3f}" for name, value in PUBLISHED.items()))
    console.result(target / HOUSEKEEP, time.monotonic() - began_s)
    return table


STAGE = Stage(run)

if __name__ == "__main__":
    main("pipeline.housekeep")
