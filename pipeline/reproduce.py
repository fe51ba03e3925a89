"""The whole experiment: homes, dataset, training, evaluation, report. What is there already is not made again.

experiment=paper (default) is the paper's; experiment=smoke the same in small.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.reproduce")

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from pipeline import evaluate, report, train
from pipeline.app.stage import Session, Stage
from pipeline.base import console
from pipeline.base.config import Config
from pipeline.episodes import outcome
from pipeline.episodes.kernels import compiled_meanwhile
from pipeline.episodes.plan import load_model, plan_evaluation
from pipeline.inputs import homes, rows, training
from pipeline.store.folder import Folder
from pipeline.store.layout import REPORT_INDEX, STAGES
from pipeline.store.records import StageTimes

Result = TypeVar("Result")


@dataclass(frozen=True)
class ReproduceJob:
    """A training and an evaluation of what it trained."""

    train: train.TrainJob
    evaluate: evaluate.EvaluateJob

    def run(self, session: Session) -> None:
        """Run all stages, one after the other.

        Raises:
            NeverSucceeded: no episode of a planner was accepted.
        """
        seconds: dict[str, float] = {}
        started_s = time.monotonic()

        def timed(stage: str, work: Callable[[], Result]) -> Result:
            began_s = time.monotonic()
            result = work()
            seconds[stage] = round(time.monotonic() - began_s, 1)
            return result

        spec, pool = self.evaluate.spec, session.pool
        with compiled_meanwhile(spec.planners):
            home_set = timed("homes", lambda: homes.make(spec.homes, pool))
            labelled = timed("dataset", lambda: rows.build(home_set, spec.homes.datasets_dir, pool))
            timed("train", lambda: training.train(labelled, self.train.training))
        plan = plan_evaluation(spec, home_set, load_model(spec))
        timed("evaluate", lambda: evaluate.evaluate(plan, session))
        folder = Folder(spec.output_dir)
        if StageTimes.find(folder, STAGES) is None:
            StageTimes(seconds=seconds).write(folder, STAGES)
        reported = report.ReportJob(folder, spec.tracking)
        episodes = reported.write(session)
        outcome.say(episodes)
        page, total = reported.target / REPORT_INDEX, console.duration(time.monotonic() - started_s)
        console.headline("done", f"{spec.experiment} in {total}; open {page}, or `make dashboard` for all runs")
        outcome.check(episodes, plan.planners)

    def outline(self, session: Session) -> Iterator[str]:
        """Say what each stage would do; once homes and model exist, also how long the evaluation would take."""
        yield from self.train.outline(session)
        yield from self.evaluate.outline(session)
        yield "would write the report"


def job(config: Config) -> ReproduceJob:
    """Return the configured experiment."""
    training_job = train.TrainJob(config.homes_spec, config.training_spec)
    return ReproduceJob(training_job, evaluate.EvaluateJob(config.evaluation_spec()))


def check(config: Config) -> None:
    """Refuse what training or evaluation would refuse."""
    train.check(config)
    evaluate.check(config)


STAGE = Stage(job, check, compare=report.STAGE)
