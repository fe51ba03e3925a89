"""What an evaluation consists of: its episodes, what they share, and the identity that its rows carry."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mrtask.execution.team import RobotSpec
from mrtask.execution.trials import TrialOptions
from mrtask.homes.home import Home
from mrtask.likelihood.table import build_table
from pipeline.backends.tracking import RegisteredModel
from pipeline.base import console
from pipeline.base.config import Config, UserError, content_hash
from pipeline.episodes.worker import Context, EpisodeKey, MapOptions, formula_objects
from pipeline.store.home_files import check_files, count_by_size_class, say_faults
from pipeline.store.home_set import HomeSet
from pipeline.store.version import code_version, source_hash

EPISODES = "episodes"
MANIFEST = "evaluation.json"
IDENTITY = "run.json"
RESULT_SOURCES = ("homes", "maps", "tasks", "likelihood", "planning", "execution")
"""The library packages whose code decides what an episode's row says."""
WITHOUT_EFFECT = {"homes", "model_uri", "episode_timeout_s", "max_failed_fraction", "rerun"}
"""Keys of ``evaluation`` that do not change what a row says, or are recorded by what they led to."""


@dataclass(frozen=True)
class Evaluation:
    """The episodes, all that they share, and where their homes came from."""

    keys: tuple[EpisodeKey, ...]
    context: Context
    identity: Mapping[str, Any]
    homes_facts: Mapping[str, Any]


def check(config: Config) -> None:
    """Refuses what can be refused before any work: the formula and the files."""
    options = config.evaluation
    if options.formula is not None:
        formula_objects(options.formula)
    check_files("evaluation.homes.files", options.homes.files)
    check_files("evaluation.homes.assets", [options.homes.assets])


def prepare(config: Config, home_set: HomeSet, model: RegisteredModel) -> Evaluation:
    """Homes, trials and likelihoods of the evaluation; homes that the model was trained on are left out.

    Raises:
        UserError: a size class has no home.
    """
    options = config.evaluation
    found, facts = _evaluation_homes(config, home_set)
    unseen = tuple(home for home in found if home.id not in model.training_homes)
    if len(unseen) < len(found):
        console.line(f"{len(found) - len(unseen)} evaluation homes left out: the model has seen them in training")
    counts = count_by_size_class(unseen)
    empty = [name for name in options.size_classes if not counts[name]]
    size_classes = tuple(name for name in options.size_classes if counts[name])
    if empty and size_classes and facts["source"] == "ros_map":  # a map has the size that it has
        console.line(f"no {' and no '.join(empty)} map: trials on {', '.join(size_classes)} only")
    elif empty:
        have = ", ".join(f"{count} {name}" for name, count in counts.items())
        raise UserError(
            f"no {' and no '.join(empty)} home to evaluate on ({have}); "
            "give more homes (homes.test, evaluation.homes.files) or other evaluation.size_classes"
        )
    identity = _identity(config, model, unseen)
    objects = formula_objects(options.formula) if options.formula is not None else ()
    context = Context(
        homes=unseen,
        table=build_table(model.model, unseen, objects),
        maps=MapOptions(config.map.resolution_m, config.map.robot_radius_m, config.cache_dir, config.map.ways),
        seed=config.seed,
        trials=TrialOptions(
            templates=options.templates,
            formula=options.formula,
            formula_objects=objects,
            robot=RobotSpec(options.speed_m_per_s, options.search_time_s, options.interact_time_s),
            unsearched_share=options.unsearched_share,
            cost=options.cost,
        ),
        planner_options={name: config.planner_options(name) for name in options.planners},
        planners_behind={name: config.planner_behind(name) for name in options.planners},
        home_order=options.homes.order,
        provenance={
            "model_version": model.version,
            "config_hash": content_hash(identity),
            "code_version": code_version(),
        },
    )
    facts |= {
        "read": len(found),
        "evaluated": len(unseen),
        "by_size_class": counts,
    }
    return Evaluation(episode_keys(config, size_classes), context, identity, facts)


def episode_keys(config: Config, size_classes: Sequence[str]) -> tuple[EpisodeKey, ...]:
    """All episodes; cells take turns, so that what is done at any time is a fair sample of the whole."""
    options = config.evaluation
    return tuple(
        EpisodeKey(size_class, robots, number, planner)
        for number in range(options.trials_per_cell)
        for size_class in size_classes
        for robots in options.robots
        for planner in options.planners
    )


def _identity(config: Config, model: RegisteredModel, evaluated: Sequence[Home]) -> dict[str, Any]:
    """Everything that decides what the rows say; rows of different identities are never mixed in one folder."""
    options = config.evaluation
    ids = [home.id for home in evaluated]
    return {
        "seed": config.seed,
        "map": config.map.model_dump(mode="json"),
        "homes": config.homes.model_dump(mode="json", exclude={"files", "assets", "map", "containers"}),
        "evaluation": options.model_dump(mode="json", exclude=WITHOUT_EFFECT),
        "evaluated_homes": content_hash(ids if options.homes.order == "file" else sorted(ids)),
        "home_order": options.homes.order,
        "planner": {name: config.planner_options(name) for name in options.planners},
        "variant_of": {
            name: config.planner_behind(name) for name in options.planners if name in config.planner_variants
        },
        "model_version": model.version,
        "code": source_hash(*(f"mrtask/{name}" for name in RESULT_SOURCES)),
    }


def _evaluation_homes(config: Config, home_set: HomeSet) -> tuple[tuple[Home, ...], dict[str, Any]]:
    given = config.evaluation.homes
    where, found = home_set.evaluation_homes(given)
    if given.files:
        say_faults(where)
    return found, {
        "source": "procthor" if given.files else config.homes.source,
        "files": [str(path) for path in where.paths],
        "skipped": len(where.faults()),
        "read_from": where.model_dump(mode="json"),
    }
