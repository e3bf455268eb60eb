"""The record schema: types of all columns of `runs.parquet` and `steps.parquet`.

Types and meanings are in `schema.toml`.
"""

import json
import tomllib
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd

SCHEMA_VERSION = 7

DType = Literal["str", "bool", "int32", "int64", "Int64", "float64"]
Columns = dict[str, tuple[DType, str]]
"""Type and meaning by name."""

STUDY_PREFIX = "x_"
"""Prefix of the columns that hold the values of a study's keys, before the key's dotted name."""

POSE_AXES = ("n", "e", "psi")
FORCES = ("surge", "sway", "yaw")
AXIS_FORCES = ("x_N", "y_N", "n_Nm")
MISSING_INT = -1
"""A whole number that is not there, in arrays that cannot say null."""


def _read_tables_of_schema() -> dict[str, Columns]:
    """Return the tables of `schema.toml`, by name."""
    text = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    tables: dict[str, dict[str, tuple[DType, str]]] = tomllib.loads(text)
    return {
        table: {name: (dtype, meaning) for name, (dtype, meaning) in columns.items()}
        for table, columns in tables.items()
    }


(
    STEP_COLUMNS,
    IDENTITY_COLUMNS,
    ACCURACY_COLUMNS,
    TIMING_COLUMNS,
    MACHINE_COLUMNS,
    CONTROL_COLUMNS,
) = _read_tables_of_schema().values()
RUN_COLUMNS = (
    IDENTITY_COLUMNS | ACCURACY_COLUMNS | TIMING_COLUMNS | MACHINE_COLUMNS | CONTROL_COLUMNS
)

_PANDAS = {dtype: pd.api.types.pandas_dtype(dtype) for dtype in get_args(DType)}


def convert_to_columns(frame: pd.DataFrame, columns: Columns) -> pd.DataFrame:
    """Return a data frame with exactly these columns and types; absent ones have no values."""
    # Most runs lack most columns: what is absent is made once for each type, not for each column.
    fillers: dict[str, object] = {"str": "", "bool": False, "int32": 0, "int64": 0, "Int64": pd.NA}
    absent = {
        dtype: pd.Series(fillers.get(dtype, np.nan), range(len(frame)), dtype).array
        for dtype in {dtype for dtype, _ in columns.values()}
    }
    out = {
        name: _convert_column(frame[name], dtype) if name in frame else absent[dtype]
        for name, (dtype, _) in columns.items()
    }
    return pd.DataFrame(out, index=frame.index)


def _convert_column(column: "pd.Series[Any]", dtype: DType) -> Any:
    """Return a data-frame column converted to a type, without a copy where it has it already."""
    # Converting a column to the type it has copies it, and takes ten times as long as looking.
    return column.array if column.dtype == _PANDAS[dtype] else column.astype(dtype).array


def convert_to_step_columns(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a data frame with the columns of `steps.parquet`; absent ones have no values."""
    return convert_to_columns(frame, STEP_COLUMNS)


def convert_to_run_columns(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a data frame with the columns of `runs.parquet`, then its study parameters."""
    runs = convert_to_columns(frame, RUN_COLUMNS)
    keys = [name for name in frame.columns if name.startswith(STUDY_PREFIX)]
    return runs.join(frame[keys]) if keys else runs


def make_study_value_columns(runs: pd.DataFrame) -> pd.DataFrame:
    """Return study name, point, repetition and parameter values of runs (N), as columns.

    They are `study`, `study_point` and `replicate`, and an `x_<key>` for each key, a number where
    all its values are numbers and text else, missing in runs of other studies.
    """
    cells = runs["cell"].astype(str)
    of_study = cells.str.contains('"study": {', regex=False)
    if not of_study.any():
        return pd.DataFrame(index=runs.index)
    rows = {
        i: _make_study_values_by_column(json.loads(cell)["study"])
        for i, cell in cells[of_study].items()
    }
    table = pd.DataFrame.from_dict(rows, orient="index").reindex(runs.index)
    return table.assign(study=table["study"].fillna(""))


def _make_study_values_by_column(study: dict[str, Any]) -> dict[str, Any]:
    """Return a run's study name, point, repetition and parameter values, by column."""
    values = {
        f"{STUDY_PREFIX}{key}": json.dumps(value) if isinstance(value, list) else value
        for key, value in study["x"].items()
    }
    return {
        "study": study["name"],
        "study_point": study["point"],
        "replicate": study["replicate"],
    } | values
