"""The reference of TOML keys, from the models that read them.

What a key means is the text below it in the model; type, bounds and default are pydantic's own.
The pages are stored in `docs/reference`, so that guides can link to them; `make keys` writes them.
"""

import ast
import inspect
import json
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from dpbench.bench.plan.suite import SuiteFile
from dpbench.scenario.problem_files import FileModel
from dpbench.scenario.tables.scenario_file import ScenarioFile
from dpbench.scenario.tables.vessel_file import VesselFile
from sitegen.markup import code, prose, table

FILES: dict[str, type[FileModel]] = {
    "vessel": VesselFile,
    "scenario": ScenarioFile,
    "suite": SuiteFile,
}
BEYOND_ANY_SHIP = 1e15
"""Bounds as large as this only catch slips of the keyboard."""
BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
TYPES = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true, false"}
NESTED = "tables within tables"
Schema = Mapping[str, Any]


@dataclass(frozen=True)
class Section:
    """A table of a file: its header as written in TOML, "" for the top, and its model."""

    header: str
    model: type[FileModel]


def pages() -> dict[str, str]:
    """Markdown by file of the documentation."""
    return {f"reference/{kind}.md": _page(kind, model) for kind, model in FILES.items()}


def sections(model: type[FileModel], path: str = "", header: str = "") -> Iterator[Section]:
    """The tables of a file, each before those within it."""
    yield Section(header, model)
    for name, field in model.model_fields.items():
        inner = _table_of(field)
        if inner is not None:
            below = f"{path}{name}"
            many = "list" in str(field.annotation)
            yield from sections(inner, f"{below}.", f"[[{below}]]" if many else f"[{below}]")


@cache
def meanings(model: type[FileModel]) -> dict[str, str]:
    """The text below each key, in the model or in one it is made from."""
    texts: dict[str, str] = {}
    for cls in reversed(model.__mro__):
        if not issubclass(cls, FileModel) or cls is FileModel:
            continue
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
        assert isinstance(body, ast.ClassDef)
        for key, text in zip(body.body, body.body[1:], strict=False):
            if isinstance(key, ast.AnnAssign) and isinstance(text, ast.Expr):
                assert isinstance(key.target, ast.Name)
                texts[key.target.id] = inspect.cleandoc(ast.literal_eval(text.value))
    return texts


def _page(kind: str, model: type[FileModel]) -> str:
    parts = [
        f"# Keys of a {kind} file\n",
        f"These are the keys of `problems/{kind}s/*.toml` and of your files. An unknown key is an "
        "error; `dpbench check FILE.toml` names the first one.\n",
    ]
    for section in sections(model):
        parts.append(f"## {code(section.header) or 'Top of the file'}\n")
        if section.header:
            summary = (inspect.getdoc(section.model) or "").split("\n\n")[0]
            parts.append(f"{prose(summary)}\n")
        parts.append(_keys(section.model))
    return "\n".join(parts)


def _keys(model: type[FileModel]) -> str:
    schema = model.model_json_schema()
    texts = meanings(model)
    rows = []
    for name, field in model.model_fields.items():
        kind, allowed = _read(schema["properties"][name])
        rows.append((code(name), kind, allowed, _default(field), prose(texts.get(name, ""))))
    return table(("key", "type", "allowed", "default", "meaning"), rows)


def _table_of(field: FieldInfo) -> type[FileModel] | None:
    """The model of a key that holds a table or tables; None for a value."""
    for kind in (field.annotation, *get_args(field.annotation)):
        if inspect.isclass(kind) and issubclass(kind, FileModel):
            return kind
    return None


def _read(schema: Schema) -> tuple[str, str]:
    """Type and bounds of a value, in words."""
    if "anyOf" in schema:
        given = [option for option in schema["anyOf"] if option.get("type") != "null"]
        return _read(given[0]) if len(given) == 1 else ("value", "")
    if "$ref" in schema:
        return "table", ""
    if "enum" in schema or "const" in schema:
        values = schema.get("enum") or [schema["const"]]
        return "text", ", ".join(code(str(value)) for value in values)
    if schema["type"] == "array":
        return _read_list(schema)
    if schema["type"] == "object":
        inner, allowed = _read(schema["additionalProperties"])
        if inner == NESTED or inner.startswith("keys"):
            return NESTED, allowed
        return f"keys, each with {'' if inner[0].isdigit() else 'a '}{inner}", allowed
    bounds = (
        f"{sign} {schema[key]:g}"
        for key, sign in BOUNDS.items()
        if key in schema and abs(schema[key]) < BEYOND_ANY_SHIP
    )
    return TYPES[schema["type"]], ", ".join(bounds)


def _read_list(schema: Schema) -> tuple[str, str]:
    inner, allowed = _read(schema["items"])
    if inner == "table":
        return "tables", ""
    least, most = schema.get("minItems"), schema.get("maxItems")
    if least is not None and least == most:
        return f"{least} × {inner}", allowed
    plural = inner if inner == "text" or inner[0].isdigit() else f"{inner}s"
    return f"list of {plural}", ", ".join(filter(None, (allowed, least and f"at least {least}")))


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "**required**"
    if field.default is None or isinstance(field.default, BaseModel) or field.default == []:
        return ""
    return code(json.dumps(field.default))


def write_pages(docs: Path) -> None:
    """Write the pages into the folder of the documentation."""
    for name, text in pages().items():
        (docs / name).parent.mkdir(exist_ok=True)
        (docs / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_pages(Path(__file__).parents[1])
