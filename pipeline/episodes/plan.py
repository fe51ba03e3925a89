"""Plans an evaluation: its episodes, what they share, and the identity that its rows carry."""

from collections import Counter, defaultdict
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime

from mrtask.execution.team_checks import check_doable, check_types
from mrtask.execution.team_spec import RobotSpec
from mrtask.execution.trials import TrialOptions, can_serve, check_formula, objects_in
from mrtask.homes.home import Home
from mrtask.likelihood.adapt import AdaptOptions
from mrtask.likelihood.model import LikelihoodModel
from mrtask.likelihood.options import LikelihoodChoice
from mrtask.likelihood.table import build_table
from mrtask.likelihood.truth import catalogue_truth, counted_truth
from mrtask.names import counted
from mrtask.tasks.words import read_task
from pipeline.backends import registry, runs
from pipeline.backends.pool import Pool
from pipeline.backends.registry import RegisteredModel
from pipeline.base import console
from pipeline.base.config import UserError, content_hash
from pipeline.base.sections import Evaluation, EvaluationHomes
from pipeline.base.specs import EvaluationSpec, PlannerSpec
from pipeline.episodes.worker import Context, EpisodeKey, Provenance
from pipeline.inputs import homes
from pipeline.store.artifacts import NotMade
from pipeline.store.folder import Folder
from pipeline.store.home_files import check_files, count_by_size_class, say_faults
from pipeline.store.home_set import HomeSet
from pipeline.store.layout import IDENTITY
from pipeline.store.records import Asked, EvaluatedHomes, RunIdentity, TrainedModelRecord
from pipeline.store.rows import Key
from pipeline.store.version import RESULT_SOURCES, code_version, source_hash

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
    contents_are_drawn: bool
    """Whether the homes' contents were drawn from the catalogue, so that their true likelihoods are known."""
    spec: EvaluationSpec
    rivals: tuple[TrainedModelRecord, ...] = ()
    """The versions that the command trained beside the one that plans."""

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
    """Refuse, before any work, a task in words that is none and files that do not exist."""
    if options.task is not None:
        read_task(options.task, None, (), checked_later=True)
    check_files("evaluation.homes.files", options.homes.files)
    check_files("evaluation.homes.assets", [options.homes.assets])


def check_task_in(spec: EvaluationSpec, home_set: HomeSet) -> None:
    """Refuse, as soon as there are homes, what none of them has and a team that can do the task in none."""
    options, team = spec.options, spec.team.team(RobotSpec())
    if options.task is None and options.formula is None and team is None:
        return
    homes = home_set.evaluation_homes(options.homes)[1]
    formula, objects = task_of(options, homes)
    if team is not None:
        check_types(team, homes)
        for robots in options.robots:
            check_doable(team.first(robots), formula, objects)


def prepare(spec: EvaluationSpec, pool: Pool) -> EvaluationPlan:
    """Return the plan of an evaluation; a dry run finds the homes, any other makes them if need be.

    Raises:
        NotMade: homes or model of a dry run do not exist yet.
        UserError: the evaluation cannot be run as configured.
    """
    check(spec.options)
    found = homes.make(spec.homes, None) if spec.dry_run else None
    if found is not None:
        check_task_in(spec, found)
    model = load_model(spec)
    return plan_evaluation(spec, found or homes.make(spec.homes, pool), model)


def load_model(spec: EvaluationSpec, trained: str | None = None) -> RegisteredModel:
    """Return the configured model.

    In place of the champion it is the version that this command has ``trained``, or for a run that is continued the
    version that it began with.
    """
    if runs.is_new(spec.tracking.uri):
        uri, store = spec.options.model_uri, spec.tracking.uri
        raise NotMade(f"no usable model {uri}: there is no store {store} yet; python -m pipeline.train trains one")
    uri = spec.options.model_uri
    if uri == registry.CHAMPION_URI:
        begun = None if spec.overwrite else RunIdentity.read(Folder(spec.output_dir), IDENTITY)
        version = begun.model_version if trained is None and begun is not None else trained
        uri = uri if version is None else registry.version_uri(version)
    tracking = runs.open_tracking(spec.tracking.uri, spec.tracking.experiment_name)
    return registry.load_registered(tracking, uri, spec.maps.cache_dir)


def plan_evaluation(spec: EvaluationSpec, home_set: HomeSet, model: RegisteredModel) -> EvaluationPlan:
    """Return the plan of an evaluation on homes that the model has not seen.

    Raises:
        UserError: a size class has no home.
    """
    options, configured, planners = spec.options, spec.homes.homes, spec.planners
    unseen, evaluated = _unseen_homes(options.homes, configured.source, home_set, model)
    size_classes = _size_classes(options.size_classes, evaluated)
    identity = _identity(spec, model, unseen, size_classes)
    formula, objects = task_of(options, unseen)
    robot = options.robot(spec.perception)
    team = spec.team.team(robot)
    if formula is not None:
        _check_served(formula, objects, [home for home in unseen if home.size_class in size_classes])
    drawn = configured.source == "generated" and configured.contents == "procthor" and not options.homes.files
    truth: LikelihoodModel | None = None
    if any(planner.likelihood.source == "truth" for planner in planners):
        truth = catalogue_truth() if drawn else counted_truth(unseen)
    context = Context(
        homes=unseen,
        table=build_table(model.model, unseen, objects),
        maps=spec.maps,
        seed=spec.seed,
        trials=TrialOptions(
            templates=options.templates,
            formula=formula,
            formula_objects=objects,
            robot=robot,
            team=team,
            tasks_per_home=options.tasks_per_home,
            unsearched_share=options.unsearched_share,
            cost=options.cost,
        ),
        planners={planner.name: planner for planner in planners},
        truth=build_table(truth, unseen, objects) if truth is not None else None,
        home_order=options.homes.order,
        adapt=AdaptOptions(**spec.belief.model_dump(exclude={"adapt"})) if spec.belief.adapt else None,
        provenance=Provenance(
            model.version, {name: identity.config_hash(name) for name in identity.planner}, code_version()
        ),
    )
    return EvaluationPlan(
        keys=episode_keys(spec, size_classes),
        context=context,
        identity=identity,
        homes=evaluated,
        contents_are_drawn=drawn,
        spec=spec,
    )


def task_of(options: Evaluation, homes: Sequence[Home]) -> tuple[str | None, tuple[str, ...]]:
    """Return the configured formula, or that of the task in words, and its objects; or None.

    Raises:
        InputError: none of these homes has an object of the task.
    """
    if options.task is not None:
        read = read_task(options.task, objects_in(homes), ())
        return read.formula, read.propositions
    return options.formula, check_formula(options.formula, homes) if options.formula is not None else ()


def _check_served(formula: str, objects: tuple[str, ...], homes: Sequence[Home]) -> None:
    """Say in how many of the homes the task cannot be done; raises `UserError` for a size class with no other."""
    fitting = Counter(home.size_class for home in homes if can_serve(formula, objects, objects_in([home])))
    everywhere = Counter(home.size_class for home in homes)
    if none := [name for name in everywhere if not fitting[name]]:
        raise UserError(
            f"no {' and no '.join(none)} home has what the task {formula!r} needs in its containers; give more homes "
            "(homes.test, evaluation.homes.files), other evaluation.size_classes or another task"
        )
    if lacking := everywhere.total() - fitting.total():
        console.line(
            f"{lacking} of {everywhere.total()} homes lack what the task needs: its trials are drawn among the others"
        )


def episode_keys(spec: EvaluationSpec, size_classes: Sequence[str]) -> tuple[EpisodeKey, ...]:
    """Return all episodes; cells take turns, so that what is finished at any time is a fair sample of the whole."""
    return tuple(
        EpisodeKey(size_class, robots, number, planner.name)
        for number in range(spec.options.trials_per_cell)
        for size_class in size_classes
        for robots in spec.options.robots
        for planner in spec.planners
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
        console.line(
            f"{counted(len(found) - len(unseen), 'evaluation home')} left out: the model has seen them in training"
        )
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
    empty = [name for name in asked if not counts.get(name)]
    size_classes = tuple(name for name in asked if counts.get(name))
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
    spec: EvaluationSpec, model: RegisteredModel, evaluated: Sequence[Home], size_classes: Sequence[str]
) -> RunIdentity:
    options, planners = spec.options, spec.planners
    ids = [home.id for home in evaluated]
    asked = options.model_dump(include=WHICH_ROWS) | {
        "planners": tuple(planner.name for planner in planners),
        "size_classes": size_classes,
    }
    return RunIdentity(
        seed=spec.seed,
        map=spec.maps.grid,
        homes=spec.homes.homes.model_dump(mode="json", exclude={"files", "assets", "map", "containers"}),
        evaluation=options.model_dump(mode="json", exclude=WITHOUT_EFFECT | WHICH_ROWS)
        | {
            "home_order": options.homes.order,
            "belief": spec.belief.model_dump() if spec.belief.adapt else None,
            "likelihood": spec.likelihood.model_dump(),
            "perception": spec.perception.model_dump(),
            "team": spec.team.model_dump(mode="json", exclude={"file"}, exclude_defaults=True),
        },
        evaluated_homes=content_hash(ids if options.homes.order == "file" else sorted(ids)),
        planner={planner.name: planner.options for planner in planners},
        behind={planner.name: planner.planner for planner in planners},
        likelihood={planner.name: asdict(planner.likelihood) for planner in planners},
        model_version=model.version,
        code=source_hash(*(f"mrtask/{name}" for name in RESULT_SOURCES)),
        asked=(Asked(since=datetime.now(UTC).isoformat(timespec="seconds"), **asked),),
    )


def covering(spec: EvaluationSpec, identity: RunIdentity) -> EvaluationSpec:
    """Return a whole run, from what one of the commands that extended it asked for."""
    planners = (
        PlannerSpec(name, identity.behind[name], options, LikelihoodChoice(**identity.likelihood_of(name)))
        for name, options in identity.planner.items()
    )
    asked = identity.asked
    trials = {
        "size_classes": tuple(dict.fromkeys(name for one in asked for name in one.size_classes)),
        "robots": tuple(dict.fromkeys(team for one in asked for team in one.robots)),
        "trials_per_cell": max(one.trials_per_cell for one in asked),
    }
    return replace(spec, planners=tuple(planners), options=spec.options.model_copy(update=trials))
