"""The configuration's sections for a run: homes, maps, models, planners, trials, and where it all runs.

The schema as a whole is `pipeline.base.config`.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from mrtask.execution import perception, team_spec
from mrtask.execution.team_spec import ALIKE, RobotSpec
from mrtask.homes.generator.residence_size import (
    CONTAINERS_ALLOWED,
    FLATS_ALLOWED,
    MAX_FLATS_PER_SIDE,
    ResidenceSize,
)
from mrtask.tasks.templates import TEMPLATES
from pipeline.base.values import LocalPath, Positive, Section, Share, absolute, distinct, listed, spelled

MODEL_URI = "(models|runs):/.+"
MODEL_URIS = "models:/NAME/VERSION, models:/NAME@ALIAS or runs:/RUN/model"
SizeClass = Literal["small", "medium", "large", "residence"]
HomeContents = Literal["procthor", "housekeep"]


class _Homes(Section):
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
        """How many homes the generator makes."""
        return self.train + self.validation + self.test


class ProcthorHomes(_Homes):
    """The user's own house files in ProcTHOR's schema."""

    source: Literal["procthor"]
    test: Positive | None
    files: Annotated[tuple[LocalPath, ...], BeforeValidator(listed), Field(min_length=1), AfterValidator(distinct)]
    assets: LocalPath | None
    skip_faulty: bool


class Procthor10kHomes(_Homes):
    """ProcTHOR-10K, downloaded once."""

    source: Literal["procthor10k"]
    test: Positive | None
    skip_faulty: bool


class _HomesToEvaluateOn(_Homes):
    """Homes that planners are evaluated on, while the model learns from generated ones."""

    test: Positive

    def to_learn_from(self) -> GeneratedHomes:
        """Return the generated homes that the model learns from."""
        shared = self.model_dump(include={"contents", "seed", "train", "validation", "test"})
        return GeneratedHomes(source="generated", **shared)


class ResidenceHomes(_HomesToEvaluateOn):
    """Generated residences, or the user's own homes joined to one site."""

    source: Literal["residence"]
    residences: Positive
    containers: int = Field(ge=CONTAINERS_ALLOWED[0], le=CONTAINERS_ALLOWED[1])
    flats: Annotated[int, Field(ge=FLATS_ALLOWED[0], le=FLATS_ALLOWED[1])] | None
    flats_per_side: Annotated[int, Field(ge=1, le=MAX_FLATS_PER_SIDE)] | None
    join: Annotated[tuple[LocalPath, ...], BeforeValidator(listed), AfterValidator(distinct)]
    assets: LocalPath | None

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if not self.join:
            self.size()
        return self

    def size(self) -> ResidenceSize:
        """Return the size of the generated residences; raises ValueError for one that is not possible."""
        return ResidenceSize(self.containers, self.flats, self.flats_per_side)


class RosMapHomes(_HomesToEvaluateOn):
    """The user's own scanned floors."""

    source: Literal["ros_map"]
    map: Annotated[tuple[LocalPath, ...], BeforeValidator(listed), Field(min_length=1)]
    containers: Annotated[tuple[LocalPath, ...], BeforeValidator(listed)]
    worlds: Positive

    @model_validator(mode="after")
    def _one_file_of_containers_each(self) -> Self:
        if len(self.containers) != len(self.map):
            raise ValueError(
                f"homes.map lists {len(self.map)} and homes.containers {len(self.containers)}; give one for each map"
            )
        return self


HousesInFiles = ProcthorHomes | Procthor10kHomes
Homes = GeneratedHomes | HousesInFiles | ResidenceHomes | RosMapHomes
HOME_SOURCES = tuple(get_args(kind.model_fields["source"].annotation)[0] for kind in get_args(Homes))


class Contents(Section):
    """How contents are drawn with ``homes.contents=housekeep``."""

    file: LocalPath | None
    sha256: Annotated[str, spelled("[0-9a-f]{64}", "64 hexadecimal digits, as sha256sum prints them")] | None
    objects: Literal["all", "train", "val", "test"]
    splits: LocalPath | None
    table: LocalPath | None
    misplaced: float = Field(ge=0, le=1)
    seed: int = Field(ge=0)
    embedding: str = Field(min_length=1)


class Map(Section):
    """The occupancy grid."""

    resolution_m: float = Field(gt=0, le=1)
    robot_radius_m: float = Field(ge=0, le=2)
    ways: Literal["shortest", "soft"]


ModelKind = Literal["similarity", "paper_fcnn", "mlp", "logistic", "frequency"]


class Similarity(Section):
    """The counts of the training homes, shared among similar names."""

    kind: Literal["similarity"]
    embedding: str = Field(min_length=1)
    smoothing: Annotated[float, Field(gt=0)] | None


class Network(Section):
    """A network on the embeddings of names."""

    kind: Literal["paper_fcnn", "mlp"]
    embedding: str = Field(min_length=1)
    layers: Annotated[tuple[Positive, ...], Field(min_length=1)]
    dropout: float = Field(ge=0, lt=1)


class Logistic(Section):
    """Logistic regression on the embeddings of names."""

    kind: Literal["logistic"]
    embedding: str = Field(min_length=1)
    regularisation: float = Field(gt=0)


class Frequency(Section):
    """The table of counts."""

    kind: Literal["frequency"]
    smoothing: Annotated[float, Field(gt=0)] | None


Model = Annotated[Similarity | Network | Logistic | Frequency, Field(discriminator="kind")]
"""Which likelihood model, with the options of its kind."""


class Trainer(Section):
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


class EvaluationHomes(Section):
    """Homes to evaluate on instead of the test homes; without files, the test homes."""

    files: Annotated[tuple[LocalPath, ...], BeforeValidator(listed), AfterValidator(distinct)]
    assets: LocalPath | None
    skip_faulty: bool
    order: Literal["shuffled", "file"]


class Belief(Section):
    """Whether what searches show in a home corrects the likelihoods there, see `mrtask.likelihood.adapt`."""

    adapt: bool
    kind_sd: float = Field(ge=0)
    object_sd: float = Field(ge=0)
    forget: Share


_Source = Literal["model", "truth"]
_Spread = Annotated[float, Field(ge=0)]


class Likelihood(Section):
    """Which likelihoods planners plan with, and how wrong on purpose, see `mrtask.likelihood.choice`."""

    source: _Source
    uniform_mix: Share
    noise_sd: _Spread


class Rates(Section):
    """How likely a search detects an object that is there, and one that is not."""

    true_positive_prob: Share
    false_positive_prob: Share

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        self.rates()
        return self

    def rates(self) -> perception.Rates:
        """Return the same for the library; raises ValueError where a detection would say nothing."""
        return perception.Rates(self.true_positive_prob, self.false_positive_prob)


class Perception(Rates):
    """How well robots see, and the types of objects with rates of their own."""

    objects: dict[str, Rates]

    def perception(self) -> perception.Perception:
        """Return the same for the library."""
        return perception.Perception(self.rates(), {name: one.rates() for name, one in self.objects.items()})


_Types = Annotated[tuple[str, ...], BeforeValidator(listed), AfterValidator(distinct)]


class TeamRobot(Section):
    """What one robot is like; null: as the configuration says of all."""

    speed_m_per_s: Annotated[float, Field(gt=0)] | None = None
    search_time_s: Annotated[float, Field(ge=0)] | None = None
    interact_time_s: Annotated[float, Field(ge=0)] | None = None
    radius_m: Annotated[float, Field(ge=0, le=2)] | None = None
    start: tuple[float, float] | None = None
    handles: _Types | None = None
    opens: _Types | None = None

    def spec(self, like: RobotSpec, name: str) -> RobotSpec:
        """Return the robot, which is ``like`` this one in all that is not said of it."""
        said = self.model_dump(exclude_none=True, include=set(TeamRobot.model_fields) - {"start"})
        return replace(like, **said, start_m=self.start, name=name)


class NamedRobot(TeamRobot):
    """A robot of a team, with the name that legends show; without one it is called by its number."""

    name: str = ""


class Team(Section):
    """The robots; none: as many as ``evaluation.robots`` says, all alike."""

    name: str = Field(min_length=1)
    robots: tuple[NamedRobot, ...]
    file: None

    @model_validator(mode="after")
    def _named(self) -> Self:
        if self.robots and self.name == ALIKE:
            raise ValueError(f"{ALIKE!r} is the team whose robots do not differ; give this one a name of its own")
        if not self.robots and self.name != ALIKE:
            raise ValueError(
                f"the team {self.name!r} has no robots; list them under robots, each with its speed_m_per_s"
            )
        if self.robots:
            self.team(RobotSpec())
        return self

    def team(self, like: RobotSpec) -> team_spec.Team | None:
        """Return the robots for the library, ``like`` this one in all that is not said of them; None without any.

        Raises:
            ValueError: two robots have one name.
        """
        members = tuple(robot.spec(like, robot.name) for robot in self.robots)
        return team_spec.Team(members, self.name) if members else None


class Evaluation(Section):
    """Which trials are run, by which planners, with which model."""

    planners: Annotated[tuple[str, ...], BeforeValidator(listed), Field(min_length=1), AfterValidator(distinct)]
    size_classes: Annotated[
        tuple[SizeClass, ...], BeforeValidator(listed), Field(min_length=1), AfterValidator(distinct)
    ]
    robots: Annotated[tuple[Positive, ...], BeforeValidator(listed), Field(min_length=1), AfterValidator(distinct)]
    trials_per_cell: Positive
    tasks_per_home: Positive
    templates: Annotated[tuple[str, ...], BeforeValidator(listed), Field(min_length=1), AfterValidator(distinct)]
    formula: str | None
    formula_file: LocalPath | None
    task: Annotated[str, Field(min_length=1)] | None
    speed_m_per_s: float = Field(gt=0)
    search_time_s: float = Field(ge=0)
    interact_time_s: float = Field(ge=0)
    unsearched_share: tuple[Share, Share]
    cost: Literal["makespan", "least_motion"]
    homes: EvaluationHomes
    model_uri: Annotated[str, spelled(MODEL_URI, MODEL_URIS)]
    episode_timeout_s: float = Field(gt=0)
    max_failed_fraction: float = Field(ge=0, le=1)
    rerun: Annotated[tuple[Literal["error", "timeout", "failed"], ...], BeforeValidator(listed)]

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

    def robot(self, sees: Perception) -> RobotSpec:
        """Return what a robot is like of which the team says nothing else."""
        return RobotSpec(self.speed_m_per_s, self.search_time_s, self.interact_time_s, sees.perception())

    @field_validator("unsearched_share")
    @classmethod
    def _least_first(cls, share: tuple[float, float]) -> tuple[float, float]:
        if share[0] > share[1]:
            raise ValueError("give the least share first, the greatest second")
        return share


class OtherLikelihood(Section):
    """The likelihoods that a planner variant plans with; null: as configured for all planners."""

    source: _Source | None = None
    uniform_mix: Share | None = None
    noise_sd: _Spread | None = None


class PlannerVariant(Section):
    """A planner under another name: with other options or likelihoods, beside itself on the same trials."""

    planner: str = Field(min_length=1)
    options: dict[str, Any] = Field(default_factory=dict)
    likelihood: OtherLikelihood = OtherLikelihood()


class Cluster(Section):
    """Where Ray runs, and how much of it a run may use."""

    address: Annotated[str, spelled(r"local|auto|ray://.+|[^:/]+:\d+", "local, auto, ray://HOST:PORT or HOST:PORT")]
    cpus: Positive | None
    memory_per_task_gb: float = Field(gt=0)
    retries: int = Field(ge=0)


class Tracking(Section):
    """Where MLflow keeps runs and models."""

    uri: str = Field(min_length=1)
    experiment_name: str = Field(min_length=1)

    @field_validator("uri")
    @classmethod
    def _absolute_sqlite(cls, uri: str) -> str:
        scheme = "sqlite:///"
        return scheme + str(absolute(Path(uri.removeprefix(scheme)))) if uri.startswith(scheme) else uri
