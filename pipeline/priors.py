"""What a wrong prior costs in a mission, and what a belief that learns in the home wins back.

Homes with the contents of ProcTHOR and of people; priors learned from training homes with either, one that knows
nothing of where, and the true one; each prior that a robot can have also adapting, where several tasks follow each
other in a home (evaluation.tasks_per_home). All priors run the same trials. One page in <output_dir>/report; how arms
share evaluations stands in `pipeline.arms`.
"""

import io
import time
from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from mrtask.analysis.results.roles import main_planner
from mrtask.analysis.studies.calibration import Task, searched_in
from mrtask.analysis.studies.prior_page import render_priors
from mrtask.analysis.studies.prior_study import TRUTH, ArmRows
from mrtask.execution.trace import Trace
from pipeline import evaluate, homes, train
from pipeline.app.main import main
from pipeline.app.stage import Session, Stage
from pipeline.arms import SharedRun, run_arms, slug
from pipeline.backends import tracking
from pipeline.base import console
from pipeline.base.config import Config, UserError, with_overrides
from pipeline.episodes.plan import plan_evaluation
from pipeline.episodes.studies import HomeTasks, beliefs_in_home
from pipeline.episodes.worker import Context
from pipeline.store.episode_row import TRACE
from pipeline.store.folder import Folder, locked
from pipeline.store.layout import BELIEFS, REPORT, REPORT_INDEX
from pipeline.store.rows import read_episodes, read_traces

WHAT = "priors"
UNTRAINED = {"uniform": "likelihood.uniform_mix=1.0", TRUTH: "likelihood.source=truth"}


@dataclass(frozen=True)
class PriorArm:
    """A prior on homes with some contents, and what it changes in the configuration."""

    contents: str
    prior: str
    adapts: bool
    overrides: tuple[str, ...]

    @property
    def name(self) -> str:
        """Of the arm."""
        return " ".join([self.contents, self.prior, *(["adapting"] if self.adapts else [])])


def run(config: Config, session: Session) -> None:
    """The stage."""
    began_s = time.monotonic()
    if config.evaluation.unsearched_share != (1.0, 1.0):
        raise UserError("evaluation.unsearched_share: priors are compared where nothing is known from the start")
    # Of the contents that no prior is learned from, for the priors that nothing is learned for: they need some model.
    trained_on = dict.fromkeys([*config.priors.trained_on, *(config.priors.contents if config.priors.others else ())])
    versions: dict[str, str] = {
        name: train.run(with_overrides(config, [f"homes.contents={name}"]), session).model_version
        for name in trained_on
    }
    arms = arms_of(config, versions)
    planners = config.evaluation.planners
    shared = run_arms(config, [(arm.name, arm.overrides) for arm in arms], planners, session, WHAT)
    if config.dry_run:
        return
    folder = Folder(config.output_dir)
    with locked(folder, config.cache_dir):
        rows: dict[str, tuple[pd.DataFrame, pd.DataFrame]] = {}
        for one in shared:
            rows |= _read(one, session)
        compared = [ArmRows(arm.contents, arm.prior, arm.adapts, *rows[arm.name], arm.overrides) for arm in arms]
        page = render_priors(compared, config.evaluation.tasks_per_home, config.experiment)
        (folder / REPORT).write(REPORT_INDEX, page.encode())
    console.result(folder / REPORT / REPORT_INDEX, time.monotonic() - began_s)


def arms_of(config: Config, versions: Mapping[str, str]) -> list[PriorArm]:
    """All arms, those of one contents together; ``versions``: contents -> the model trained on homes with them."""
    models = {name: f"evaluation.model_uri=models:/{tracking.MODEL_NAME}/{one}" for name, one in versions.items()}
    found = []
    for contents in config.priors.contents:
        priors: dict[str, tuple[str, ...]] = {
            name: (models[contents], UNTRAINED[name]) for name in config.priors.others
        }
        priors |= {name: (models[name],) for name in config.priors.trained_on}
        for prior, overrides in priors.items():
            learns = prior != TRUTH and config.evaluation.tasks_per_home > 1
            for adapts in (False, True) if learns else (False,):
                given = (f"homes.contents={contents}", *overrides, f"belief.adapt={str(adapts).lower()}")
                found.append(PriorArm(contents, prior, adapts, given))
    return found


def _read(shared: SharedRun, session: Session) -> dict[str, tuple[pd.DataFrame, pd.DataFrame]]:
    """The episodes of each arm of an evaluation, and what the main planner's team believed."""
    config, found = shared.configured(), {}
    names = dict(shared.arms)
    context: Context | None = None
    for arm, rows in shared.by_arm(read_episodes(shared.episodes)):
        folder, file = Folder(config.output_dir) / BELIEFS, f"{slug(arm)}.parquet"
        content = folder.read(file)
        beliefs = None if content is None else pd.read_parquet(io.BytesIO(content))
        planner = str(main_planner(sorted(set(rows["planner"]))))
        own = rows[(rows["planner"] == planner) & rows["home_id"].notna()]
        if beliefs is None or set(beliefs["trial_id"]) != set(own["trial_id"]):
            if context is None:
                store = tracking.open_tracking(config.tracking.uri, config.tracking.experiment_name)
                model = evaluate.load_model(config, store)
                context = plan_evaluation(config, homes.run(config, session), model).context
            console.headline("beliefs", arm)
            beliefs = _beliefs(own, names[arm][planner], shared.episodes, context, session)
            buffer = io.BytesIO()
            beliefs.to_parquet(buffer, index=False)
            folder.write(file, buffer.getvalue())
        found[arm] = (rows, beliefs)
    return found


def _beliefs(own: pd.DataFrame, planner: str, episodes: Folder, context: Context, session: Session) -> pd.DataFrame:
    """What a planner's team believed at the beginning of each of its tasks; ``own``: its rows."""
    traces = read_traces(episodes, set(own["trial_id"]), [planner]).set_index("trial_id")[TRACE]
    number = own["trial_id"].str.rpartition("-")[2].astype(int)
    own = own.assign(number=number, chain=number // context.trials.tasks_per_home).sort_values("number")
    chains = [
        HomeTasks(
            planner,
            str(of_home["home_id"].iloc[0]),
            tuple(
                Task(
                    row["trial_id"],
                    tuple(row["objects"]),
                    searched_in(Trace.from_json(traces[row["trial_id"]])),
                    int(row["seed"]),
                )
                for row in of_home.to_dict("records")
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
