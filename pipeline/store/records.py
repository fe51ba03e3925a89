"""What one stage writes and another reads: one typed, versioned model per file, used by writer and reader alike."""

from typing import ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, ValidationError

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
