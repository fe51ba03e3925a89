"""The options that tools on one map share, and what they lead to: the home, its map, the likelihood model."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field, model_validator

from mrtask.execution.team_spec import RobotSpec
from mrtask.files import default_cache_dir
from mrtask.homes.home import Home
from mrtask.likelihood.catalogue_model import catalogue_model
from mrtask.likelihood.model import LikelihoodModel
from mrtask.maps.cache import cached_map
from mrtask.maps.home_map import HomeMap
from mrtask.planning.planners import make_planner
from pipeline.base.config import CONF_DIR, UserError
from pipeline.base.sections import MODEL_URI, MODEL_URIS
from pipeline.base.values import LocalPath, Positive, Section, spelled

SCENARIOS = CONF_DIR / "scenario"
CATALOGUE, UNIFORM = "catalogue", "uniform"

Coordinates = Annotated[tuple[float, float], Field(strict=False)]
Existing = Annotated[LocalPath, AfterValidator(lambda path: _existing(path))]


def _existing(path: Path) -> Path:
    if not path.is_file():
        raise ValueError(f"no such file: {path}")
    return path


class MapTask(Section):
    """A map, a task in words and a team; ``conf/scenario.yaml`` explains each key."""

    name: str | None
    map: Existing
    containers: Existing
    task: str = Field(min_length=1)
    objects: tuple[str, ...]
    likelihood: Annotated[str, spelled(f"catalogue|uniform|{MODEL_URI}", f"catalogue, uniform, {MODEL_URIS}")]
    tracking_uri: str = Field(min_length=1)
    speed_m_per_s: float = Field(gt=0)
    search_time_s: float = Field(ge=0)
    interact_time_s: float = Field(ge=0)
    resolution_m: float = Field(gt=0, le=1)
    robot_radius_m: float = Field(ge=0, le=2)
    seed: int = Field(ge=0)
    planner: dict[str, dict[str, Any]]

    @model_validator(mode="before")
    @classmethod
    def _all_given(cls, values: Any) -> Any:
        missing = [key for key in ("map", "containers", "task") if values.get(key) is None]
        if missing:
            raise ValueError(
                f"a value is needed for {', '.join(missing)}, as in map=lab.yaml containers=containers.yaml "
                f'task="pillow and remote"; or name=, one of {", ".join(scenario_names())}'
            )
        return values

    @property
    def spec(self) -> RobotSpec:
        """The robots' speed and times."""
        return RobotSpec(self.speed_m_per_s, self.search_time_s, self.interact_time_s)

    def map_of(self, home: Home, radius_m: float | None = None) -> HomeMap:
        """Return the home's map, from the cache if it is there; for robots of another radius, theirs."""
        radius_m = self.robot_radius_m if radius_m is None else radius_m
        return cached_map(home, default_cache_dir() / "maps", self.resolution_m, radius_m)

    def model(self) -> LikelihoodModel | None:
        """Return the likelihood model, None for ``uniform``; raises `InputError` where a registered one is unusable."""
        if self.likelihood == UNIFORM:
            return None
        if self.likelihood == CATALOGUE:
            return catalogue_model()
        from pipeline.backends import registry, runs  # MLflow takes seconds to import

        return registry.load_registered(runs.open_tracking(self.tracking_uri, "mrtask"), self.likelihood).model


class ScenarioOptions(MapTask):
    """The options of `pipeline.scenario`."""

    robots: Positive
    start: Coordinates | None
    planners: tuple[str, ...] = Field(min_length=1)
    seeds: Positive
    drawn_worlds: int = Field(ge=0)
    output_dir: LocalPath
    published: str | None

    @model_validator(mode="after")
    def _known_planners(self) -> Self:
        for name in self.planners:
            make_planner(name, self.options_of(name))
        return self

    def options_of(self, planner: str) -> dict[str, Any]:
        """Return the options of a planner; those of a planner of your own stand under its class's name."""
        return self.planner.get(planner.rsplit(".", 1)[-1], {})


def scenario_names() -> list[str]:
    """Return the names of the scenarios that come with the project."""
    return sorted(path.parent.name for path in SCENARIOS.glob("*/scenario.yaml"))


def scenario_files(given: dict[str, Any], defaults: str) -> Sequence[Path]:
    """Return the files with the options' defaults: ``conf/<defaults>``, then those of the scenario called ``name``.

    This adds the paths of the scenario's map and containers to ``given``, unless it has others.

    Raises:
        UserError: there is no such scenario.
    """
    files = [CONF_DIR / defaults]
    if (name := given.get("name")) is not None:
        if name not in scenario_names():
            raise UserError(f"name={name}: no such scenario; allowed: {', '.join(scenario_names())}")
        folder = SCENARIOS / str(name)
        files.append(folder / "scenario.yaml")
        given.setdefault("map", str(folder / "map.yaml"))
        given.setdefault("containers", str(folder / "containers.yaml"))
    return files
