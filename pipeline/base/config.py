"""The configuration's schema: every key, what it may be, and errors that say so.

Hydra composes ``conf/`` and the command line; `load` turns the result into frozen models or refuses it before any work
starts. Defaults live in ``conf/`` alone. Relative paths are relative to the caller's folder.
"""

import difflib
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from mrtask.errors import InputError
from mrtask.execution import perception
from mrtask.planning.planners import PLANNERS, make_planner
from mrtask.tasks.templates import TEMPLATES

Positive = Annotated[int, Field(ge=1)]
SizeClass = Literal["small", "medium", "large"]
_Share = Annotated[float, Field(ge=0, le=1)]


class UserError(InputError):
    """A mistake in the configuration, or in what it points to."""


def _absolute(path: Path) -> Path:
    return Path(path).expanduser().absolute()


def _absolute_unless_url(location: str) -> str:
    return location if "://" in location else str(_absolute(Path(location)))


def _listed(value: object) -> object:
    return [value] if isinstance(value, str | int) else value


def _distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(set(values)) != len(values):
        raise ValueError(f"each may be given once, got {', '.join(map(str, values))}")
    return values


LocalPath = Annotated[Path, AfterValidator(_absolute)]
Location = Annotated[str, Field(min_length=1), AfterValidator(_absolute_unless_url)]
"""A local path, made absolute, or an fsspec URL."""


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=())


HomeContents = Literal["procthor", "housekeep"]


class _Homes(_Section):
    contents: HomeContents
    seed: int = Field(ge=0)
    train: Positive
    validation: Positive


class GeneratedHomes(_Homes):
    """Homes of the procedural generator."""

    source: Literal["generated"]
    test: Positive

    @property
    def total(self) -> int:
        """How many homes are generated."""
        return self.train + self.validation + self.test


class ProcthorHomes(_Homes):
    """The user's own house files in ProcTHOR's schema."""

    source: Literal["procthor"]
    test: Positive | None
    files: Annotated[tuple[LocalPath, ...], BeforeValidator(_listed), Field(min_length=1), AfterValidator(_distinct)]
    assets: LocalPath | None
    skip_faulty: bool


class Procthor10kHomes(_Homes):
    """ProcTHOR-10K, downloaded once."""

    source: Literal["procthor10k"]
    test: Positive | None
    skip_faulty: bool


class RosMapHomes(_Homes):
    """The user's own scanned floors to evaluate on; the model learns from generated homes."""

    source: Literal["ros_map"]
    test: Positive
    map: Annotated[tuple[LocalPath, ...], BeforeValidator(_listed), Field(min_length=1)]
    containers: Annotated[tuple[LocalPath, ...], BeforeValidator(_listed)]
    worlds: Positive

    @model_validator(mode="after")
    def _one_file_of_containers_each(self) -> Self:
        if len(self.containers) != len(self.map):
            raise ValueError(
                f"homes.map lists {len(self.map)} and homes.containers {len(self.containers)}; give one for each map"
            )
        return self

    def to_learn_from(self) -> GeneratedHomes:
        """The generated homes that the model learns from."""
        shared = self.model_dump(include={"contents", "seed", "train", "validation", "test"})
        return GeneratedHomes(source="generated", **shared)


HousesInFiles = ProcthorHomes | Procthor10kHomes
Homes = GeneratedHomes | HousesInFiles | RosMapHomes
HOME_SOURCES = tuple(get_args(kind.model_fields["source"].annotation)[0] for kind in get_args(Homes))


class Contents(_Section):
    """How contents are drawn with ``homes.contents=housekeep``."""

    file: LocalPath | None
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None
    objects: Literal["all", "train", "val", "test"]
    splits: LocalPath | None
    table: LocalPath | None
    misplaced: float = Field(ge=0, le=1)
    seed: int = Field(ge=0)
    embedding: str = Field(min_length=1)


class Map(_Section):
    """The occupancy grid."""

    resolution_m: float = Field(gt=0, le=1)
    robot_radius_m: float = Field(ge=0, le=2)
    ways: Literal["shortest", "soft"]


ModelKind = Literal["similarity", "paper_fcnn", "mlp", "logistic", "frequency"]


class Similarity(_Section):
    """Counts of the training homes, shared among similar names."""

    kind: Literal["similarity"]
    embedding: str = Field(min_length=1)
    smoothing: Annotated[float, Field(gt=0)] | None


class Network(_Section):
    """A network on the embeddings of names."""

    kind: Literal["paper_fcnn", "mlp"]
    embedding: str = Field(min_length=1)
    layers: Annotated[tuple[Positive, ...], Field(min_length=1)]
    dropout: float = Field(ge=0, lt=1)


class Logistic(_Section):
    """Logistic regression on the embeddings of names."""

    kind: Literal["logistic"]
    embedding: str = Field(min_length=1)
    regularisation: float = Field(gt=0)


class Frequency(_Section):
    """The table of counts."""

    kind: Literal["frequency"]
    smoothing: Annotated[float, Field(gt=0)] | None


Model = Annotated[Similarity | Network | Logistic | Frequency, Field(discriminator="kind")]
"""Which likelihood model, with the options of its kind."""


class Trainer(_Section):
    """How the networks are trained."""

    learning_rate: float = Field(gt=0)
    scale_learning_rate: float = Field(gt=0)
    weight_decay: float = Field(ge=0)
    batch_size: int = Field(ge=2)
    max_epochs: Positive
    patience: Positive
    device: Literal["auto", "cpu", "cuda", "mps"]
    threads: int = Field(ge=0)
    checkpoint_every: Positive


class EvaluationHomes(_Section):
    """Homes to evaluate on instead of the test homes; empty for those."""

    files: Annotated[tuple[LocalPath, ...], BeforeValidator(_listed), AfterValidator(_distinct)]
    assets: LocalPath | None
    skip_faulty: bool
    order: Literal["shuffled", "file"]


class Belief(_Section):
    """Whether what searches showed in a home corrects the likelihoods there, see `mrtask.likelihood.adapt`."""

    adapt: bool
    kind_sd: float = Field(ge=0)
    object_sd: float = Field(ge=0)
    forget: _Share


_Source = Literal["model", "truth"]
_Spread = Annotated[float, Field(ge=0)]


class Likelihood(_Section):
    """Which likelihoods planners are given, and how wrong on purpose, see `mrtask.likelihood.given`."""

    source: _Source
    uniform_mix: _Share
    noise_sd: _Spread


class Rates(_Section):
    """How likely a search detects an object that is there, and one that is not."""

    true_positive_prob: _Share
    false_positive_prob: _Share

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        self.rates()
        return self

    def rates(self) -> perception.Rates:
        """The same for the library; raises ValueError where a detection would say nothing."""
        return perception.Rates(self.true_positive_prob, self.false_positive_prob)


class Perception(Rates):
    """How well robots see, and the types of objects that they see otherwise."""

    objects: dict[str, Rates]

    def perception(self) -> perception.Perception:
        """The same for the library."""
        return perception.Perception(self.rates(), {name: one.rates() for name, one in self.objects.items()})


class Evaluation(_Section):
    """Which trials are run, by which planners, with which model."""

    planners: Annotated[tuple[str, ...], BeforeValidator(_listed), Field(min_length=1), AfterValidator(_distinct)]
    size_classes: Annotated[
        tuple[SizeClass, ...], BeforeValidator(_listed), Field(min_length=1), AfterValidator(_distinct)
    ]
    robots: Annotated[tuple[Positive, ...], BeforeValidator(_listed), Field(min_length=1), AfterValidator(_distinct)]
    trials_per_cell: Positive
    tasks_per_home: Positive
    templates: Annotated[tuple[str, ...], BeforeValidator(_listed), Field(min_length=1), AfterValidator(_distinct)]
    formula: str | None
    formula_file: LocalPath | None
    task: Annotated[str, Field(min_length=1)] | None
    speed_m_per_s: float = Field(gt=0)
    search_time_s: float = Field(ge=0)
    interact_time_s: float = Field(ge=0)
    unsearched_share: tuple[_Share, _Share]
    cost: Literal["makespan", "least_motion"]
    homes: EvaluationHomes
    model_uri: str = Field(pattern="^(models|runs):/")
    episode_timeout_s: float = Field(gt=0)
    max_failed_fraction: float = Field(ge=0, le=1)
    rerun: Annotated[tuple[Literal["error", "timeout", "failed"], ...], BeforeValidator(_listed)]

    @field_validator("templates")
    @classmethod
    def _known_templates(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        unknown = [name for name in names if name not in TEMPLATES]
        if unknown:
            raise ValueError(f"unknown template {', '.join(unknown)}; allowed: {', '.join(TEMPLATES)}")
        return names

    @model_validator(mode="after")
    def _one_task(self) -> Self:
        if self.task is not None and self.formula is not None:
            raise ValueError("evaluation.task: give it or a formula, not both")
        return self

    @field_validator("unsearched_share")
    @classmethod
    def _least_first(cls, share: tuple[float, float]) -> tuple[float, float]:
        if share[0] > share[1]:
            raise ValueError("give the least share first, the greatest second")
        return share


class OtherLikelihood(_Section):
    """What a planner variant is given that other planners are not; null: the same."""

    source: _Source | None = None
    uniform_mix: _Share | None = None
    noise_sd: _Spread | None = None


class PlannerVariant(_Section):
    """A planner under another name: with other options or likelihoods, beside itself on the same trials."""

    planner: str = Field(min_length=1)
    options: dict[str, Any] = {}
    likelihood: OtherLikelihood = OtherLikelihood()


class Realism(_Section):
    """How generated homes are compared with real ones."""

    generated_test: Positive
    models: Annotated[tuple[ModelKind, ...], BeforeValidator(_listed), AfterValidator(_distinct)]


TrainedOn = Literal["human", "homes", "both"]


class Housekeep(_Section):
    """Which models are measured on the votes of people, and what each is trained on."""

    models: Annotated[tuple[ModelKind, ...], BeforeValidator(_listed), Field(min_length=1), AfterValidator(_distinct)]
    trained_on: Annotated[
        tuple[TrainedOn, ...], BeforeValidator(_listed), Field(min_length=1), AfterValidator(_distinct)
    ]


class Arm(_Section):
    """A named change of the configuration: ``key=value`` as on the command line."""

    name: str = Field(min_length=1)
    overrides: Annotated[tuple[str, ...], BeforeValidator(_listed), Field(min_length=1)]


class Ablation(_Section):
    """How `pipeline.ablation` goes from the configured protocol to another one, and from `pouct_paper` to `pouct`."""

    switches: tuple[Arm, ...]
    steps: tuple[Arm, ...]
    added_alone: bool
    taken_alone: bool


class Factor(_Section):
    """A key of the configuration and the values that it takes, one at a time."""

    name: str = Field(min_length=1)
    key: str = Field(min_length=1)
    values: Annotated[tuple[float, ...], Field(min_length=2), AfterValidator(_distinct)]

    @field_validator("values", mode="before")
    @classmethod
    def _numbers(cls, values: Any) -> Any:
        if any(isinstance(value, bool) for value in values):
            raise ValueError("give numbers: they are the axis of a curve")
        return values


class Sensitivity(_Section):
    """What `pipeline.sensitivity` changes, one factor at a time."""

    factors: Annotated[tuple[Factor, ...], Field(min_length=1)]


class Priors(_Section):
    """Which contents and priors `pipeline.priors` compares."""

    contents: Annotated[
        tuple[HomeContents, ...], BeforeValidator(_listed), Field(min_length=1), AfterValidator(_distinct)
    ]
    trained_on: Annotated[tuple[HomeContents, ...], BeforeValidator(_listed), AfterValidator(_distinct)]
    others: Annotated[tuple[Literal["uniform", "truth"], ...], BeforeValidator(_listed), AfterValidator(_distinct)]


class Optimality(_Section):
    """How far planners are from optimal: on how many trials and worlds it is measured."""

    planners: Annotated[tuple[str, ...], BeforeValidator(_listed), Field(min_length=1), AfterValidator(_distinct)]
    trials_per_cell: Positive
    worlds: int = Field(ge=2)


class Replay(_Section):
    """Which trial is shown, and whose episodes."""

    trial_id: str | None
    planners: Annotated[tuple[str, ...], BeforeValidator(_listed), AfterValidator(_distinct)]


class Cluster(_Section):
    """Where Ray runs and how much of it a run may take."""

    address: str = Field(pattern=r"^(local|auto|ray://.+|[^:/]+:\d+)$")
    cpus: Positive | None
    memory_per_task_gb: float = Field(gt=0)
    retries: int = Field(ge=0)


class Tracking(_Section):
    """Where MLflow keeps runs and models."""

    uri: str = Field(min_length=1)
    experiment_name: str = Field(min_length=1)

    @field_validator("uri")
    @classmethod
    def _absolute_sqlite(cls, uri: str) -> str:
        scheme = "sqlite:///"
        return scheme + str(_absolute(Path(uri.removeprefix(scheme)))) if uri.startswith(scheme) else uri


UNIONS = {"homes": HOME_SOURCES, "model": get_args(ModelKind)}
"""Sections whose keys depend on their kind, with the kinds."""


class Config(_Section):
    """All of it, resolved and checked."""

    experiment: str = Field(min_length=1)
    seed: int = Field(ge=0)
    output_dir: Location
    overwrite: bool
    dry_run: bool
    draw: bool
    datasets_dir: LocalPath
    cache_dir: LocalPath
    cache_limit_gb: float = Field(gt=0)
    map: Map
    homes: Homes = Field(discriminator="source")
    contents: Contents
    model: Model
    trainer: Trainer
    planner: dict[str, dict[str, Any]]
    planner_variants: dict[Annotated[str, Field(pattern=r"^[\w:-]+$")], PlannerVariant]
    belief: Belief
    likelihood: Likelihood
    perception: Perception
    evaluation: Evaluation
    realism: Realism
    housekeep: Housekeep
    ablation: Ablation
    sensitivity: Sensitivity
    priors: Priors
    optimality: Optimality
    replay: Replay
    cluster: Cluster
    tracking: Tracking

    def planner_options(self, name: str) -> dict[str, Any]:
        """The options of one planner or variant; those of a planner of your own stand under its class's name."""
        if (variant := self.planner_variants.get(name)) is not None:
            return self.planner_options(variant.planner) | variant.options
        return self.planner.get(name.rsplit(".", 1)[-1], {})

    def planner_behind(self, name: str) -> str:
        """The planner that a variant is one of; a planner's own name where it is none."""
        variant = self.planner_variants.get(name)
        return name if variant is None else variant.planner

    def likelihood_of(self, name: str) -> Likelihood:
        """The likelihoods that a planner or variant is given."""
        variant = self.planner_variants.get(name)
        other = variant.likelihood.model_dump(exclude_none=True) if variant else {}
        return self.likelihood.model_copy(update=other)


def load(composed: DictConfig) -> Config:
    """The checked configuration; raises `UserError` with every mistake, what is allowed and what was given."""
    try:
        missing = sorted(OmegaConf.missing_keys(composed))
        if missing:
            raise UserError("\n".join(f"{key}: a value is needed, give it as {key}=..." for key in missing))
        plain = OmegaConf.to_container(composed, resolve=True, enum_to_str=True)
    except OmegaConfBaseException as error:
        raise UserError(str(error)) from error
    _read_formula(plain)
    try:
        config = Config.model_validate(plain)
    except ValidationError as error:
        raise UserError("\n".join(explain_error(item) for item in error.errors())) from error
    _check_planners(config)
    if config.belief.adapt and not config.perception.perception().sees_all:
        raise UserError(
            "belief.adapt=true: learns from what searches showed as from the truth, so it needs perception that does "
            "not err; give belief.adapt=false or leave perception at its defaults"
        )
    return config


def with_overrides(config: Config, overrides: Sequence[str]) -> Config:
    """The configuration with ``key=value`` changes; raises `UserError` where one of them is a mistake."""
    changed = OmegaConf.create(config.model_dump(mode="json"))
    changed.merge_with_dotlist(list(overrides))
    return load(changed)


def _read_formula(plain: Any) -> None:
    """Puts the text of ``evaluation.formula_file`` in the place of ``evaluation.formula``, and null in its own."""
    options = plain["evaluation"]
    if (path := options.get("formula_file")) is None:
        return
    if options["formula"] is not None:
        raise UserError("evaluation.formula_file: give it or evaluation.formula, not both")
    try:
        options["formula"] = " ".join(_absolute(Path(str(path))).read_text(encoding="utf-8").split())
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"evaluation.formula_file={path}: cannot be read ({error})") from error
    options["formula_file"] = None


def _check_planners(config: Config) -> None:
    for name in config.planner_variants:
        if name in PLANNERS:
            raise UserError(f"planner_variants.{name}: is a planner's own name; give the variant another")
        _check_planner(f"planner_variants.{name}", config.planner_behind(name), config.planner_options(name))
    for name in config.evaluation.planners:
        _check_planner("evaluation.planners", config.planner_behind(name), config.planner_options(name))
    for name in config.optimality.planners:
        _check_planner("optimality.planners", config.planner_behind(name), config.planner_options(name))
    behind = {config.planner_behind(name) for name in config.evaluation.planners}
    own = {name.rsplit(".", 1)[-1] for name in behind if "." in name}
    for name in config.planner.keys() - own:
        _check_planner("planner", name, config.planner[name])


def _check_planner(key: str, name: str, options: Mapping[str, Any]) -> None:
    try:
        make_planner(name, options)
    except ValueError as error:
        raise UserError(f"{key}: {error}") from error


_BOUNDS = {
    "greater_than_equal": "at least {ge}",
    "greater_than": "greater than {gt}",
    "less_than_equal": "at most {le}",
    "less_than": "less than {lt}",
}


def explain_error(item: Any) -> str:
    """One pydantic error as ``key=value: what is allowed``."""
    path = [str(part) for part in item["loc"]]
    if path[0] in UNIONS and len(path) > 1 and path[1] in UNIONS[path[0]]:
        del path[1]
    key, kind, context, given = ".".join(path), item["type"], item.get("ctx", {}), item["input"]
    if kind == "union_tag_invalid":
        key, given = f"{key}.{context['discriminator'].strip(chr(39))}", context["tag"]
    if kind == "extra_forbidden":
        return f"{key}: no such key; {_suggest_keys(path)}"
    if kind == "missing":
        return f"{key}: a value is needed, give it as {key}=..."
    if kind in _BOUNDS:
        message = "must be " + _BOUNDS[kind].format(**context)
    elif kind in ("literal_error", "union_tag_invalid"):
        message = "allowed: " + context.get("expected", context.get("expected_tags", "")).replace(" or ", ", ")
    else:
        message = item["msg"].removeprefix("Value error, ")
    return f"{key}={given}: {message}"


def _suggest_keys(path: list[str]) -> str:
    model: Any = Config
    for part in path[:-1]:
        known = model.model_fields.get(part)
        if known is None:
            return suggest(part, list(model.model_fields))
        if model is Config and part in UNIONS:
            members = get_args(known.annotation)
            return suggest(path[-1], sorted({key for member in members for key in member.model_fields}))
        if not (isinstance(known.annotation, type) and issubclass(known.annotation, BaseModel)):
            return f"`--cfg job` shows what {part} has"
        model = known.annotation
    return suggest(path[-1], list(model.model_fields))


def explain_unknown_key(key: str) -> str:
    """What to say about a key that is nowhere in the configuration."""
    return f"{key}: no such key; {_suggest_keys(key.split('.'))}"


def suggest(word: str, allowed: list[str]) -> str:
    """A hint: the nearest allowed word, if one is near, and all of them."""
    near = difflib.get_close_matches(word, allowed, n=1)
    return (f"did you mean {near[0]}? " if near else "") + f"allowed: {', '.join(allowed)}"


def content_hash(content: object) -> str:
    """16 hex digits of anything made of plain data."""
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
