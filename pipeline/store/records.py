"""The files that one stage writes and another reads: one typed, versioned model each, for writer and reader alike."""

import platform
from collections.abc import Collection, Iterable, Mapping
from itertools import product
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import psutil
from pydantic import BaseModel, ConfigDict, JsonValue, ValidationError

from mrtask.errors import without_secrets
from mrtask.execution.trials import trial_id
from mrtask.homes.split import HomeSplit
from mrtask.names import counted
from pipeline.base.config import UserError, content_hash
from pipeline.base.sections import Map
from pipeline.base.values import Section
from pipeline.store.folder import Folder
from pipeline.store.home_files import HomeFiles
from pipeline.store.rows import Key, differences

JsonObject = Mapping[str, JsonValue]
"""A part of the configuration, kept as it was."""


class RecordError(UserError):
    """A file that is damaged or of another version."""


class Record(BaseModel):
    """The content of one JSON file. A subclass names its ``version`` and raises it when the meaning changes."""

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=(), ser_json_inf_nan="constants")

    ADVICE: ClassVar[str] = "run the stage that writes it again"
    """What a user should do about a file of another version."""

    version: Literal[1] = 1

    def to_json(self) -> bytes:
        """Return the file's content, in which addresses have no secrets."""
        return without_secrets(self.model_dump_json(indent=1)).encode()

    @classmethod
    def from_json(cls, content: bytes, path: str) -> Self:
        """Return the record in a file's content.

        Raises:
            RecordError: the content is damaged or of another version; the message names ``path`` and says what to do.
        """
        try:
            return cls.model_validate_json(content)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"])) or "the file"
            raise RecordError(f"{path} cannot be read ({where}: {first['msg']}); {cls.ADVICE}") from error

    @classmethod
    def read(cls, folder: Folder, name: str) -> Self | None:
        """Return the record in a file of a folder, None where there is no such file; raises what `from_json` does."""
        content = folder.read(name)
        return None if content is None else cls.from_json(content, str(folder / name))

    @classmethod
    def find(cls, folder: Folder, name: str) -> Self | None:
        """Return the record in a file of a folder; None where this version can read none and must make it."""
        try:
            return cls.read(folder, name)
        except RecordError:
            return None

    def write(self, folder: Folder, name: str) -> None:
        """Write the record as a file of a folder."""
        folder.write(name, self.to_json())


class GeneratedHousesManifest(Record):
    """``datasets/generated/<key>``: how many houses the generator made, from which seed, by which code."""

    seed: int
    houses: int
    code_version: str


class HomesManifest(Record):
    """``datasets/homes/<source>-<key>``: homes that were read without a fault and split."""

    source: str
    files: tuple[Path, ...]
    seed: int
    code_version: str
    content_hash: str
    """Equal for equal homes, in whatever files and order."""
    homes: int
    skipped: int
    """How many faulty homes were left out."""
    faults: tuple[str, ...]
    """The first of them: file, number, field and what is wrong."""
    by_size_class: Mapping[str, int]
    containers: int
    split: HomeSplit
    """The ids of the homes of each part."""


class TrainedModelRecord(Record):
    """``datasets/models/<kind>-<key>``: a model that was trained here, and the version it has in MLflow's registry."""

    name: str
    model_version: str
    kind: str
    embedding: str
    champion: bool
    """Whether it became champion when it was registered."""
    training_homes: int
    test_homes: int
    metrics: Mapping[str, float]
    """On the test homes."""
    frequency_metrics: Mapping[str, float]
    """Those of the frequency table on the same homes."""
    beats_frequency: bool
    """By its log loss."""
    note: str
    """Why it became champion, or why not."""
    dataset: str
    """The content hash of the rows it was trained on."""
    tracking_uri: str
    run_id: str
    key: str
    """The hash of all that the training depends on."""

    def facts(self) -> dict[str, Any]:
        """Return what the report says about the model, as plain data; ``version`` is that in the registry."""
        return self.model_dump(mode="json", exclude={"version", "model_version"}) | {"version": self.model_version}


def _listed(words: Iterable[str]) -> str:
    """``a, b and c``."""
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last


class Asked(Section):
    """The episodes that a command asked for: each of these planners on each of these trials."""

    since: str
    """When they were first asked for."""
    planners: tuple[str, ...]
    size_classes: tuple[str, ...]
    robots: tuple[int, ...]
    trials_per_cell: int

    def row_keys(self) -> set[Key]:
        """Return the keys of their rows."""
        trials = product(self.size_classes, self.robots, range(self.trials_per_cell))
        return {(trial_id(*trial), planner) for trial in trials for planner in self.planners}

    @property
    def text(self) -> str:
        """``100 trials a cell, small and large, 1 and 2 robots, by greedy and pouct``."""
        sizes, teams, planners = (_listed(map(str, of)) for of in (self.size_classes, self.robots, self.planners))
        plural = "" if self.robots == (1,) else "s"
        return f"{counted(self.trials_per_cell, 'trial')} a cell, {sizes}, {teams} robot{plural}, by {planners}"


class RunIdentity(Record):
    """Everything that decides the rows' content; rows of different identities are never mixed in one folder.

    A run grows when it is asked for more. That changes no existing row: a trial depends only on its cell and number, a
    planner's episode on the trial and the planner's own options.
    """

    ADVICE = "give another output_dir, or overwrite=true to start anew there"
    BY_PLANNER: ClassVar[tuple[str, ...]] = ("planner", "behind", "likelihood")
    """The parts that each concern one planner."""

    version: Literal[2] = 2  # type: ignore[assignment]
    seed: int
    map: Map
    homes: JsonObject
    evaluation: JsonObject
    """Everything else that decides the trials, the same for all of them."""
    evaluated_homes: str
    """A hash of their ids."""
    planner: Mapping[str, JsonObject]
    """The options of each planner."""
    behind: Mapping[str, str]
    """The planner that each name stands for."""
    likelihood: Mapping[str, JsonObject]
    """The likelihoods that each planner plans with."""
    model_version: str
    code: str
    """A hash of the sources that decide a row."""
    asked: tuple[Asked, ...]
    """What the run was asked for, command by command, where a command asked for something new."""

    def content(self, planners: Collection[str] | None = None) -> dict[str, Any]:
        """Return, as plain data, what decides the rows of these planners, by default of all."""
        content = self.model_dump(mode="json", exclude={"version", "asked"})
        for part in self.BY_PLANNER:
            content[part] = {name: one for name, one in content[part].items() if planners is None or name in planners}
        return content

    def config_hash(self, planner: str | None = None) -> str:
        """Return the hash that a planner's rows carry; without a planner, the hash of everything."""
        return content_hash(self.content(None if planner is None else [planner]))

    def likelihood_of(self, planner: str) -> dict[str, Any]:
        """Return which likelihoods a planner plans with."""
        common: Any = self.evaluation["likelihood"]
        return {**common, **{key: one for key, one in self.likelihood[planner].items() if one is not None}}

    def conflicts(self, other: Self) -> list[str]:
        """Return what would change in rows that both have: ``key: was ..., now ...``; empty where they agree."""
        both = self.planner.keys() & other.planner.keys()
        return list(differences(self.content(both), other.content(both)))

    def row_keys(self) -> set[Key]:
        """Return the keys of all rows that were asked for."""
        return {key for one in self.asked for key in one.row_keys()}

    def joined(self, other: Self) -> Self:
        """Return this identity grown by what the other asks for; itself where that is nothing new."""
        known, more = self.row_keys(), []
        for one in other.asked:
            if not one.row_keys() <= known:
                more.append(one)
                known |= one.row_keys()
        if not more:
            return self
        parts = {name: {**getattr(self, name), **getattr(other, name)} for name in self.BY_PLANNER}
        return self.model_copy(update={**parts, "asked": (*self.asked, *more)})


class EvaluatedHomes(Section):
    """The homes that planners were evaluated on."""

    source: str
    files: tuple[Path, ...]
    read_from: HomeFiles
    """Reads the same homes again, for drawings."""
    skipped: int
    """How many faulty homes were left out."""
    read: int
    evaluated: int
    """How many of them the model had not seen."""
    by_size_class: Mapping[str, int]


class Reach(Section):
    """How many containers the evaluated homes have, and how many of them a robot can reach."""

    containers: int
    reachable: int

    @property
    def share(self) -> float:
        """The part that can be reached."""
        return self.reachable / self.containers


class Machine(Section):
    """What the driver ran on."""

    cpus: int
    """How many episodes ran at a time."""
    memory_gb: float
    platform: str
    python: str

    @classmethod
    def here(cls, cpus: int) -> Self:
        """Return the machine that this process runs on."""
        return cls(
            cpus=cpus,
            memory_gb=round(psutil.virtual_memory().total / 2**30, 1),
            platform=platform.platform(),
            python=platform.python_version(),
        )


class EvaluationManifest(Record):
    """A finished evaluation: what the report says about the run in addition to its episodes."""

    ADVICE = "run python -m pipeline.evaluate with the same output_dir again"

    experiment: str
    seed: int
    output_dir: str
    planners: tuple[str, ...]
    planner_options: Mapping[str, JsonObject]
    expected_episodes: int
    config: JsonObject
    """The whole configuration."""
    model_version: str
    config_hash: str
    code_version: str
    model: TrainedModelRecord | None
    """None for a model that was trained elsewhere."""
    model_name: str
    champion_version: str | None = None
    """The version that was champion meanwhile; None where there was none, and in manifests of earlier versions."""
    rivals: tuple[TrainedModelRecord, ...] = ()
    """The versions that the same command trained, and that did not plan."""
    homes: EvaluatedHomes
    true_likelihoods: Literal["drawn", "counted"] | None = None
    """Whether the true likelihoods are those by which the homes' contents were drawn, or the counts of these homes.

    None in manifests of earlier versions."""
    reach: Reach
    reliability: tuple[JsonObject, ...] = ()
    """How often objects were where the model said: the bins of `mrtask.analysis.studies.calibration`.

    Empty in manifests of earlier versions."""
    machine: Machine
    packages: Mapping[str, str] = {}
    """The versions of what computed the rows; empty for runs from before they were recorded."""
    peak_memory_mb: float | None
    """Of the worker that needed most."""
    started: str
    wall_s: float
    run_id: str
    """The MLflow run."""
    sweep: str
    """The cell's values of the swept keys: ``planner.pouct.samples=100``; empty outside sweeps."""

    def facts(self, stages: "StageTimes | None" = None) -> dict[str, Any]:
        """Return what the report shows, as plain data by the names that `mrtask.analysis.report.run_facts` knows."""
        nested = {"version", "model", "model_name", "champion_version", "rivals", "homes", "reach"}
        homes = self.homes.model_dump(mode="json") | {
            "training": self.model.training_homes if self.model else None,
            "containers": self.reach.containers,
            "reachable_share": self.reach.share,
        }
        facts = self.model_dump(mode="json", exclude=nested) | {
            "model": (self.model.facts() if self.model else {"name": self.model_name, "version": self.model_version})
            | {"champion_version": self.champion_version},
            "rivals": [rival.facts() for rival in self.rivals],
            "homes": homes,
        }
        return facts | ({"stages": dict(stages.seconds)} if stages else {})


class RunProgress(Record):
    """How far an evaluation is, for `pipeline.status` on any machine."""

    state: Literal["running", "finished", "interrupted", "failed"]
    by: str
    """Which process runs it, and where."""
    started: float
    """Unix time of the command's first episode."""
    updated: float
    """Unix time of this record."""
    done: int
    total: int
    """How many episodes there are of those that the command asked for, and how many it asked for."""
    began_with: int
    """How many of them were there before the command."""
    workers: int
    note: str
    """What the progress line says besides."""
    last_error: str = ""
    """The last episode that ended with an exception or a timeout, and why."""
    message: str = ""
    """Why the run failed."""

    @property
    def per_s(self) -> float:
        """Episodes a second since the command began; 0 where none has finished."""
        return (self.done - self.began_with) / max(self.updated - self.started, 1e-9)


class StageTimes(Record):
    """How long the stages of a whole experiment took."""

    seconds: Mapping[str, float]


class ReportKey(Record):
    """The hash of all that a report depends on, kept beside the report."""

    key: str
