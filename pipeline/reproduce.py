"""The whole experiment: homes, dataset, training, evaluation, report. What is there already is not made again.

experiment=paper (default) is the paper's; experiment=smoke the same in small.
"""

import time
from collections.abc import Callable
from typing import TypeVar

from pipeline import dataset, evaluate, homes, report, train
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.backends import tracking
from pipeline.base import console
from pipeline.base.config import Config
from pipeline.episodes.kernels import compiled_meanwhile
from pipeline.episodes.plan import check
from pipeline.store.folder import Folder, locked
from pipeline.store.layout import REPORT_INDEX, STAGES
from pipeline.store.records import StageTimes

Result = TypeVar("Result")


def run(config: Config, session: Session) -> None:
    """All stages, one after the other."""
    seconds: dict[str, float] = {}
    started_s = time.monotonic()

    def timed(stage: str, work: Callable[[], Result]) -> Result:
        began_s = time.monotonic()
        result = work()
        seconds[stage] = round(time.monotonic() - began_s, 1)
        return result

    check(config.evaluation)
    train.check(config.model, config.trainer)
    folder = Folder(config.output_dir)
    with locked(folder, config.cache_dir):
        with compiled_meanwhile(config.compared):
            home_set = timed("homes", lambda: homes.run(config, session))
            rows = timed("dataset", lambda: dataset.build(home_set, config.datasets_dir, session.pool))
            timed("train", lambda: train.train_on(rows, config))
        store = tracking.open_tracking(config.tracking.uri, config.tracking.experiment_name)
        model = evaluate.load_model(config, store)
        timed("evaluate", lambda: evaluate.evaluate(config, session, home_set, store, model))
        if config.dry_run:
            return
        if StageTimes.find(folder, STAGES) is None:
            StageTimes(seconds=seconds).write(folder, STAGES)
        target = report.report(folder, config.tracking)
    total = console.duration(time.monotonic() - started_s)
    console.headline(
        "done", f"{config.experiment} in {total}; open {target / REPORT_INDEX}, or `make dashboard` for all runs"
    )


STAGE = Stage(run, compare_cells=report.compare_cells)

if __name__ == "__main__":
    main("pipeline.reproduce")
