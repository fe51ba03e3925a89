"""The whole experiment: homes, dataset, training, evaluation, report. What is there already is not made again.

experiment=paper (default) is the paper's; experiment=smoke the same in small.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from pipeline import evaluate, report, train
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.base import console
from pipeline.base.config import Config
from pipeline.episodes.kernels import compiled_meanwhile
from pipeline.episodes.plan import check, load_model, plan_evaluation
from pipeline.inputs import homes, rows, training
from pipeline.store.folder import Folder
from pipeline.store.layout import REPORT_INDEX, STAGES
from pipeline.store.records import StageTimes

Result = TypeVar("Result")


@dataclass(frozen=True)
class ReproduceJob:
    """The stages' jobs; each one's result goes to the next."""

    train: train.TrainJob
    evaluate: evaluate.EvaluateJob
    report: report.ReportJob

    def run(self, session: Session) -> None:
        """Run all stages, one after the other."""
        seconds: dict[str, float] = {}
        started_s = time.monotonic()

        def timed(stage: str, work: Callable[[], Result]) -> Result:
            began_s = time.monotonic()
            result = work()
            seconds[stage] = round(time.monotonic() - began_s, 1)
            return result

        spec, pool = self.evaluate.spec, session.pool
        check(spec.options)
        training.check(self.train.training)
        with compiled_meanwhile(spec.planners):
            home_set = timed("homes", lambda: homes.make(spec.homes, pool))
            labelled = timed("dataset", lambda: rows.build(home_set, spec.homes.datasets_dir, pool))
            timed("train", lambda: training.train(labelled, self.train.training))
        plan = plan_evaluation(spec, home_set, load_model(spec))
        timed("evaluate", lambda: evaluate.evaluate(plan, session))
        folder = Folder(spec.output_dir)
        if StageTimes.find(folder, STAGES) is None:
            StageTimes(seconds=seconds).write(folder, STAGES)
        self.report.run(session)
        page, total = self.report.target / REPORT_INDEX, console.duration(time.monotonic() - started_s)
        console.headline("done", f"{spec.experiment} in {total}; open {page}, or `make dashboard` for all runs")

    def outline(self, session: Session) -> Iterator[str]:
        """Say what each stage would do; once homes and model exist, also how long the evaluation would take."""
        yield from self.train.outline(session)
        yield from self.evaluate.outline(session)
        yield "would write the report"


def job(config: Config) -> ReproduceJob:
    """Return the jobs of the configured stages."""
    return ReproduceJob(train.job(config), evaluate.job(config), report.job(config))


STAGE = Stage(job, compare=report.STAGE)

if __name__ == "__main__":
    main("pipeline.reproduce")
