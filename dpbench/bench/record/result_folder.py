"""The result folder: parquet tables, machine and suite descriptions, and the cells behind them."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from dpbench.bench.record.schema import (
    ADDED,
    RENAMED,
    RENAMED_IN,
    RUN_COLUMNS,
    SCHEMA_VERSION,
    STEP_COLUMNS,
    as_runs,
    as_steps,
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
    results = Results(
        runs=_read_table(folder, "runs"),
        steps=as_steps(pd.DataFrame()) if no_steps else _read_table(folder, "steps"),
        machine=read_json(folder / "machine.json"),
        suite=read_json(folder / "suite.json"),
    )
    tables = {"run_rows": results.runs} | ({} if no_steps else {"step_rows": results.steps})
    for name, frame in tables.items():
        promised = results.suite.get(name)
        if promised != len(frame):
            found = f"{promised} where the table has {len(frame)} rows"
            raise ResultsError(str(folder / "suite.json"), name, found, "the same; run again")
    if "id" not in results.machine:
        raise ResultsError(str(folder / "machine.json"), "id", "nothing", "a machine description")
    return results


def _read_table(folder: Path, name: str) -> pd.DataFrame:
    path = folder / f"{name}.parquet"
    if not path.is_file():
        raise ResultsError(str(path), "", "no such file", "a table written by `dpbench run`")
    try:
        frame = pd.read_parquet(path)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise ResultsError(
            str(path), "", f"a damaged file ({str(error)[:120]})", "a parquet table; run again"
        ) from error
    if "schema" in frame:
        versions = set(frame["schema"].unique().tolist())
        if versions - {SCHEMA_VERSION, RENAMED_IN - 1}:
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
