"""The configuration's schema: every key, what it may be, and errors that say so.

Hydra composes ``conf/`` and the command line; `load` turns the result into frozen models or refuses it before any work
starts. Only ``conf/`` holds defaults. The sections are in `pipeline.base.sections` and `pipeline.base.studies`.
"""

import hashlib
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, ValidationError

from mrtask.errors import InputError
from mrtask.execution.team_spec import RobotSpec
from mrtask.homes.catalogue import load_catalogue
from mrtask.likelihood.options import LikelihoodChoice
from mrtask.names import counted, did_you_mean, suggest
from mrtask.planning.planners import PAPERS_PLANNER, PLANNERS, check_planner_name
from mrtask.tasks.formula import parse
from mrtask.validation import problem
from pipeline.base.sections import (
    HOME_SOURCES,
    Belief,
    Cluster,
    Contents,
    Evaluation,
    Homes,
    Likelihood,
    Map,
    Model,
    ModelKind,
    NamedRobot,
    Perception,
    PlannerVariant,
    ResidenceHomes,
    Team,
    Tracking,
    Trainer,
)
from pipeline.base.specs import EvaluationSpec, HomesSpec, MapOptions, PlannerSpec, TrainingSpec
from pipeline.base.studies import Ablation, Housekeep, Optimality, Priors, Realism, Replay, Sensitivity
from pipeline.base.values import LocalPath, Location, Section, absolute, distinct, listed, spelled

CONF_DIR = Path(__file__).resolve().parents[2] / "conf"
"""The folder with the defaults of all keys."""


class UserError(InputError):
    """A mistake in the configuration, or in what it points to."""


LONGEST_SHOWN = 80
"""How many characters of a wrong value a message repeats."""
UNIONS = {"homes": HOME_SOURCES, "model": get_args(ModelKind)}
"""Sections whose keys depend on their kind, with the kinds."""


class Config(Section):
    """The whole configuration, resolved and checked."""

    experiment: str = Field(min_length=1)
    seed: int = Field(ge=0)
    output_dir: Location
    overwrite: bool
    dry_run: bool
    draw: bool
    pdf: bool
    datasets_dir: LocalPath
    cache_dir: LocalPath
    cache_limit_gb: float = Field(gt=0)
    map: Map
    homes: Homes = Field(discriminator="source")
    contents: Contents
    model: Model
    trainer: Trainer
    rivals: Annotated[tuple[ModelKind, ...], BeforeValidator(listed), AfterValidator(distinct)]
    planner: dict[str, dict[str, Any]]
    planner_variants: dict[Annotated[str, spelled(r"[\w:-]+", "names of letters, digits, _, - and :")], PlannerVariant]
    belief: Belief
    likelihood: Likelihood
    perception: Perception
    evaluation: Evaluation
    team: Team
    realism: Realism
    housekeep: Housekeep
    ablation: Ablation
    sensitivity: Sensitivity
    priors: Priors
    optimality: Optimality
    replay: Replay
    cluster: Cluster
    tracking: Tracking

    def spec(self, name: str) -> PlannerSpec:
        """Resolve a planner or a variant; the options of a planner of your own stand under its class's name."""
        variant = self.planner_variants.get(name, PlannerVariant(planner=name))
        options = self.planner.get(variant.planner.rsplit(".", 1)[-1], {}) | variant.options
        likelihood = self.likelihood.model_dump() | variant.likelihood.model_dump(exclude_none=True)
        return PlannerSpec(name, variant.planner, options, LikelihoodChoice(**likelihood))

    @property
    def homes_spec(self) -> HomesSpec:
        """Which homes to make or read."""
        return HomesSpec(self.homes, self.contents, self.datasets_dir)

    @property
    def maps(self) -> MapOptions:
        """How homes are mapped."""
        return MapOptions(self.map, self.cache_dir)

    @property
    def robot(self) -> RobotSpec:
        """What a robot is like of which the team says nothing else."""
        return self.evaluation.robot(self.perception)

    @property
    def training_spec(self) -> TrainingSpec:
        """Which model to train."""
        return TrainingSpec(self.model, self.trainer, self.seed, self.tracking, self.datasets_dir, self.cache_dir)

    @property
    def idle_variants(self) -> tuple[str, ...]:
        """The variants that are among no stage's planners, so that nothing runs them."""
        named = {*self.evaluation.planners, *self.optimality.planners}
        return tuple(name for name in self.planner_variants if name not in named)

    def evaluation_spec(self, planners: Sequence[str] | None = None) -> EvaluationSpec:
        """Return what to evaluate: the configured planners, or these.

        With homes=residence, which are of one size class, there is no other class to choose.
        """
        options = self.evaluation
        if isinstance(self.homes, ResidenceHomes) and not options.homes.files:
            options = options.model_copy(update={"size_classes": ("residence",)})
        return EvaluationSpec(
            homes=self.homes_spec,
            options=options,
            planners=tuple(map(self.spec, self.evaluation.planners if planners is None else planners)),
            record=self.model_dump(mode="json"),
            experiment=self.experiment,
            seed=self.seed,
            maps=self.maps,
            likelihood=self.likelihood,
            perception=self.perception,
            team=self.team,
            belief=self.belief,
            tracking=self.tracking,
            output_dir=self.output_dir,
            overwrite=self.overwrite,
            dry_run=self.dry_run,
            pdf=self.pdf,
            cache_limit_gb=self.cache_limit_gb,
        )


def load(composed: DictConfig) -> Config:
    """Return the checked configuration; raises `UserError` with every mistake, what is allowed and what was given."""
    try:
        missing = sorted(OmegaConf.missing_keys(composed))
        if missing:
            raise UserError("\n".join(f"{key}: a value is needed, give it as {key}=..." for key in missing))
        plain = OmegaConf.to_container(composed, resolve=True, enum_to_str=True)
    except OmegaConfBaseException as error:
        raise UserError(str(error)) from error
    _read_formula(plain)
    team_file = _read_team(plain)
    try:
        config = Config.model_validate(plain)
    except ValidationError as error:
        raise UserError("\n".join(_named(explain_error(item), team_file) for item in error.errors())) from error
    _check_planners(config)
    _check_formula(config)
    _check_team(config)
    if config.belief.adapt and not config.perception.perception().sees_all:
        raise UserError(
            "belief.adapt=true: takes what searches showed for the truth, so it needs perception that does not err; "
            "give belief.adapt=false or leave perception at its defaults"
        )
    return config


def with_overrides(config: Config, overrides: Sequence[str]) -> Config:
    """Return the configuration with ``key=value`` changes; raises `UserError` where one of them is a mistake."""
    changed = OmegaConf.create(config.model_dump(mode="json"))
    changed.merge_with_dotlist(list(overrides))
    return load(changed)


def _read_formula(plain: Any) -> None:
    """Move the text of ``evaluation.formula_file`` to ``evaluation.formula``."""
    options = plain["evaluation"]
    if (path := options.get("formula_file")) is None:
        return
    if options["formula"] is not None:
        raise UserError("evaluation.formula_file: give it or evaluation.formula, not both")
    try:
        options["formula"] = " ".join(absolute(Path(str(path))).read_text(encoding="utf-8").split())
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"evaluation.formula_file={path}: cannot be read ({error})") from error
    options["formula_file"] = None


def _read_team(plain: Any) -> str | None:
    """Move the team in the file ``team.file`` to ``team``, and return the file's name."""
    options = plain["team"]
    if not isinstance(options, dict) or (name := options.get("file")) is None:
        return None
    if options.get("robots"):
        raise UserError("team.file: give it or a team of conf/team, not both")
    path = absolute(Path(str(name)))
    try:
        read = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UserError(f"team.file={name}: cannot be read ({error})") from error
    if not isinstance(read, dict) or not read.get("robots"):
        raise UserError(
            f"team.file={name}: has no robots; list them as in conf/team/mixed.yaml, each with what sets it apart: "
            "robots: [{name: scout, speed_m_per_s: 1.0, handles: []}]"
        )
    plain["team"] = {"name": path.stem, "file": None, **read}
    return str(name)


def _named(message: str, team_file: str | None) -> str:
    """Return what is wrong with a team together with the file that it is from."""
    return f"{team_file}: {message}" if team_file and message.startswith("team") else message


def _check_team(config: Config) -> None:
    """Refuse a team that cannot do what is asked of it, as far as that can be known before the homes are made."""
    team, options = config.team.team(config.robot), config.evaluation
    if team is None:
        return
    from mrtask.execution.team_checks import check_doable, check_types  # import numpy, which few mistakes need

    if max(options.robots) > team.robots:
        have = ",".join(map(str, range(1, team.robots + 1)))
        raise UserError(
            f"evaluation.robots={list(options.robots)}: team {team.name!r} has {counted(team.robots, 'robot')}; "
            f"give evaluation.robots=[{have}], or more robots in the team"
        )
    asked = team.first(max(options.robots))
    for name in dict.fromkeys((*options.planners, *config.optimality.planners)):
        if config.spec(name).planner == PAPERS_PLANNER and any(one.handles is not None for one in asked.members):
            raise UserError(
                f"{name}: the paper's planner does not know robots that cannot handle every object, and team "
                f"{team.name!r} has some; leave it out of evaluation.planners and optimality.planners, or leave out "
                "their `handles`"
            )
    if _only_catalogue(config):
        check_types(team)
    formula = options.formula
    objects: tuple[str, ...] = ()
    if formula is not None:
        from mrtask.tasks.automaton import build_automaton  # imports numpy, which few mistakes need

        objects = build_automaton(formula).propositions
    for robots in options.robots:
        check_doable(team.first(robots), formula, objects)


def _only_catalogue(config: Config) -> bool:
    """Whether all that lies in the homes is from the catalogue."""
    homes = config.homes
    return homes.source == "generated" and homes.contents == "procthor" and not config.evaluation.homes.files


def _check_formula(config: Config) -> None:
    """Refuse a formula that is no task; its objects, as far as they can be known before the homes are made."""
    formula = config.evaluation.formula
    if formula is None:
        return
    from mrtask.tasks.automaton import build_automaton, check_task  # imports numpy, which few mistakes need

    check_task(build_automaton(formula))
    if _only_catalogue(config):
        kinds = [kind for containers in load_catalogue().objects.values() for kind in containers.values()]
        parse(formula, {name for kind in kinds for name in kind["likelihoods"]})


def _check_planners(config: Config) -> None:
    named: dict[str, tuple[str, ...]] = {f"planner_variants.{name}": (name,) for name in config.planner_variants}
    named |= {"evaluation.planners": config.evaluation.planners, "optimality.planners": config.optimality.planners}
    specs = [(key, config.spec(name)) for key, names in named.items() for name in names]
    for key, spec in specs:  # of all, before a compiled search is imported
        _refuse(key, check_planner_name, spec.planner)
    for name in config.planner_variants:
        if name in PLANNERS:
            raise UserError(f"planner_variants.{name}: is a planner's own name; give the variant another")
    for key, spec in specs:
        _refuse(key, spec.make)
    behind = [config.spec(name).planner for name in config.evaluation.planners]
    own = {planner.rsplit(".", 1)[-1] for planner in behind if "." in planner}
    for name in config.planner.keys() - own:
        _refuse("planner", PlannerSpec(name, name, config.planner[name]).make)


def _refuse(key: str, check: Callable[..., object], *arguments: object) -> None:
    """Run a check of what a key says; raises `UserError` with the key's name where it fails."""
    try:
        check(*arguments)
    except ValueError as error:
        raise UserError(f"{key}: {error}") from error


_BOUNDS = {
    "greater_than_equal": "at least {ge}",
    "greater_than": "greater than {gt}",
    "less_than_equal": "at most {le}",
    "less_than": "less than {lt}",
}


def explain_error(item: Any) -> str:
    """Return a pydantic error as ``key=value: what is allowed``."""
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
        expected = context.get("expected", context.get("expected_tags", "")).replace(" or ", ", ")
        words = re.findall("'([^']*)'", expected)
        message = f"{did_you_mean(str(given), words)}allowed: {expected}"
    else:
        message = problem(item)
    # A section that contradicts itself is not repeated: its message names the keys.
    return f"{key}: {message}" if isinstance(given, dict) else f"{key}={_in_short(given)}: {message}"


def _in_short(value: object) -> str:
    text = str(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."


def _suggest_keys(path: list[str]) -> str:
    model: Any = Config
    if path[:2] == ["team", "robots"]:
        return suggest(path[-1], list(NamedRobot.model_fields))
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
    """Return what to say about a key that the configuration does not have."""
    return f"{key}: no such key; {_suggest_keys(key.split('.'))}"


def content_hash(content: object) -> str:
    """Return 16 hex digits of anything made of plain data."""
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
