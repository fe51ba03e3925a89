"""Write docs/configuration.md from the schema (pipeline/base/config.py) and from the defaults and comments in conf/.

python docs/configuration_reference.py > docs/configuration.md
"""

import re
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import yaml
from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from pipeline.base.config import UNIONS, Config

CONF = Path(__file__).resolve().parents[1] / "conf"
HEAD = """# Configuration

This page lists every key with its allowed values and its default. `docs/configuration_reference.py` makes it from the
schema and from `conf/`. You can give any key on the command line of any stage: `evaluation.robots=[1,2]`. A wrong key
or value is refused before any work starts, with what is allowed. `--help` shows all keys with their values.

Groups are chosen by name and bring their own keys: `homes=procthor`, `model=mlp`, `cluster=existing`,
`experiment=smoke`.
"""
BOUNDS = {Ge: ("at least", "ge"), Gt: ("above", "gt"), Le: ("at most", "le"), Lt: ("below", "lt")}
NAMES = {
    int: "whole number",
    float: "number",
    str: "text",
    bool: "`true`, `false`",
    Path: "path",
    type(None): "`null`",
}
COMMENT, KEY = re.compile(r"^( *)# ?(.*)$"), re.compile(r"^( *)([a-z_0-9]+):")


def main() -> None:
    """Print the page."""
    sys.stdout.write(page())


def page() -> str:
    """Return the whole page."""
    top = _defaults(CONF / "config.yaml")
    parts = [HEAD, "## Top level\n", _table(Config, top, "")]
    for name, field in Config.model_fields.items():
        if name in UNIONS:
            parts += _union(name, field)
        elif name == "planner":
            parts.append(_planner())
        elif (model := _model_of(field.annotation)) is not None:
            found = CONF / name / "default.yaml"
            path = found if found.is_file() else CONF / name / "local.yaml"
            known = _defaults(path) if path.is_file() else top
            parts += [f"## {name}\n", f"{_first_line(model)}\n", _table(model, known, name)]
            parts += [_table_of_section(model, known, name)]
    return "\n".join(part for part in parts if part).rstrip() + "\n"


def _union(name: str, field: FieldInfo) -> Iterator[str]:
    yield f"## {name}\n"
    kinds = {_kind(model): model for model in _members(field.annotation)}
    for path in sorted((CONF / name).glob("*.yaml")):
        defaults = _defaults(path)
        if not {"source", "kind"} & defaults.keys():  # it chooses another file of the group and sets keys elsewhere
            yield f"### {name}={path.stem}\n\n{_file_comment(path)}\n"
            continue
        chosen = str(defaults["source" if "source" in defaults else "kind"][0])
        model = next(model for kind, model in kinds.items() if chosen in kind)
        yield f"### {name}={path.stem}\n"
        yield f"{_file_comment(path) or _first_line(model)}\n"
        yield _table(model, defaults, name)


def _planner() -> str:
    lines = ["## planner\n", "Options by planner. Your own planner takes its own options, under its class's name.\n"]
    lines += ["| key | default | |", "|---|---|---|"]
    for name, options in yaml.safe_load((CONF / "planner" / "default.yaml").read_text()).items():
        comments = _comments(CONF / "planner" / "default.yaml")
        for option, value in options.items():
            lines.append(f"| `planner.{name}.{option}` | `{_shown(value)}` | {comments.get(f'{name}.{option}', '')} |")
    return "\n".join(lines) + "\n"


def _table(model: type[BaseModel], defaults: dict[str, tuple[Any, str]], prefix: str) -> str:
    rows = []
    for name, field in model.model_fields.items():
        if _model_of(field.annotation) is not None or name in UNIONS or name == "planner":
            continue
        default, comment = defaults.get(name, ("", ""))
        key = f"{prefix}.{name}" if prefix else name
        rows.append(f"| `{key}` | {_type(field)} | {f'`{_shown(default)}`' if default != '' else ''} | {comment} |")
    return "\n".join(["| key | allowed | default | |", "|---|---|---|---|", *rows]) + "\n" if rows else ""


def _table_of_section(model: type[BaseModel], defaults: dict[str, tuple[Any, str]], prefix: str) -> str:
    """Return the tables of the sections within a section."""
    parts = []
    for name, field in model.model_fields.items():
        if (inner := _model_of(field.annotation)) is not None:
            values = defaults.get(name, ({}, ""))[0]
            known = {key: (value, defaults.get(f"{name}.{key}", ("", ""))[1]) for key, value in values.items()}
            parts.append(_table(inner, known, f"{prefix}.{name}"))
    return "\n".join(parts)


def _defaults(path: Path) -> dict[str, tuple[Any, str]]:
    """Map each key to its default and the comment above it."""
    values, comments = yaml.safe_load(path.read_text()) or {}, _comments(path)
    known = {name: (value, comments.get(name, "")) for name, value in values.items()}
    for name, value in values.items():
        if isinstance(value, dict):
            known |= {f"{name}.{key}": (one, comments.get(f"{name}.{key}", "")) for key, one in value.items()}
            known |= {key: (one, comments.get(f"{name}.{key}", "")) for key, one in value.items() if key not in known}
    return known


def _comments(path: Path) -> dict[str, str]:
    """Map each dotted key to the comment lines right above it."""
    above: list[str] = []
    parent, found = "", {}
    for number, line in enumerate(path.read_text().splitlines()):
        if comment := COMMENT.match(line):
            above.append(comment[2])
            continue
        if key := KEY.match(line):
            name = f"{parent}.{key[2]}" if key[1] else key[2]
            if above and number - len(above) > 0:
                found[name] = _escaped(" ".join(above))
            parent = parent if key[1] else key[2]
        above = []
    return found


def _file_comment(path: Path) -> str:
    lines = []
    for line in path.read_text().splitlines():
        if not line.startswith("#"):
            break
        if "@package" not in line:
            lines.append(line.removeprefix("#").strip())
    return _escaped(" ".join(lines))


def _escaped(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;")


def _first_line(model: type[BaseModel]) -> str:
    return (model.__doc__ or "").partition("\n")[0]


def _kind(model: type[BaseModel]) -> tuple[str, ...]:
    field = model.model_fields["source" if "source" in model.model_fields else "kind"]
    return tuple(get_args(field.annotation))


def _members(annotation: Any) -> tuple[type[BaseModel], ...]:
    return tuple(get_args(annotation))


def _model_of(annotation: Any) -> type[BaseModel] | None:
    return annotation if isinstance(annotation, type) and issubclass(annotation, BaseModel) else None


def _type(field: FieldInfo) -> str:
    return _escaped(_described(field.annotation, field.metadata))


def _described(annotation: Any, metadata: list[Any] | tuple[Any, ...] = ()) -> str:
    origin = get_origin(annotation)
    if origin is Annotated:
        inner, *more = get_args(annotation)
        flat = [one for item in more for one in (item.metadata if isinstance(item, FieldInfo) else [item])]
        return _described(inner, [*metadata, *flat])
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in get_args(annotation))
    if origin in (Union, types.UnionType):
        return " or ".join(
            _described(part, metadata if part is not type(None) else ()) for part in get_args(annotation)
        )
    if origin is tuple:
        return f"list of {_described(get_args(annotation)[0])}"
    bounds = [
        f"{words} {getattr(one, attribute):g}"
        for one in metadata
        for kind, (words, attribute) in BOUNDS.items()
        if isinstance(one, kind)
    ]
    bounds += ["not empty" for one in metadata if isinstance(one, MinLen) and annotation is str]
    return " ".join([NAMES.get(annotation, getattr(annotation, "__name__", "text")), *bounds])


def _shown(value: Any) -> str:
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return f"{len(value)} of them, in conf/"
    if isinstance(value, list):
        return "[" + ", ".join(map(str, value)) + "]"
    return "null" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


if __name__ == "__main__":
    main()
