"""The result folder: checked tables, types of `machine.json` and `suite.json`, and its locks.

All keys of these files but the required ones may be missing, and unknown ones may be present:
releases differ.
"""

import fcntl
import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, Required, TypeVar, get_args

import pandas as pd
import pyarrow as pa
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict

from dpbench.bench.record.cell import FORMULATIONS, OUTCOMES, Units
from dpbench.bench.record.recorded_steps import (
    StepsOnDisk,
    convert_table_errors,
    make_missing_columns_error,
    make_wrong_type_error,
)
from dpbench.bench.record.schema import SCHEMA_VERSION, STUDY_PREFIX
from dpbench.bench.record.step_table import add_missing_run_columns, runs_to_frame
from dpbench.errors import (
    InputError,
    ResultsError,
    SituationError,
    begin_in_lower_case,
    format_key_path,
)
from dpbench.files.regular_files import (
    is_plain_file_name,
    make_folder_if_missing,
    read_json_object,
    write_text_atomically,
)
from dpbench.files.tables import decode_dictionary_columns_to_text, open_untrusted_parquet_table
from dpbench.locks import WaitLimit, describe_lock_holders, hold_folder_lock
from dpbench.scenario.problem_files import ALLOWED
from dpbench.solvers.contract import Policy, Route

_Kind = TypeVar("_Kind")
_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)
_OPEN = ConfigDict(strict=True, extra="allow", allow_inf_nan=False)


class ComparedMachine(TypedDict, total=False):
    """Entries of `machine.json` that must be equal for times to be comparable."""

    cpu_model: str
    cores: int
    memory_GiB: int
    kernel: str
    python: str
    versions: dict[str, str]


@with_config(_OPEN)
class MachineDescription(ComparedMachine, total=False):
    """Content of `machine.json`; `others` are further machines whose runs were joined."""

    id: Required[str]
    cpu_family: str
    vector_instructions: list[str]
    governor: str
    frequency_MHz: float | str
    blas: list[str] | None
    throttle_counters: str
    affinity: list[int] | None
    clock_read_ns: float
    timer_resolution_ns: float
    load_average: list[float]
    others: "list[MachineDescription]"


_Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class _Requirements(TypedDict, total=False):
    """Table `requirements` of `suite.json`: limits that a solver must keep."""

    error_move: _Positive
    failed_steps: Annotated[int, Field(ge=0)]
    p99_ms: _Positive
    deadline_ms: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class _Report(TypedDict, total=False):
    """Table `report` of `suite.json`: the solver to compare with, and the step shown first."""

    baseline: str | None
    step: int | None
    configuration: str | None


class StudyDescription(TypedDict, total=False):
    """Table `[[study]]` of `suite.json`: base scenario, name, radius and keys of a study."""

    base: Required[str]
    name: str | None
    radius_m: float
    product: dict[str, list[Any]]
    zip: dict[str, list[Any]]


class _Limits(TypedDict, total=False):
    """Limits of a solve in a table of runs of `suite.json`, in iterations and [s]."""

    iteration_limits: list[int]
    time_limits: list[float]


class UncountedSolver(TypedDict):
    """Solver whose C could not be counted on an embedded core along a sequence, and the reason."""

    solver: str
    target: str
    sequence: str
    reason: str


class Revision(TypedDict):
    """Git commit of dpbench, in full, and whether the files of the package were those of it."""

    commit: str
    clean: bool


@with_config(_OPEN)
class SuiteDescription(TypedDict, total=False):
    """Content of `suite.json`: the suite that was run, when, by which version, what was lost."""

    name: str
    title: str
    solvers: list[str]
    harness_version: str
    started_utc: str
    wall_s: float
    run_rows: Required[int]
    step_rows: Required[int]
    added_runs: list[str]  # run_id of each loop of `add_runs`
    lost_cells: int
    lost_designs: int
    remarks: list[str]
    not_counted: list[UncountedSolver]
    revisions: list[Revision]
    requirements: _Requirements
    demand: _Requirements  # key of earlier releases
    report: _Report
    study: list[StudyDescription]
    closed_loop: list[_Limits]
    replay: list[_Limits]
    recorded: list[_Limits]


def check_document_as_type(document: dict[str, Any], kind: type[_Kind], path: Path) -> _Kind:
    """Return a JSON object checked as a type; ResultsError, naming the key, for a mismatch."""
    try:
        # As JSON: a list is a tuple there, and a whole number a float.
        checked: _Kind = _adapter(kind).validate_json(json.dumps(document))
        return checked
    except ValidationError as error:
        raise make_json_fault_error(str(path), error) from error


_OBJECTS = dict.fromkeys(("dict_type", "model_type"), "a JSON object")
_ALLOWED = {**ALLOWED, **_OBJECTS, "list_type": "a JSON array", "missing": "a value"}
"""Allowed values by the type of a fault of Pydantic; other types keep its own words."""


def make_json_fault_error(where: str, error: ValidationError, *above: str) -> ResultsError:
    """Return the error on the first fault in a JSON object of dpbench; `above` : keys above it."""
    first = error.errors(include_url=False)[0]
    key = format_key_path([*above, *first["loc"]], is_toml=False)
    value = "nothing" if first["type"] == "missing" else repr(first["input"])[:80]
    allowed = _ALLOWED.get(first["type"], "").format(**first.get("ctx", {}))
    allowed = f"{allowed or 'a value (' + first['msg'] + ')'}, as written by `run_campaign()`"
    return ResultsError(where, key, value, f"{allowed}; run the suite again")


_WORDS = {
    "mode": ("closed_loop", "replay"),
    "route": get_args(Route),
    "policy": get_args(Policy),
    "units": get_args(Units),
    "formulation": FORMULATIONS,
    "outcome": OUTCOMES,
}
"""All words of a column."""
_LEAST = {"steps_planned": 0, "steps_done": 0, "rounds": 0, "N_p": 1, "N_c": 1, "replay_s": 1e-9}
"""The least number of a column, where it is not missing."""


def refuse_impossible_runs(runs: pd.DataFrame, path: Path) -> None:
    """Raise ResultsError, naming column and row, for rows that no campaign writes."""
    for column, is_bad, allowed in _yield_columns_and_invalid_masks(runs):
        if is_bad.any():
            row = int(is_bad.to_numpy().argmax())
            value = runs[column].iloc[row]
            found = (
                "nothing" if pd.isna(value) else f"{value!r}" if value == "" else str(value)[:80]
            )
            raise ResultsError(
                str(path), f"{column}[{row}]", found, f"{allowed}; run the suite again"
            )


def _yield_columns_and_invalid_masks(
    runs: pd.DataFrame,
) -> "Iterator[tuple[str, pd.Series[Any], str]]":
    """Yield a column of `runs.parquet`, a mask of its invalid values, and the allowed ones."""
    for column, words in _WORDS.items():
        yield column, ~runs[column].isin(words), ", ".join(words)
    for column, least in _LEAST.items():
        yield column, (runs[column] < least).fillna(False), f"{least:g} or more"
    finished = (runs["mode"] == "replay") & (runs["outcome"] == "finished")
    yield "rounds", finished & (runs["rounds"] == 0).fillna(False), "1 or more, as it finished"
    yield "N_p", runs["N_p"].isna() & runs["N_c"].notna(), "a number, as N_c is one"
    of_study = runs["study"] != ""
    for column in ("study_point", "replicate"):
        yield column, of_study & runs[column].isna(), "a number, as the run belongs to a study"


@dataclass(frozen=True, eq=False)
class Results:
    """A result folder: rows of `runs.parquet` and `steps.parquet`, `machine.json`, `suite.json`."""

    runs: pd.DataFrame
    recorded: StepsOnDisk
    machine: MachineDescription
    suite: SuiteDescription

    @cached_property
    def steps(self) -> pd.DataFrame:
        """All steps as a data frame, some 500 bytes each; use `recorded` for large folders."""
        return self.recorded.read_all_steps()


@contextmanager
def lock_result_folder(
    folder: Path,
    suite: str,
    patience: WaitLimit = WaitLimit(),  # noqa: B008 - frozen
) -> Iterator[None]:
    """Lock a result folder for one campaign of `suite`; make it where it is missing.

    A report that is being written there is waited for with `patience`. InputError, and nothing
    changed, where it cannot be written, has other files or the results of another suite, its folder
    of cells is a link, or another campaign uses it.
    """
    where = "`out`"
    if str(folder) in ("", "."):
        raise InputError(where, "", "the current folder", "another folder")
    previous = folder / "suite.json"
    if previous.is_file():
        stored = read_json(previous).get("name")
        if stored != suite:
            allowed = "another folder; or remove this one"
            raise InputError(where, "", f"{folder} with results of suite {stored!r}", allowed)
    elif folder.is_dir() and any(folder.iterdir()) and not (folder / "cells").is_dir():
        found = f"{folder}, a folder with files that no run has written"
        raise InputError(where, "", found, "a new or an empty folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        lock = os.open(make_folder_if_missing(folder / "cells") / ".lock", flags, 0o666)
    except OSError as error:
        fault = f"cannot create {folder} ({begin_in_lower_case(error.strerror or str(error))})"
        raise SituationError(
            where, f"{fault}; required: a folder that can be written to"
        ) from error
    with ExitStack() as stack:
        stack.callback(os.close, lock)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            fault = f"{folder} is in use by {describe_lock_holders(lock)}"
            remedy = "use another folder, or wait until that process ends"
            raise SituationError(where, f"{fault}; {remedy}") from error
        with lock_for_writing(folder, patience):
            yield


@contextmanager
def lock_for_writing(folder: Path, patience: WaitLimit = WaitLimit()) -> Iterator[None]:  # noqa: B008 - frozen
    """Lock a result folder against other campaigns and reports, after waiting for them.

    A missing folder, or one on a disk without locks, is not locked. BusyError if the wait is too
    short.
    """

    def say_waiting(others: str) -> None:
        said = f"dpbench: waiting for {others}, which writes into {folder}"
        print(said, file=sys.stderr, flush=True)

    with hold_folder_lock(folder, patience=patience, say_waiting=say_waiting):
        yield


def write_json(path: Path, document: Mapping[str, object]) -> None:
    """Write a JSON file, whole or not at all."""
    write_text_atomically(path, json.dumps(document, indent=2, ensure_ascii=False) + "\n")


def read_lost_count_and_remarks(out: Path) -> tuple[int, list[str]]:
    """Return the number of lost runs and stability studies, and the remarks, in `suite.json`."""
    suite = read_suite_description(out)
    lost = int(suite.get("lost_cells", 0)) + int(suite.get("lost_designs", 0))
    return lost, [str(line) for line in suite.get("remarks", [])]


def load_results(out: str | Path, *, without_steps: bool = False) -> Results:
    """Return the results in a folder; its steps are read only on request.

    Parameters
    ----------
    without_steps : accept a folder without `steps.parquet`, as one that was sent to others; its
        table of steps is empty.

    Raises
    ------
    ResultsError : naming the file, when one is missing, damaged or of another schema.
    """
    if not isinstance(out, (str, os.PathLike)):
        raise TypeError(
            f"results: found an object of type {type(out).__name__}; allowed: the path of a folder"
        )
    folder = Path(out)
    if not folder.is_dir():
        allowed = "a folder written by `run_campaign()`"
        found = "a file" if folder.exists() else "no such folder"
        raise ResultsError(str(folder), "", found, allowed)
    no_steps = without_steps and not (folder / "steps.parquet").exists()
    runs, steps = _read_checked_runs(folder), StepsOnDisk(folder, is_optional=without_steps)
    results = Results(runs, steps, *load_machine_and_suite(folder))
    for name, rows in {"run_rows": len(runs), "step_rows": steps.rows}.items():
        promised = results.suite.get(name)
        if promised != rows and not (no_steps and name == "step_rows"):
            found = f"{promised}, but the table has {rows} rows"
            raise ResultsError(
                str(folder / "suite.json"),
                name,
                found,
                "the number of rows of the table; run the suite again",
            )
    return results


def load_machine_and_suite(folder: Path) -> tuple[MachineDescription, SuiteDescription]:
    """Return `machine.json` and `suite.json` of a result folder; ResultsError if damaged."""
    path = folder / "machine.json"
    return check_document_as_type(
        read_json(path), MachineDescription, path
    ), read_suite_description(folder)


def read_suite_description(folder: Path) -> SuiteDescription:
    """Return `suite.json` of a result folder; ResultsError if damaged."""
    path = folder / "suite.json"
    return check_document_as_type(read_json(path), SuiteDescription, path)


def _read_checked_runs(folder: Path) -> pd.DataFrame:
    """Return `runs.parquet` of a result folder, checked; ResultsError if damaged."""
    path = folder / "runs.parquet"
    with convert_table_errors(path), open_untrusted_parquet_table(path, error=ResultsError) as file:
        table = decode_dictionary_columns_to_text(file.read(), path, error=ResultsError)
    if missing := sorted({"run_id", "schema"} - set(table.column_names)):
        raise make_missing_columns_error(path, missing)
    others = sorted(set(table["schema"].unique().to_pylist()) - {SCHEMA_VERSION}, key=str)
    if others:
        # Before its columns are read: another schema has others.
        found = ", ".join(map(str, others))
        allowed = f"{SCHEMA_VERSION} (this version of dpbench); run the suite again"
        raise ResultsError(str(path), "schema", found, allowed)
    try:
        runs = runs_to_frame(add_missing_run_columns(table)).reset_index(drop=True)
        keys = [name for name in table.column_names if name.startswith(STUDY_PREFIX)]
        runs = runs.join(table.select(keys).replace_schema_metadata(None).to_pandas())
    except (ValueError, TypeError, KeyError, pa.ArrowException) as error:
        raise make_wrong_type_error(path, str(error)[:80]) from error
    refuse_impossible_runs(runs, path)
    # `report --for` writes files named after solvers.
    for name in runs["solver"].unique():
        if not is_plain_file_name(str(name)):
            raise ResultsError(str(path), "solver", repr(name)[:80], "a name without a path")
    return runs


def read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file of results; ResultsError, naming the file, without one."""
    return read_json_object(path, "a JSON document", error=ResultsError)


def hash_files(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Return the SHA-256, by name, of those files of a folder that exist."""
    found = {}
    for name in names:
        if (folder / name).is_file():
            with (folder / name).open("rb") as file:
                found[name] = hashlib.file_digest(file, "sha256").hexdigest()
    return found
