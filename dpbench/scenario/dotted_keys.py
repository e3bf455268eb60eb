"""Values of a scenario's files by the dotted names of their keys.

A key is named as in the files, with dots: `environment.wind.speed_mps`, `start.east_m`,
`controller.output_weight.0` for an entry of a list; `vessel` is the ship by name, and
`vessel.limits.rate_max_N_per_s.1` a key of its file.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast, get_args

from dpbench.errors import InputError, SituationError, format_allowed_names
from dpbench.scenario.problem_files import (
    FileModel,
    ScenarioDocuments,
    VesselDocuments,
    find_problem_path,
    read_toml_as_model,
)
from dpbench.scenario.tables.scenario_file import ScenarioFile
from dpbench.scenario.tables.vessel_file import VesselFile

Model = type[FileModel] | None
"""Model of a table in a document; None of a table with free keys, and of other values."""
VESSEL = "vessel"
MODELS: dict[str, Model] = {"scenario": ScenarioFile, VESSEL: VesselFile}


def read_validated_vessel_documents(
    name_or_path: str | Path, *, beside: Path | None = None
) -> VesselDocuments:
    """Return name and plain values of a vessel file, given by name or path, once validated."""
    path = find_problem_path("vessels", name_or_path, beside)
    return {"vessel_name": path.stem, "vessel": read_toml_as_model(path, VesselFile).model_dump()}


def copy_documents_with_values(
    files: ScenarioDocuments,
    values: Mapping[str, object],
    where: str,
    *,
    beside: Path | None = None,
) -> ScenarioDocuments:
    """Return a scenario's file contents with values of dotted keys replaced, not validated."""
    changed: dict[str, Any] = {**files}
    for key, value in values.items():
        if key == VESSEL:
            changed |= read_validated_vessel_documents(str(value), beside=beside)
    for key, value in values.items():
        if key != VESSEL:
            file, parts = _split_key(key)
            changed[file] = _copy_table_with_value(
                changed[file], parts, value, f"{where}: {key}", MODELS[file]
            )
    return cast(ScenarioDocuments, changed)


def read_value_of_dotted_key(files: ScenarioDocuments, key: str, where: str) -> object:
    """Return the value of a dotted key in a scenario's files; InputError without such a key."""
    if key == VESSEL:
        return files["vessel_name"]
    file, parts = _split_key(key)
    at: Any = cast(dict[str, Any], files)[file]
    model: Model = MODELS[file]
    for part in parts:
        _, at, model = _find_key_value_and_model(at, part, f"{where}: {key}", model)
    return at


def _split_key(key: str) -> tuple[str, list[str]]:
    """Return the document that a dotted key is in, and the parts of the key in that document."""
    parts = key.split(".")
    return (VESSEL, parts[1:]) if parts[0] == VESSEL else ("scenario", parts)


def _copy_table_with_value(
    table: Any, parts: list[str], value: object, where: str, model: Model
) -> Any:
    """Return a copy of a TOML table with one value replaced, found by the parts of its key."""
    place, old, inner = _find_key_value_and_model(table, parts[0], where, model)
    changed = table.copy()
    changed[place] = (
        _copy_table_with_value(old, parts[1:], value, where, inner) if parts[1:] else value
    )
    return changed


def _find_key_value_and_model(
    table: Any, part: str, where: str, model: Model
) -> tuple[Any, Any, Model]:
    """Return the key or index that a part of a dotted key is, its value, and the value's model.

    A newer key that a document leaves out, as it has its default, is found by the model.
    """
    if isinstance(table, dict) and model is not None and part in model.later_keys - table.keys():
        return part, model.model_fields[part].default, _find_inner_model(model, part)
    place = _find_key_or_list_index(table, part, where, model)
    inner = _find_inner_model(model, part) if isinstance(table, dict) else model
    return place, table[place], inner


def _find_inner_model(model: Model, key: str) -> Model:
    """Return the model of the table, or of the tables in the list, that a key of a model has."""
    field = None if model is None else model.model_fields.get(key)
    found = [field.annotation] if field is not None else []
    for annotation in found:
        if isinstance(annotation, type) and issubclass(annotation, FileModel):
            return annotation
        found += get_args(annotation)
    return None


def _find_key_or_list_index(table: Any, part: str, where: str, model: Model) -> Any:
    """Return one part of a dotted key as a key or list index; InputError if there is none such."""
    if isinstance(table, dict):
        if part in table:
            return part
        known = {*table, *(() if model is None else model.later_keys)}
        raise InputError(
            where, "", f"an unknown key {part!r}", format_allowed_names(part, sorted(known))
        )
    above = where.rpartition(": ")[2].rpartition(f".{part}")[0]
    if isinstance(table, list) and table:
        if part.isdecimal() and int(part) < len(table):
            return int(part)
        raise InputError(where, "", part, f"an index from 0 to {len(table) - 1}")
    if table is None or table == []:
        remedy = (
            f"add the whole table to the scenario file, or give it as the value of the key {above}"
        )
        raise SituationError(where, f"the scenario has no table {above}: {remedy}")
    found = f"the key {part!r} of {above}, which is a single value, not a table"
    raise InputError(where, "", found, "a key in a table of the scenario")
