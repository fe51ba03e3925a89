"""The whole experiment: homes, dataset, training, evaluation, report. What is there already is not made again.

experiment=paper (default) is the paper's; experiment=smoke the same in small.
"""

import time
from collections.abc import Callable, Iterator
from typing import TypeVar

from pipeline import evaluate, report, train
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.base import console
from pipeline.base.config import Config
from pipeline.episodes.kernels import compiled_meanwhile
from pipeline.episodes.plan import check, plan_evaluation
from pipeline.episodes.prepare import load_model
from pipeline.inputs import homes, rows, training
from pipeline.store.folder import Folder
from pipeline.store.layout import REPORT_INDEX, STAGES
from pipeline.store.records import StageTimes

Result = TypeVar("Result")


def run(config: Config, session: Session) -> None:
    """Run all stages, one after the other."""
    seconds: dict[str, float] = {}
    started_s = time.monotonic()

    def timed(stage: str, work: Callable[[], Result]) -> Result:
        began_s = time.monotonic()
        result = work()
        seconds[stage] = round(time.monotonic() - began_s, 1)
        return result

    check(config.evaluation)
    wanted = training.training(config)
    wanted.check()
    with compiled_meanwhile(config.compared):
        home_set = timed("homes", lambda: homes.make(config.homes, config.contents, config.datasets_dir, session.pool))
        labelled = timed("dataset", lambda: rows.build(home_set, config.datasets_dir, session.pool))
        timed("train", lambda: training.train(labelled, wanted))
    plan = plan_evaluation(config, home_set, load_model(config))
    timed("evaluate", lambda: evaluate.evaluate(plan, config, session))
    folder = Folder(config.output_dir)
    if StageTimes.find(folder, STAGES) is None:
        StageTimes(seconds=seconds).write(folder, STAGES)
    target = report.report(folder, config.tracking)
    total = console.duration(time.monotonic() - started_s)
    console.headline(
        "done", f"{config.experiment} in {total}; open {target / REPORT_INDEX}, or `make dashboard` for all runs"
    )


def outline(config: Config, session: Session) -> Iterator[str]:
    """Say what each stage would do; once homes and model exist, also how long the evaluation would take."""
    yield from train.outline(config, session)
    yield from evaluate.outline(config, session)
    yield "would write the report"


STAGE = Stage(run, outline, compare_cells=report.compare_cells)

if __name__ == "__main__":
    main("pipeline.reproduce")
