"""The result folder: parquet tables, machine and suite descriptions, and the cells behind them."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from dpbench.bench.record.schema import (
    ADDED,
    READABLE,
    RENAMED,
    RUN_COLUMNS,
    SCHEMA_VERSION,
    STEP_COLUMNS,
    as_runs,
    as_steps,
)
from dpbench.bench.record.step_table import (
    OF_CLOCK,
    OF_FILE,
    STORED,
    is_complete,
    needed_for,
    of_runs,
    with_derived,
)
from dpbench.errors import InputError, ResultsError, renamed

TABLES = {"runs": RUN_COLUMNS, "steps": STEP_COLUMNS}


@dataclass(frozen=True, eq=False)
class Results:
    """A result folder in memory; columns as in `schema.py`."""

    runs: pd.DataFrame
    steps: pd.DataFrame
    machine: dict[str, Any]
    suite: dict[str, Any]


@contextmanager
def claimed(folder: Path, suite: str) -> Iterator[None]:
    """Hold a result folder for one campaign of `suite`, making it if need be.

    Raises
    ------
    InputError : when it cannot be written, holds other things or the results of another suite, or
        another campaign is running in it. Nothing is changed then.
    """
    where = "--out"
    if str(folder) in ("", "."):
        raise InputError(where, "", "the current folder", "a folder of its own")
    previous = folder / "suite.json"
    if previous.is_file():
        found = read_json(previous).get("name")
        if found != suite:
            allowed = "another folder, or remove this one"
            raise InputError(where, "", f"{folder} with results of suite {found!r}", allowed)
    elif folder.is_dir() and any(folder.iterdir()) and not (folder / "cells").is_dir():
        raise InputError(where, "", f"{folder} with other files", "a new or an empty folder")
    try:
        (folder / "cells").mkdir(parents=True, exist_ok=True)
        lock = (folder / "cells" / ".lock").open("w")
    except OSError as error:
        found = f"{folder}: {error.strerror}"
        raise InputError(where, "", found, "a folder that can be written") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            allowed = "to wait for it, or another folder"
            raise InputError(where, "", f"{folder} in use by a campaign", allowed) from error
        yield


def write_results(out: Path, results: Results) -> None:
    """Write the four files of a result folder, each whole or not at all."""
    out.mkdir(parents=True, exist_ok=True)
    for name, frame in (("runs", as_runs(results.runs)), ("steps", as_steps(results.steps))):
        part = out / f"{name}.parquet.part"
        frame.to_parquet(part, index=False, compression="zstd")
        part.replace(out / f"{name}.parquet")
    rows = {"run_rows": len(results.runs), "step_rows": len(results.steps)}
    write_json(out / "machine.json", results.machine)
    write_json(out / "suite.json", results.suite | rows)


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write `document` to `path`, whole or not at all."""
    part = path.with_suffix(".part")
    part.write_text(json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    part.replace(path)


def accidents(out: Path) -> tuple[int, list[str]]:
    """How many cells of a result folder the benchmark lost itself, and what is to be said of it.

    Raises
    ------
    ResultsError : `suite.json` is missing or damaged.
    """
    suite = read_json(out / "suite.json")
    return int(suite.get("lost_cells", 0)), [str(line) for line in suite.get("remarks", [])]


def load_results(out: str | Path, *, without_steps: bool = False) -> Results:
    """Read a result folder.

    Parameters
    ----------
    without_steps : a folder that has no `steps.parquet`, as one that was sent to others, will do;
        its table of steps is empty.

    Raises
    ------
    ResultsError : naming the file, when one is missing, damaged or of another schema.
    """
    folder = Path(out)
    if not folder.is_dir():
        raise ResultsError(str(folder), "", "no such folder", "a folder written by `dpbench run`")
    no_steps = without_steps and not (folder / "steps.parquet").exists()
    runs = _read_table(folder, "runs")
    steps = as_steps(pd.DataFrame()) if no_steps else _read_table(folder, "steps")
    results = Results(runs, steps, *load_descriptions(folder))
    tables = {"run_rows": results.runs} | ({} if no_steps else {"step_rows": results.steps})
    for name, frame in tables.items():
        promised = results.suite.get(name)
        if promised != len(frame):
            found = f"{promised} where the table has {len(frame)} rows"
            raise ResultsError(str(folder / "suite.json"), name, found, "the same; run again")
    return results


def load_descriptions(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """`machine.json` and `suite.json`; ResultsError, naming the file, when one is missing or
    damaged."""
    machine, suite = read_json(folder / "machine.json"), read_json(folder / "suite.json")
    if "id" not in machine:
        raise ResultsError(str(folder / "machine.json"), "id", "nothing", "a machine description")
    return machine, suite


def scan_steps(
    out: str | Path, columns: Sequence[str], run_ids: Container[str] | None = None
) -> Iterator[pa.Table]:
    """The steps of a result folder, some hundred thousand rows of whole runs at a time.

    Memory is that of one such table, whatever the number of runs; with `run_ids`, what holds none
    of them is not read.

    Parameters
    ----------
    columns : of `STEP_COLUMNS`; only what these are made from is read.
    run_ids : only the steps of these runs; None for all.

    Raises
    ------
    ResultsError : naming the file, when one is missing or damaged, or has no such column.
    """
    path = Path(out) / "steps.parquet"
    with _readable(path):
        clock = read_clock(Path(out)) if "t_s" in columns else pd.DataFrame()
        with pq.ParquetFile(path, read_dictionary=["run_id"]) as file:
            known = {RENAMED.get(name, name): name for name in file.schema_arrow.names}
            complete = is_complete(known)
            needed = list(columns) if complete else needed_for(columns)
            named = {name: known[name] for name in {*needed, "run_id"}}
            for i in range(file.num_row_groups):
                if run_ids is not None:
                    names = pc.unique(file.read_row_group(i, columns=["run_id"])["run_id"])
                    if not any(name in run_ids for name in names.to_pylist()):
                        continue
                group = file.read_row_group(i, columns=list(named.values()))
                group = group.select(list(named.values())).rename_columns(list(named))
                some = group if run_ids is None else of_runs(group, run_ids)
                yield some.select(columns) if complete else with_derived(some, columns, clock)


def read_steps(
    out: str | Path, columns: Sequence[str], run_ids: Container[str] | None = None
) -> pa.Table:
    """As `scan_steps`, in one table."""
    tables = list(scan_steps(out, columns, run_ids))
    if tables:
        return pa.concat_tables(tables).unify_dictionaries()
    return pa.table({name: pa.array([], OF_FILE.field(name).type) for name in columns})


def read_clock(folder: Path) -> pd.DataFrame:
    """The columns of `runs.parquet` that times of steps follow from, by run_id."""
    path = folder / "runs.parquet"
    with _readable(path):
        there = set(pq.read_schema(path).names)
        wanted = [name for name in ("run_id", *OF_CLOCK) if name in there]
        clock: pd.DataFrame = pq.read_table(path, columns=wanted).to_pandas()
    return clock.set_index("run_id")


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """What goes wrong as a table is read, as `ResultsError`."""
    if not path.is_file():
        raise ResultsError(str(path), "", "no such file", "a table written by `dpbench run`")
    try:
        yield
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        if isinstance(error, ResultsError):
            raise
        raise ResultsError(
            str(path), "", f"a damaged file ({str(error)[:120]})", "a parquet table; run again"
        ) from error


def _read_table(folder: Path, name: str) -> pd.DataFrame:
    path = folder / f"{name}.parquet"
    with _readable(path):
        table = pq.read_table(path)
        stored = set(table.column_names)
        if name == "steps" and not is_complete(stored) and set(STORED) <= stored:
            table = with_derived(table, list(STEP_COLUMNS), read_clock(folder))
        whole = {pa.int64(): pd.Int64Dtype()} if name == "steps" else {}
        frame = table.to_pandas(types_mapper=whole.get)
    if "schema" in frame:
        versions = set(frame["schema"].unique().tolist())
        if versions - READABLE:
            # Said before its columns are looked at: those of another schema are others.
            found, allowed = f"schema {sorted(versions)}", f"schema {SCHEMA_VERSION}; run again"
            raise ResultsError(str(path), "schema", found, allowed)
    old = {column: RENAMED[column] for column in frame.columns if column in RENAMED}
    if old:
        renamed(str(path), f"column {', '.join(old)}", ", ".join(old.values()))
        frame = frame.rename(columns=old)
    missing = sorted(set(TABLES[name]) - set(frame.columns) - ADDED)
    if missing:
        named = ", ".join(missing[:3]) + (", …" if len(missing) > 3 else "")
        raise ResultsError(str(path), named, "no such columns", "the columns of schema.py")
    try:
        return as_runs(frame) if name == "runs" else as_steps(frame)
    except (ValueError, TypeError) as error:
        found = f"a column of another type ({str(error)[:80]})"
        raise ResultsError(str(path), "", found, "the types of schema.py") from error


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object; ResultsError, naming the file, where there is none."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ResultsError(str(path), "", error.strerror or "unreadable", "a JSON file") from error
    except ValueError as error:
        raise ResultsError(str(path), "", f"no JSON ({error})", "a JSON document") from error
    if not isinstance(document, dict):
        raise ResultsError(str(path), "", type(document).__name__, "a JSON object")
    return document
