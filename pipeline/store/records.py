"""What one stage writes and another reads: one typed, versioned model per file, used by writer and reader alike."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from mrtask.homes.split import HomeSplit
from pipeline.base.config import UserError


class Record(BaseModel):
    """The content of one JSON file. A subclass names its ``version`` and raises it when the meaning changes."""

    model_config = ConfigDict(frozen=True, extra="forbid", protected_namespaces=())

    ADVICE: ClassVar[str] = "run the stage that writes it again"
    """What a user does about a file of another version."""

    version: Literal[1] = 1

    def to_json(self) -> bytes:
        """The file's content."""
        return self.model_dump_json(indent=1).encode()

    @classmethod
    def from_json(cls, content: bytes, path: str) -> Self:
        """The record in a file's content.

        Raises:
            UserError: the content is damaged or of another version; names ``path`` and says what to do.
        """
        try:
            return cls.model_validate_json(content)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"])) or "the file"
            raise UserError(f"{path} cannot be read ({where}: {first['msg']}); {cls.ADVICE}") from error


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
    """The same for the same homes, in whatever files and order."""
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

    model_config = ConfigDict(ser_json_inf_nan="constants")

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
        """What the report says about the model, as plain data; ``version`` is that in the registry."""
        return self.model_dump(mode="json", exclude={"version", "model_version"}) | {"version": self.model_version}
