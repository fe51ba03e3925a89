"""The whole experiment: homes, dataset, training, evaluation, report. What is there already is not made again.

experiment=paper (default) is the paper's; experiment=smoke the same in small.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.reproduce")

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

from pipeline import evaluate, report, train
from pipeline.app.stage import Session, Stage
from pipeline.backends import registry
from pipeline.base import console
from pipeline.base.config import Config
from pipeline.base.specs import TrainingSpec
from pipeline.episodes import outcome
from pipeline.episodes.kernels import compiled_meanwhile
from pipeline.episodes.plan import check_task_in, load_model, plan_evaluation
from pipeline.inputs import homes, rows, training
from pipeline.store.folder import Folder
from pipeline.store.layout import REPORT_INDEX, STAGES
from pipeline.store.records import StageTimes

Result = TypeVar("Result")


@dataclass(frozen=True)
class ReproduceJob:
    """Trainings, and an evaluation with the best model that they made."""

    train: train.TrainJob
    rivals: tuple[TrainingSpec, ...]
    """What is trained beside."""
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
        trainings = (self.train.training, *self.rivals)
        with compiled_meanwhile(spec.planners):
            home_set = timed("homes", lambda: homes.make(spec.homes, pool))
            check_task_in(spec, home_set)
            labelled = timed("dataset", lambda: rows.build(home_set, spec.homes.datasets_dir, pool))
            trained = timed("train", lambda: [training.train(labelled, one) for one in trainings])
        asked_for = spec.options.model_uri != registry.CHAMPION_URI
        model = load_model(spec, None if asked_for else training.choose(trained).model_version)
        plan = plan_evaluation(spec, home_set, model)
        plan = replace(plan, rivals=tuple(one for one in trained if one.model_version != plan.identity.model_version))
        timed("evaluate", lambda: evaluate.evaluate(plan, session))
        folder = Folder(spec.output_dir)
        if StageTimes.find(folder, STAGES) is None:
            StageTimes(seconds=seconds).write(folder, STAGES)
        reported = report.ReportJob(folder, spec.tracking, spec.pdf)
        episodes = reported.write(session)
        outcome.say(episodes)
        page, total = reported.target / REPORT_INDEX, console.duration(time.monotonic() - started_s)
        console.headline("done", f"{spec.experiment} in {total}; open {page}, or `make dashboard` for all runs")
        outcome.check(episodes, plan.planners)

    def outline(self, session: Session) -> Iterator[str]:
        """Say what each stage would do; once homes and model exist, also how long the evaluation would take."""
        yield from self.train.outline(session)
        for one in self.rivals:
            yield f"would train {one.what} beside it, and plan with the better one by log loss on the test homes"
        yield from self.evaluate.outline(session)
        yield "would write the report"


def job(config: Config) -> ReproduceJob:
    """Return the configured experiment."""
    wanted = config.training_spec
    rivals = tuple(training.rival(wanted, kind) for kind in config.rivals if kind != wanted.model.kind)
    training_job = train.TrainJob(config.homes_spec, wanted)
    return ReproduceJob(training_job, rivals, evaluate.EvaluateJob(config.evaluation_spec()))


def check(config: Config) -> None:
    """Refuse what training or evaluation would refuse."""
    train.check(config)
    wanted = config.training_spec
    for kind in config.rivals:
        training.check(training.rival(wanted, kind))
    evaluate.check(config)


STAGE = Stage(job, check, compare=report.STAGE)
