"""Plans an evaluation: its episodes, what they share, and the identity that its rows carry."""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from typing import Any

from mrtask.execution.team_spec import RobotSpec
from mrtask.execution.trials import TrialOptions
from mrtask.homes.home import Home
from mrtask.likelihood.adapt import AdaptOptions
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.table import build_table
from mrtask.likelihood.truth import catalogue_truth, counted_truth
from mrtask.tasks.words import read_task
from pipeline.backends.registry import RegisteredModel
from pipeline.base import console
from pipeline.base.config import Config, UserError, content_hash
from pipeline.base.sections import Evaluation, EvaluationHomes, OtherLikelihood, PlannerVariant
from pipeline.episodes.worker import Context, EpisodeKey, Provenance, formula_objects
from pipeline.store.home_files import check_files, count_by_size_class, say_faults
from pipeline.store.home_set import HomeSet
from pipeline.store.maps import MapOptions
from pipeline.store.records import Asked, EvaluatedHomes, RunIdentity
from pipeline.store.rows import Key
from pipeline.store.version import code_version, source_hash

RESULT_SOURCES = ("homes", "maps", "tasks", "likelihood", "planning", "execution")
"""The library packages whose code decides an episode's row."""
WHICH_ROWS = {"planners", "size_classes", "robots", "trials_per_cell"}
"""Keys of ``evaluation`` that decide which rows exist, but not what any of them says."""
WITHOUT_EFFECT = {"homes", "formula_file", "model_uri", "episode_timeout_s", "max_failed_fraction", "rerun"}
"""Keys of ``evaluation`` that do not change a row, or whose effect is recorded elsewhere."""


@dataclass(frozen=True)
class EvaluationPlan:
    """The episodes, what they share, and where their homes come from."""

    keys: tuple[EpisodeKey, ...]
    context: Context
    identity: RunIdentity
    homes: EvaluatedHomes
    experiment: str
    contents_are_drawn: bool
    """Whether the homes' contents were drawn from the catalogue, so that their true likelihoods are known."""
    config: Mapping[str, Any]
    """The whole configuration as plain data, for the record."""

    @property
    def planners(self) -> tuple[str, ...]:
        """The names of the planners that are compared."""
        return tuple(self.context.planners)

    def missing(self, finished: Collection[Key]) -> list[EpisodeKey]:
        """Return the episodes that are not finished yet."""
        return [key for key in self.keys if (key.trial_id, key.planner) not in finished]

    def chains(self, missing: Collection[EpisodeKey]) -> list[tuple[EpisodeKey, ...]]:
        """Return what runs in one go: one episode, or where beliefs adapt, all tasks of a home that lacks any."""
        if self.context.adapt is None:
            return [(key,) for key in missing]
        tasks, chains = self.context.trials.tasks_per_home, defaultdict[EpisodeKey, list[EpisodeKey]](list)
        for key in self.keys:
            chains[replace(key, number=key.number // tasks)].append(key)
        wanted = set(missing)
        return [tuple(chain) for chain in chains.values() if wanted & set(chain)]


def check(options: Evaluation) -> None:
    """Refuse, before any work, a wrong formula or task and files that do not exist."""
    if options.formula is not None:
        formula_objects(options.formula)
    if options.task is not None:
        read_task(options.task, None, ())
    check_files("evaluation.homes.files", options.homes.files)
    check_files("evaluation.homes.assets", [options.homes.assets])


def plan_evaluation(config: Config, home_set: HomeSet, model: RegisteredModel) -> EvaluationPlan:
    """Return the configured evaluation on homes that the model has not seen.

    Raises:
        UserError: a size class has no home.
    """
    options = config.evaluation
    unseen, homes = _unseen_homes(options.homes, config.homes.source, home_set, model)
    size_classes = _size_classes(options.size_classes, homes)
    identity = _identity(config, model, unseen, size_classes)
    formula, objects = task_of(options, unseen)
    planners = config.compared
    drawn = config.homes.source == "generated" and config.homes.contents == "procthor" and not options.homes.files
    truth: LikelihoodModel | None = None
    if any(spec.likelihood.source == "truth" for spec in planners):
        truth = catalogue_truth() if drawn else counted_truth(unseen)
    context = Context(
        homes=unseen,
        table=build_table(model.model, unseen, objects),
        maps=MapOptions.of(config.map, config.cache_dir),
        seed=config.seed,
        trials=TrialOptions(
            templates=options.templates,
            formula=formula,
            formula_objects=objects,
            robot=RobotSpec(
                options.speed_m_per_s,
                options.search_time_s,
                options.interact_time_s,
                config.perception.perception(),
            ),
            tasks_per_home=options.tasks_per_home,
            unsearched_share=options.unsearched_share,
            cost=options.cost,
        ),
        planners={spec.name: spec for spec in planners},
        truth=build_table(truth, unseen, objects) if truth is not None else None,
        home_order=options.homes.order,
        adapt=AdaptOptions(**config.belief.model_dump(exclude={"adapt"})) if config.belief.adapt else None,
        provenance=Provenance(
            model.version, {spec.name: identity.config_hash(spec.name) for spec in planners}, code_version()
        ),
    )
    return EvaluationPlan(
        keys=episode_keys(options, size_classes),
        context=context,
        identity=identity,
        homes=homes,
        experiment=config.experiment,
        contents_are_drawn=drawn,
        config=config.model_dump(mode="json"),
    )


def task_of(options: Evaluation, homes: Sequence[Home]) -> tuple[str | None, tuple[str, ...]]:
    """Return the configured formula, or that of the task in words about these homes, and its objects; or None."""
    if options.task is not None:
        names = {name for home in homes for container in home.containers for name in container.objects}
        read = read_task(options.task, names, ())
        return read.formula, read.propositions
    return options.formula, formula_objects(options.formula) if options.formula is not None else ()


def episode_keys(options: Evaluation, size_classes: Sequence[str]) -> tuple[EpisodeKey, ...]:
    """Return all episodes; cells take turns, so that what is finished at any time is a fair sample of the whole."""
    return tuple(
        EpisodeKey(size_class, robots, number, planner)
        for number in range(options.trials_per_cell)
        for size_class in size_classes
        for robots in options.robots
        for planner in options.planners
    )


def _unseen_homes(
    options: EvaluationHomes, set_source: str, home_set: HomeSet, model: RegisteredModel
) -> tuple[tuple[Home, ...], EvaluatedHomes]:
    """Return the homes that the model was not trained on, and where they come from."""
    read_from, found = home_set.evaluation_homes(options)
    if options.files:
        say_faults(read_from)
    unseen = tuple(home for home in found if home.id not in model.training_homes)
    if len(unseen) < len(found):
        console.line(f"{len(found) - len(unseen)} evaluation homes left out: the model has seen them in training")
    return unseen, EvaluatedHomes(
        source="procthor" if options.files else set_source,
        files=read_from.paths,
        read_from=read_from,
        skipped=len(read_from.faults()),
        read=len(found),
        evaluated=len(unseen),
        by_size_class=count_by_size_class(unseen),
    )


def _size_classes(asked: Sequence[str], homes: EvaluatedHomes) -> tuple[str, ...]:
    """Return the configured size classes; for maps, whose size is given, only those that exist."""
    counts = homes.by_size_class
    empty = [name for name in asked if not counts[name]]
    size_classes = tuple(name for name in asked if counts[name])
    if empty and size_classes and homes.read_from.kind == "maps":
        console.line(f"no {' and no '.join(empty)} map: trials on {', '.join(size_classes)} only")
    elif empty:
        have = ", ".join(f"{count} {name}" for name, count in counts.items())
        raise UserError(
            f"no {' and no '.join(empty)} home to evaluate on ({have}); "
            "give more homes (homes.test, evaluation.homes.files) or other evaluation.size_classes"
        )
    return size_classes


def _identity(
    config: Config, model: RegisteredModel, evaluated: Sequence[Home], size_classes: Sequence[str]
) -> RunIdentity:
    options = config.evaluation
    ids = [home.id for home in evaluated]
    asked = options.model_dump(include=WHICH_ROWS) | {"size_classes": size_classes}
    return RunIdentity(
        seed=config.seed,
        map=config.map,
        homes=config.homes.model_dump(mode="json", exclude={"files", "assets", "map", "containers"}),
        evaluation=options.model_dump(mode="json", exclude=WITHOUT_EFFECT | WHICH_ROWS)
        | {
            "home_order": options.homes.order,
            "belief": config.belief.model_dump() if config.belief.adapt else None,
            "likelihood": config.likelihood.model_dump(),
            "perception": config.perception.model_dump(),
        },
        evaluated_homes=content_hash(ids if options.homes.order == "file" else sorted(ids)),
        planner={spec.name: spec.options for spec in config.compared},
        behind={spec.name: spec.planner for spec in config.compared},
        likelihood={spec.name: asdict(spec.likelihood) for spec in config.compared},
        model_version=model.version,
        code=source_hash(*(f"mrtask/{name}" for name in RESULT_SOURCES)),
        asked=(Asked(since=datetime.now(UTC).isoformat(timespec="seconds"), **asked),),
    )


def covering(config: Config, identity: RunIdentity) -> Config:
    """Return the configuration of a whole run, from that of one of the commands that extended it."""
    own = {name: dict(one) for name, one in identity.planner.items() if identity.behind[name] == name}
    variants = {
        name: PlannerVariant(
            planner=identity.behind[name],
            options=dict(one),
            likelihood=OtherLikelihood.model_validate(identity.likelihood[name]),
        )
        for name, one in identity.planner.items()
        if name not in own
    }
    asked = identity.asked
    rows = {
        "planners": tuple(identity.planner),
        "size_classes": tuple(dict.fromkeys(name for one in asked for name in one.size_classes)),
        "robots": tuple(dict.fromkeys(team for one in asked for team in one.robots)),
        "trials_per_cell": max(one.trials_per_cell for one in asked),
    }
    return config.model_copy(
        update={
            "planner": config.planner | {name.rsplit(".", 1)[-1]: one for name, one in own.items()},
            "planner_variants": variants,
            "evaluation": config.evaluation.model_copy(update=rows),
        }
    )
