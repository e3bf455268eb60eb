"""Find, read and validate the TOML files under `problems/`, and others by their path."""

import os
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, TypedDict, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)
from pydantic_core import ErrorDetails

from dpbench.errors import (
    InputError,
    UnknownNameError,
    format_allowed_names,
    format_key_path,
    warn_of_outdated_name,
)
from dpbench.files.regular_files import (
    MOST_DEPTH,
    MOST_TEXT_BYTES,
    DepthError,
    read_bytes,
    refuse_deep_or_huge_values,
)

KINDS = ("vessels", "scenarios", "suites")
SEQUENCES = "sequences"
"""The kind of the recorded sequences, which are `.npz` files beside one TOML file."""
OLD_NAMES = {("suites", "ladder"): "levels"}
"""Old names of shipped files that are still read, with what they are called now."""
# tomllib keeps every beginning of a dotted key: one of 50 000 parts takes 7 GB. Each part is
# matched whole, and from its beginning alone, so that the search takes linear time.
_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![\w-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{MOST_DEPTH}}}")
_PACKAGE = Path(__file__).resolve().parents[1]
_PROSE = ("title", "shows", "source")
"""Entries of a problem file that nothing is computed from."""
ALLOWED = {
    "greater_than": "above {gt:g}",
    "greater_than_equal": "{ge:g} or more",
    "less_than": "below {lt:g}",
    "less_than_equal": "at most {le:g}",
    "string_too_short": "text of {min_length} or more characters",
    "string_too_long": "text of at most {max_length} characters",
    "string_pattern_mismatch": "text that matches {pattern}",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "text",
    "bool_type": "true or false",
    "dict_type": "a table",
    "model_type": "a table",
}
"""Allowed values by the type of a fault of Pydantic; other types keep its own words."""
_ANY_VALUE = {
    "string": "text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "object": "a table",
}
"""Words for any value of a type, by the type in a JSON schema."""
_Model = TypeVar("_Model", bound=BaseModel)


class VesselDocuments(TypedDict, total=False):
    """Contents of a vessel file as plain values, and the vessel's name."""

    vessel_name: str
    vessel: dict[str, Any]


class ScenarioDocuments(VesselDocuments, total=False):
    """Contents of a scenario file and its vessel file as plain values, with their names."""

    name: str
    scenario: dict[str, Any]


class FileModel(BaseModel):
    """Base data model of TOML files that refuses unknown keys and loosely typed values."""

    old_keys: ClassVar[dict[str, str]] = {}
    """Old names of keys that are still read, with what they are called now."""

    refused_keys: ClassVar[dict[str, str]] = {}
    """Old names of keys that are refused, with what they are called now."""

    later_keys: ClassVar[frozenset[str]] = frozenset()
    """Newer keys, not written at their default: older documents stay equal byte for byte."""

    @model_serializer(mode="wrap")
    def _omit_default_keys(self, write: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Return the settings to write to a file, without newer keys at their default value."""
        table: dict[str, object] = write(self)
        fields = type(self).model_fields
        for key in self.later_keys:
            if getattr(self, key) == fields[key].default:
                table.pop(key, None)
        return table

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class KeysError(ValueError):
    """Error from the check of a whole table: what was found and allowed, and the path of the key.

    keys : path from the table to the key; empty where the fault is in no single key.
    """

    def __init__(self, found: str, allowed: str, *keys: str) -> None:
        super().__init__(allowed)
        self.found, self.keys = found, keys


def find_folder_of_shipped_problems() -> Path:
    """Return the folder of the vessels, scenarios, suites and sequences that dpbench ships."""
    installed = _PACKAGE / "problems"
    return installed if installed.is_dir() else _PACKAGE.parent / "problems"


def list_shipped_problem_names(kind: str) -> list[str]:
    """Return the names of the shipped vessels, scenarios, suites or sequences."""
    suffix = ".npz" if kind == SEQUENCES else ".toml"
    return sorted(
        path.stem for path in (find_folder_of_shipped_problems() / kind).glob(f"*{suffix}")
    )


def find_problem_path(kind: str, name: str | Path, beside: Path | None = None) -> Path:
    """Return the path of a vessel, scenario or suite given by name or by path.

    Raises UnknownNameError, with the nearest names, for a name, and InputError for a path.
    """
    text = str(name)
    if (kind, text) in OLD_NAMES:
        warn_of_outdated_name(f"{kind[:-1]} name", text, OLD_NAMES[kind, text])
        text = OLD_NAMES[kind, text]
    if not text.endswith(".toml") and "/" not in text:
        path = find_folder_of_shipped_problems() / kind / f"{text}.toml"
        if os.path.isfile(path):
            return path
        raise make_unknown_problem_name_error(kind, text, "a .toml path")
    for base in ([beside] if beside else []) + [Path()]:
        # Unlike Path.is_file, this is False for a name that is too long to exist.
        if os.path.isfile(base / text):
            return base / text
    instead = "a folder" if os.path.isdir(text) else "no such file"
    raise InputError(text, "", instead, f"a readable {kind[:-1]} file in TOML")


SEQUENCE_SUFFIXES = (".npz", ".json", ".mat")
"""Endings of files of QPs: of dpbench and qpsolvers, acados, the Maros-Meszaros set."""


def resolve_sequence_path(name_or_path: str | Path, beside: Path | None = None) -> Path:
    """Return the path of a QP sequence given by name or by path, which may not exist.

    Raises UnknownNameError for a name that is neither a stored sequence nor a folder.
    """
    text = str(name_or_path)
    if is_shipped_sequence_name(text):
        return find_folder_of_shipped_problems() / SEQUENCES / f"{text}.npz"
    for base in ([beside] if beside else []) + [Path()]:
        # Unlike Path.exists, this is False for a name that is too long to exist.
        if os.path.exists(base / text):
            return base / text
    if "/" not in text and not text.endswith(SEQUENCE_SUFFIXES):
        raise make_unknown_problem_name_error(
            SEQUENCES, text, "a .npz, .json or .mat path, or a folder of QPs"
        )
    return Path(text)


def is_shipped_sequence_name(name: str | Path) -> bool:
    """Return whether a QP sequence of this name is shipped with dpbench."""
    return str(name) in list_shipped_problem_names(SEQUENCES)


def make_unknown_problem_name_error(kind: str, text: str, otherwise: str) -> UnknownNameError:
    """Return an error for an unknown vessel, scenario, suite or sequence name, with near names."""
    listing = "dpbench list vessels" if kind == "vessels" else f"list_{kind}()"
    allowed = format_allowed_names(text, list_shipped_problem_names(kind), listing=listing)
    return UnknownNameError(
        f"{kind[:-1]} name", "", _quote_name(text), f"{allowed}; or {otherwise}"
    )


def make_unknown_qps_name_error(text: str) -> UnknownNameError:
    """Return an error for a name of neither a scenario nor a sequence, with near names of both."""
    known = [*list_shipped_problem_names("scenarios"), *list_shipped_problem_names(SEQUENCES)]
    nearest = format_allowed_names(text, known, listing="list_scenarios()")
    allowed = f"{nearest}, `list_sequences()`; or a .toml or .npz path"
    return UnknownNameError("scenario or sequence name", "", _quote_name(text), allowed)


def _quote_name(text: str) -> str:
    """Return a name in quotes, a long one shortened."""
    return repr(text if len(text) <= 80 else f"{text[:77]}...")


def omit_prose(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a problem file that something is computed from.

    Examples
    --------
    >>> omit_prose({"title": "Calm", "shows": "No weather.", "sample_s": 0.3})
    {'sample_s': 0.3}
    """
    return {key: value for key, value in document.items() if key not in _PROSE}


def read_toml_as_dict(path: Path) -> dict[str, Any]:
    """Return a TOML document as a dict; InputError where it cannot be read or parsed."""
    where, content = str(path), read_bytes(path, "a readable file", most_bytes=MOST_TEXT_BYTES)
    try:
        text = content.decode("utf-8-sig")
        if long := _LONG_KEY.search(text):
            line = text.count("\n", 0, long.start()) + 1
            found = f"a key of more than {MOST_DEPTH} parts"
            raise InputError(where, f"line {line}", found, f"at most {MOST_DEPTH}")
        document = tomllib.loads(text)
        refuse_deep_or_huge_values(document)
    except InputError:
        raise
    except (RecursionError, DepthError) as error:
        found = "tables or arrays nested too deeply"
        raise InputError(where, "", found, f"at most {MOST_DEPTH} levels") from error
    except UnicodeDecodeError as error:
        found = f"0x{content[error.start]:02x}, which is not UTF-8"
        place = f"byte {error.start + 1}"
        raise InputError(where, place, found, "a TOML document in UTF-8") from error
    # Besides TOMLDecodeError a plain ValueError: an integer of thousands of digits.
    except ValueError as error:
        raise InputError(
            where, "", f"invalid TOML ({error})", "a TOML document in UTF-8"
        ) from error
    return document


def read_toml_as_model(path: Path, model: type[_Model]) -> _Model:
    """Return a TOML file as a validated data model; InputError names the faulty key."""
    return validate_settings_as_model(read_toml_as_dict(path), model, str(path))


def validate_settings_as_model(document: dict[str, Any], model: type[_Model], where: str) -> _Model:
    """Return settings as a validated data model; InputError names the faulty key and value."""
    for old, new in getattr(model, "old_keys", {}).items():
        if old in document and new not in document:
            warn_of_outdated_name(where, old, new)
            document = {new if key == old else key: value for key, value in document.items()}
    try:
        return model.model_validate(document)
    except ValidationError as error:
        faults = error.errors(include_url=False)
        # A misspelled required key is both missing and unknown; the second helps more.
        first = next((fault for fault in faults if fault["type"] == "extra_forbidden"), faults[0])
        keys = [str(part) for part in first["loc"]]
        key = format_key_path(first["loc"], is_table=isinstance(first["input"], dict))
        if first["type"] == "extra_forbidden":
            if new := getattr(model, "refused_keys", {}).get(key):
                raise InputError(where, key, "an old name", f"{new}, its new name") from None
            known = _list_allowed_keys_of_nested_table(model, keys[:-1])
            allowed = format_allowed_names(keys[-1], known, listing=getattr(model, "reference", ""))
            raise InputError(where, key, "an unknown key", allowed) from None
        if first["type"] == "missing":
            raise InputError(where, key, "nothing", _describe_any_value(model, first)) from None
        message = _word_allowed_values(model, first)
        value = first["input"]
        found = repr(value)[:200]
        if isinstance(cause := first.get("ctx", {}).get("error"), KeysError):
            found = cause.found[:200]
            key = format_key_path([*first["loc"], *cause.keys], is_table=True)
        elif isinstance(value, dict):
            found = f"keys {', '.join(map(str, value))}" if value else "no keys"
        raise InputError(where, key, found, message) from None


def _word_allowed_values(model: type[BaseModel], fault: ErrorDetails) -> str:
    """Return what is allowed at a faulty key, as a noun where the library has a sentence."""
    if allowed := _find_schema(model, fault).get("allowed"):
        return str(allowed)
    if fault["type"] == "too_short" and isinstance(fault["input"], dict):
        return "a table of {min_length} or more keys".format(**fault["ctx"])
    if fault["type"] in ("list_type", "too_short", "too_long"):
        return _describe_any_value(model, fault)
    if wording := ALLOWED.get(fault["type"]):
        return wording.format(**fault.get("ctx", {}))
    return fault["msg"].removeprefix("Value error, ").removeprefix("Input should be ")


def _find_schema(model: type[BaseModel], fault: ErrorDetails) -> dict[str, Any]:
    """Return the JSON schema of a faulty key; "allowed" in it has words of its own."""
    whole: dict[str, Any] = model.model_json_schema()
    schema = whole
    for key in fault["loc"]:
        others = schema.get("additionalProperties") or {}
        inner = schema.get("properties", {}).get(key, others)
        schema = schema.get("items", {}) if isinstance(key, int) else inner
        schema = next((s for s in schema.get("anyOf", ()) if s.get("type") != "null"), schema)
        if "$ref" in schema:
            schema = whole["$defs"][schema["$ref"].rpartition("/")[2]]
    return schema


def _describe_any_value(model: type[BaseModel], fault: ErrorDetails) -> str:
    """Return the type of value at a faulty key as text, such as "an array of 3 entries"."""
    schema = _find_schema(model, fault)
    if allowed := schema.get("allowed"):
        return str(allowed)
    if "enum" in schema:
        return " or ".join(map(repr, schema["enum"]))
    if schema.get("type") != "array":
        return _ANY_VALUE.get(schema.get("type", ""), "a value")
    if "$ref" in schema.get("items", {}):
        table = ".".join(key for key in fault["loc"] if isinstance(key, str))
        return f"an array of tables, each below [[{table}]]"
    least, most = schema.get("minItems", 0), schema.get("maxItems")
    if most is None:
        return f"an array of {least} or more entries" if least else "an array"
    return f"an array of {most} entries" if least == most else f"an array of {least} to {most}"


def _list_allowed_keys_of_nested_table(model: type[BaseModel], keys: list[str]) -> list[str]:
    """Return the keys that a data model allows in the nested table at a path of keys."""
    current: Any = model
    for key in keys:
        field = current.model_fields.get(key) if hasattr(current, "model_fields") else None
        if field is None:
            continue
        candidates = [field.annotation, *getattr(field.annotation, "__args__", ())]
        current = next((c for c in candidates if hasattr(c, "model_fields")), current)
    return list(current.model_fields)
