"""Read YAML files, and report their mistakes with file, line and field."""

import re
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from mrtask.errors import InputError
from mrtask.validation import Place, dotted, first_problem

_NUMBER = re.compile(r"[-+]?((\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|nan|inf)", re.IGNORECASE)
"""Numbers as C++ programs write them. PyYAML follows YAML 1.1 and reads ``1e-05`` and ``-nan`` as text."""


class MapError(InputError):
    """A map or containers file that cannot be used. The message names the file, the line (from 1) and the field."""

    def __init__(self, path: Path, line: int | None, field: str, problem: str) -> None:
        self.path, self.line, self.field, self.problem = path, line, field, problem
        where = path.name if line is None else f"{path.name}, line {line}"
        super().__init__(f"{where}: {f'{field}: ' if field else ''}{problem}")


class Schema(BaseModel):
    """A mapping in the file. A key without a value counts as missing."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _without_empty_keys(cls, values: Any) -> Any:
        if not isinstance(values, dict):
            return values
        return {key: value for key, value in values.items() if value is not None}


_T = TypeVar("_T", bound=Schema)


class YamlFile:
    """A YAML file's data, with the line of each field.

    Raises:
        MapError: the file cannot be read or is not plain YAML.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lines: dict[Place, int] = {}
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise MapError(path, None, "", f"cannot be read ({error})") from None
        try:
            self.data = self._construct(yaml.compose(text, Loader=yaml.SafeLoader), ())
        except yaml.reader.ReaderError as error:
            line = text.count("\n", 0, error.position) + 1
            raise MapError(path, line, "", f"is not YAML (character {error.character!r}: {error.reason})") from None
        except yaml.MarkedYAMLError as error:
            line_of = error.problem_mark or error.context_mark
            raise MapError(
                path, line_of.line + 1 if line_of else None, "", f"is not YAML ({error.problem or error.context})"
            ) from None
        except RecursionError:
            raise MapError(path, None, "", "is nested too deeply, or refers to itself") from None

    def _construct(self, node: yaml.Node | None, place: Place) -> Any:
        if node is None:
            return None
        self._lines[place] = node.start_mark.line + 1
        if isinstance(node, yaml.MappingNode):
            result = {}
            for key_node, value_node in node.value:
                key = str(key_node.value)
                if key in result:
                    raise MapError(self.path, key_node.start_mark.line + 1, key, "is given twice")
                result[key] = self._construct(value_node, (*place, key))
            return result
        if isinstance(node, yaml.SequenceNode):
            return [self._construct(item, (*place, index)) for index, item in enumerate(node.value)]
        written_plainly = isinstance(node, yaml.ScalarNode) and node.style is None
        if written_plainly and node.tag == "tag:yaml.org,2002:str" and _NUMBER.fullmatch(node.value):
            return float(node.value)
        try:
            return yaml.constructor.SafeConstructor().construct_object(node)
        except yaml.MarkedYAMLError as error:
            raise self.error(place, f"{error.problem}; write plain text, numbers and lists") from None
        except (ValueError, OverflowError) as error:
            raise self.error(place, f"'{node.value}' cannot be read ({error})") from None

    def error(self, place: Place, problem: str) -> MapError:
        """Return an error at a field, or at the nearest field above it that the file has."""
        known = place
        while known and known not in self._lines:
            known = known[:-1]
        return MapError(self.path, self._lines.get(known), dotted(place), problem)

    def check(self, schema: type[_T]) -> _T:
        """Return the data as an instance of the schema. Raises `MapError` at the first field that does not fit."""
        try:
            return schema.model_validate(self.data)
        except ValidationError as error:
            place, problem = first_problem(error, self.data)
            if not place and not isinstance(self.data, dict):
                problem = "should hold keys and values, as in `image: floor.pgm`"
            raise self.error(place, problem) from None
