"""Prepares an evaluation: the registered model, homes that it has not seen, and the plan of all episodes."""

from pipeline.backends import registry, runs
from pipeline.backends.pool import Pool
from pipeline.backends.registry import RegisteredModel
from pipeline.base.config import Config
from pipeline.episodes.plan import EvaluationPlan, check, plan_evaluation
from pipeline.inputs import homes
from pipeline.store.artifacts import NotMade
from pipeline.store.folder import Folder
from pipeline.store.layout import IDENTITY
from pipeline.store.records import RunIdentity


def prepare(config: Config, pool: Pool) -> EvaluationPlan:
    """Return the plan of the configured evaluation; a dry run finds the homes, any other makes them if need be.

    Raises:
        NotMade: homes or model of a dry run do not exist yet.
        UserError: the evaluation cannot be run as configured.
    """
    check(config.evaluation)
    model = load_model(config)
    maker = None if config.dry_run else pool
    home_set = homes.make(config.homes, config.contents, config.datasets_dir, maker)
    return plan_evaluation(config, home_set, model)


def load_model(config: Config) -> RegisteredModel:
    """Return the configured model; for a run that is continued, the version that it began with."""
    if config.dry_run and runs.is_new(config.tracking.uri):
        raise NotMade("no model is registered yet; python -m pipeline.train trains one")
    tracking = runs.open_tracking(config.tracking.uri, config.tracking.experiment_name)
    begun = None if config.overwrite else RunIdentity.read(Folder(config.output_dir), IDENTITY)
    uri = config.evaluation.model_uri
    if begun is not None and uri == registry.CHAMPION_URI:
        uri = registry.version_uri(begun.model_version)
    return registry.load_registered(tracking, uri, config.cache_dir)
