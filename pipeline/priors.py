"""What a wrong prior costs in a mission, and what a belief that learns in the home wins back.

Homes with the contents of ProcTHOR and of people; priors learned from training homes with either, one that knows
nothing of where, and the true one; each prior that a robot can have also adapting, where several tasks follow each
other in a home (evaluation.tasks_per_home). All priors run the same trials. One page in <output_dir>/report; how arms
share evaluations stands in `pipeline.arms`.
"""

from pipeline.app.main import main

if __name__ == "__main__":
    main("pipeline.priors")

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import pandas as pd

from mrtask.analysis.results.roles import main_planner
from mrtask.analysis.studies.calibration import Task, searched_in
from mrtask.analysis.studies.prior_page import render_priors
from mrtask.analysis.studies.prior_study import TRUTH, ArmRows
from mrtask.execution.trace import Trace
from pipeline import evaluate, train
from pipeline.app.stage import Session, Stage
from pipeline.arms import Comparison, SharedRun, lay_out, slug
from pipeline.backends import registry
from pipeline.base import console
from pipeline.base.config import Config, UserError, with_overrides
from pipeline.base.studies import Priors
from pipeline.episodes.plan import prepare
from pipeline.episodes.studies import HomeTasks, beliefs_in_home
from pipeline.episodes.worker import Context
from pipeline.store.artifacts import NotMade
from pipeline.store.episode_row import TRACE
from pipeline.store.folder import Folder
from pipeline.store.layout import BELIEFS, REPORT
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


@dataclass(frozen=True)
class PriorsJob:
    """The models to train first, by the contents of their homes, and how to compare the arms with their versions."""

    options: Priors
    trainings: Mapping[str, train.TrainJob]
    compare: Callable[[Mapping[str, str]], Comparison]

    def run(self, session: Session) -> None:
        """Train a model for every prior, run every arm and write the page."""
        self.compare({name: one.run(session).model_version for name, one in self.trainings.items()}).run(session)

    def outline(self, session: Session) -> Iterator[str]:
        """Say which models would be trained, and once they are, which evaluations the arms would need."""
        versions = {}
        for name, one in self.trainings.items():
            try:
                versions[name] = one.found().model_version
            except NotMade as missing:
                yield f"would first train a model on homes with homes.contents={name} ({missing})"
        if len(versions) == len(self.trainings):
            yield from self.compare(versions).outline(session)
        else:
            priors = [*self.options.trained_on, *self.options.others]
            yield f"would then compare the priors {', '.join(priors)} on one page"


def job(config: Config) -> PriorsJob:
    """Return the configured comparison.

    The priors ``others`` need no training of their own, but a model of each of the contents to stand in for.
    """
    if config.evaluation.unsearched_share != (1.0, 1.0):
        raise UserError("evaluation.unsearched_share: priors are compared where nothing is known from the start")
    options = config.priors
    trained_on: dict[str, None] = dict.fromkeys([*options.trained_on, *(options.contents if options.others else ())])
    homes = {name: with_overrides(config, [f"homes.contents={name}"]).homes_spec for name in trained_on}
    trainings = {name: train.TrainJob(one, config.training_spec) for name, one in homes.items()}
    return PriorsJob(options, trainings, partial(_comparison, config))


def _comparison(config: Config, versions: Mapping[str, str]) -> Comparison:
    tasks_per_home = config.evaluation.tasks_per_home
    arms = arms_of(config.priors, tasks_per_home, versions)
    shared = lay_out(config, [(arm.name, arm.overrides) for arm in arms], config.evaluation.planners, WHAT)
    page = partial(_page, arms, tasks_per_home, config.experiment)
    return Comparison(WHAT, shared, Folder(config.output_dir) / REPORT, page)


def _page(
    arms: Sequence[PriorArm], tasks_per_home: int, experiment: str, shared: Sequence[SharedRun], session: Session
) -> str:
    found: dict[str, tuple[pd.DataFrame, pd.DataFrame]] = {}
    for one in shared:
        found |= _read(one, session)
    compared = [ArmRows(arm.contents, arm.prior, arm.adapts, *found[arm.name], arm.overrides) for arm in arms]
    return render_priors(compared, tasks_per_home, experiment)


def arms_of(options: Priors, tasks_per_home: int, versions: Mapping[str, str]) -> list[PriorArm]:
    """Return all arms, grouped by contents; ``versions``: contents -> the model trained on homes with them."""
    models = {name: f"evaluation.model_uri={registry.version_uri(one)}" for name, one in versions.items()}
    found = []
    for contents in options.contents:
        priors: dict[str, tuple[str, ...]] = {name: (models[contents], UNTRAINED[name]) for name in options.others}
        priors |= {name: (models[name],) for name in options.trained_on}
        for prior, overrides in priors.items():
            learns = prior != TRUTH and tasks_per_home > 1
            for adapts in (False, True) if learns else (False,):
                changes = (f"homes.contents={contents}", *overrides, f"belief.adapt={str(adapts).lower()}")
                found.append(PriorArm(contents, prior, adapts, changes))
    return found


def _read(shared: SharedRun, session: Session) -> dict[str, tuple[pd.DataFrame, pd.DataFrame]]:
    """The episodes of each arm of an evaluation, and what the main planner's team believed."""
    spec, names, found = shared.configured().evaluation_spec(), dict(shared.arms), {}
    context: Context | None = None
    for arm, of_arm in shared.by_arm(read_episodes(shared.episodes)):
        folder, file = Folder(spec.output_dir) / BELIEFS, f"{slug(arm)}.parquet"
        content = folder.read(file)
        beliefs = None if content is None else pd.read_parquet(io.BytesIO(content))
        planner = str(main_planner(sorted(set(of_arm["planner"]))))
        own = of_arm[(of_arm["planner"] == planner) & of_arm["home_id"].notna()]
        if beliefs is None or set(beliefs["trial_id"]) != set(own["trial_id"]):
            context = context or prepare(spec, session.pool).context
            console.headline("beliefs", arm)
            beliefs = _beliefs(own, names[arm][planner], shared.episodes, context, session)
            folder.write(file, beliefs.to_parquet(None, index=False))
        found[arm] = (of_arm, beliefs)
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
    found = session.pool.values(beliefs_in_home, chains, context, unit="homes", named=lambda tasks: tasks.home_id)
    return pd.concat([beliefs for _, beliefs in found]).sort_values(["trial_id", "pair"], ignore_index=True)


def check(config: Config) -> None:
    """Refuse what trainings or evaluations would refuse."""
    train.check(config)
    evaluate.check(config)


STAGE = Stage(job, check)
