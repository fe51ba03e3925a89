"""What a wrong prior costs in a mission, and what a belief that learns in the home wins back.

Homes with the contents of ProcTHOR and of people; priors learned from training homes with either, none, and the true
frequencies of the homes evaluated on; each prior that a robot can have also adapting, where several tasks follow each
other in a home (evaluation.tasks_per_home). All priors run the same trials: one evaluation each, in
<output_dir>/runs/..., which goes on where it stopped. One page in <output_dir>/report.
"""

import io
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import pandas as pd

from mrtask.analysis.calibration import Task, searched_in
from mrtask.analysis.findings import main_planner
from mrtask.analysis.prior_page import render_priors
from mrtask.analysis.prior_study import ORACLE, ArmRows
from mrtask.analysis.statistics import BASELINES, INFORMED_BASELINE
from mrtask.execution.trace import Trace
from mrtask.planning.planners import Role, planners_with_role
from pipeline import evaluate, homes, train
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.backends import tracking
from pipeline.base import console
from pipeline.base.config import Config, UserError, content_hash, with_overrides
from pipeline.episodes.plan import plan_evaluation
from pipeline.episodes.worker import Context, HomeTasks, beliefs_in_home
from pipeline.store import layout
from pipeline.store.episode_row import TRACE
from pipeline.store.folder import Folder, locked
from pipeline.store.layout import BELIEFS, EPISODES, REPORT, REPORT_INDEX
from pipeline.store.rows import read_episodes, read_traces

BLIND = {*BASELINES, *planners_with_role(Role.BOUND)} - {INFORMED_BASELINE}
"""Planners that look at no likelihood: they run once for all priors."""

OF_EPISODES = {"seed", "map", "homes", "contents", "belief", "planner", "planner_variants", "evaluation"}
"""The parts of the configuration by which a run's folder is named."""


@dataclass(frozen=True)
class Arm:
    """One evaluation: a prior on homes with some contents."""

    contents: str
    prior: str
    adapts: bool
    config: Config
    overrides: tuple[str, ...] = field(default=())

    def configured(self, planners: Sequence[str]) -> Config:
        """The evaluation's configuration, with a folder of its own."""
        evaluation = self.config.evaluation.model_copy(update={"planners": tuple(planners)})
        config = self.config.model_copy(update={"evaluation": evaluation})
        key = content_hash(config.model_dump(mode="json", include=OF_EPISODES))
        name = "-".join([self.contents, self.prior, *(["adapting"] if self.adapts else [])])
        return config.model_copy(update={"output_dir": layout.runs(Folder(self.config.output_dir), name, key).location})


def run(config: Config, session: Session) -> None:
    """The stage."""
    began_s = time.monotonic()
    if config.evaluation.unsearched_share != (1.0, 1.0):
        raise UserError("evaluation.unsearched_share: priors are compared where nothing is known from the start")
    trained = {name: with_overrides(config, [f"homes.contents={name}"]) for name in _contents(config)}
    versions = {name: train.run(one, session).model_version for name, one in trained.items()}
    arms = arms_of(config, versions)
    console.headline("priors", f"{len(arms)} priors and contents, an evaluation each")
    configs = [arm.configured(planners) for arm, planners in zip(arms, _planners(arms), strict=True)]
    for one in configs:
        evaluate.run(one, session)
    if config.dry_run:
        return
    folder = Folder(config.output_dir)
    with locked(folder, config.cache_dir):
        rows = list(_with_blind_planners([_read(arm, its, session) for arm, its in zip(arms, configs, strict=True)]))
        page = render_priors(rows, config.evaluation.tasks_per_home, config.experiment)
        (folder / REPORT).write(REPORT_INDEX, page.encode())
    console.result(folder / REPORT / REPORT_INDEX, time.monotonic() - began_s)


def arms_of(config: Config, versions: Mapping[str, str]) -> list[Arm]:
    """All arms, those of one contents together; ``versions``: contents -> the model trained on homes with them."""
    found = []
    for contents in config.priors.contents:
        of_contents = f"homes.contents={contents}"
        learned = {name: _model(versions[name]) for name in config.priors.trained_on}
        others = {name: f"{_model(versions[contents])} belief.prior={name}" for name in config.priors.others}
        for prior, overrides in {**others, **learned}.items():
            adapting = (False, True) if prior != ORACLE and config.evaluation.tasks_per_home > 1 else (False,)
            for adapts in adapting:
                given = (of_contents, *overrides.split(), f"belief.adapt={str(adapts).lower()}")
                found.append(Arm(contents, prior, adapts, with_overrides(config, given), given))
    return found


def _contents(config: Config) -> list[str]:
    """The contents of all homes that models are trained on; others have a model too, though nobody asks it."""
    return list(dict.fromkeys([*config.priors.trained_on, *config.priors.contents]))


def _model(version: str) -> str:
    return f"evaluation.model_uri=models:/{tracking.MODEL_NAME}/{version}"


def _planners(arms: Sequence[Arm]) -> Iterator[tuple[str, ...]]:
    """The planners of each arm: those that look at no likelihood run in the first of each contents only."""
    seen = set()
    for arm in arms:
        planners = arm.config.evaluation.planners
        later = tuple(name for name in planners if arm.config.planner_behind(name) not in BLIND)
        yield later if arm.contents in seen and later else planners
        seen.add(arm.contents)


def _with_blind_planners(arms: Sequence[ArmRows]) -> Iterator[ArmRows]:
    """The arms, each with the rows of the planners that ran in the first of its contents only."""
    first: dict[str, pd.DataFrame] = {}
    for arm in arms:
        whole = first.setdefault(arm.contents, arm.episodes)
        missing = whole[~whole["planner"].isin(arm.episodes["planner"])]
        yield ArmRows(
            arm.contents, arm.prior, arm.adapts, pd.concat([arm.episodes, missing]), arm.beliefs, arm.overrides
        )


def _read(arm: Arm, config: Config, session: Session) -> ArmRows:
    folder = Folder(config.output_dir)
    rows = read_episodes(folder / EPISODES)
    beliefs = folder.read(BELIEFS)
    if beliefs is None:
        console.headline("belief", f"{arm.contents}, {arm.prior}")
        store = tracking.open_tracking(config.tracking.uri, config.tracking.experiment_name)
        plan = plan_evaluation(config, homes.run(config, session), evaluate.load_model(config, store))
        buffer = io.BytesIO()
        _beliefs(rows, folder, plan.context, session).to_parquet(buffer, index=False)
        beliefs = buffer.getvalue()
        folder.write(BELIEFS, beliefs)
    return ArmRows(arm.contents, arm.prior, arm.adapts, rows, pd.read_parquet(io.BytesIO(beliefs)), arm.overrides)


def _beliefs(rows: pd.DataFrame, folder: Folder, context: Context, session: Session) -> pd.DataFrame:
    """What the main planner's team believed at the beginning of each of its tasks."""
    planner = main_planner(rows["planner"].unique())
    own = rows[(rows["planner"] == planner) & rows["home_id"].notna()]
    traces = read_traces(folder / EPISODES, set(own["trial_id"]), [str(planner)]).set_index("trial_id")[TRACE]
    number = own["trial_id"].str.rpartition("-")[2].astype(int)
    own = own.assign(number=number, chain=number // context.trials.tasks_per_home).sort_values("number")
    chains = [
        HomeTasks(
            str(of_home["home_id"].iloc[0]),
            tuple(
                Task(trial, tuple(objects), searched_in(Trace.from_json(traces[trial])))
                for trial, objects in zip(of_home["trial_id"], of_home["objects"], strict=True)
            ),
        )
        for _, of_home in own.groupby(["size_class", "robots", "chain"])
    ]
    parts = []
    with console.Progress(len(chains), "homes") as progress:
        for outcome in session.pool.run(beliefs_in_home, chains, context):
            if outcome is None:
                continue
            if outcome.value is None:
                raise RuntimeError(f"beliefs in home {outcome.item.home_id} could not be computed: {outcome.failure}")
            parts.append(outcome.value)
            progress.update()
    return pd.concat(parts).sort_values(["trial_id", "pair"], ignore_index=True)


STAGE = Stage(run)

if __name__ == "__main__":
    main("pipeline.priors")
