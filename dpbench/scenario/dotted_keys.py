"""Values of a scenario's files by the dotted names of their keys.

A key is named as in the files, with dots: `environment.wind.speed_mps`, `start.east_m`,
`controller.output_weight.0` for an entry of a list; `vessel` is the ship by name, and
`vessel.limits.rate_max_N_per_s.1` a key of its file.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from dpbench.errors import InputError, SituationError, format_allowed_names
from dpbench.scenario.problem_files import (
    ScenarioDocuments,
    VesselDocuments,
    find_problem_path,
    read_toml_as_model,
)
from dpbench.scenario.tables.vessel_file import VesselFile

VESSEL = "vessel"


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
            parts = key.split(".")
            file = "vessel" if parts[0] == VESSEL else "scenario"
            path_in_file = parts[1:] if file == "vessel" else parts
            changed[file] = _copy_table_with_value(
                changed[file], path_in_file, value, f"{where}: {key}"
            )
    return cast(ScenarioDocuments, changed)


def read_value_of_dotted_key(files: ScenarioDocuments, key: str, where: str) -> object:
    """Return the value of a dotted key in a scenario's files; InputError without such a key."""
    if key == VESSEL:
        return files["vessel_name"]
    parts = key.split(".")
    at = files["vessel" if parts[0] == VESSEL else "scenario"]
    for part in parts[1:] if parts[0] == VESSEL else parts:
        at = at[_find_key_or_list_index(at, part, f"{where}: {key}")]
    return at


def _copy_table_with_value(table: Any, parts: list[str], value: object, where: str) -> Any:
    """Return a copy of a TOML table with one value replaced, found by the parts of its key."""
    place = _find_key_or_list_index(table, parts[0], where)
    changed = table.copy()
    changed[place] = (
        _copy_table_with_value(table[place], parts[1:], value, where) if parts[1:] else value
    )
    return changed


def _find_key_or_list_index(table: Any, part: str, where: str) -> Any:
    """Return one part of a dotted key as a key or list index; InputError if there is none such."""
    if isinstance(table, dict):
        if part in table:
            return part
        raise InputError(
            where, "", f"an unknown key {part!r}", format_allowed_names(part, sorted(table))
        )
    if isinstance(table, list):
        if part.isdecimal() and int(part) < len(table):
            return int(part)
        raise InputError(where, "", part, f"an index from 0 to {len(table) - 1}")
    if table is None:
        missing = where.rpartition(": ")[2].partition(f".{part}")[0]
        remedy = f"add the whole table, in its file or as a mapping with the key {missing}"
        raise SituationError(where, f"the scenario has no table {missing}: {remedy}")
    fault = f"{part!r} is looked up in a single value, not in a table"
    raise SituationError(where, f"{fault}; allowed: a key in a table of the scenario")
