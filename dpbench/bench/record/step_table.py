"""Runs and steps as Arrow, with the columns and types of the two tables, and how they are written.

A table of steps is of whole runs, each in one piece and in the order of its steps. In a file no run
lies in two row groups, so that each of these can be read by itself.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dpbench.bench.record.schema import (
    ABSENT,
    RUN_COLUMNS,
    STEP_COLUMNS,
    Columns,
    DType,
    as_runs,
)
from dpbench.files.writing import new_file, put

ARROW: dict[DType, pa.DataType] = {
    "str": pa.string(),
    "bool": pa.bool_(),
    "int32": pa.int32(),
    "int64": pa.int64(),
    "Int64": pa.int64(),
    "float64": pa.float64(),
}
CODED_STRING = pa.dictionary(pa.int32(), pa.string())
"""The type of strings in memory: each is stored once for all its rows."""
STRING_COLUMNS = [name for name, (dtype, _) in STEP_COLUMNS.items() if dtype == "str"]
"""The columns of strings: the same few over and over."""
STEPS_SCHEMA = pa.schema([(n, ARROW[t]) for n, (t, _) in STEP_COLUMNS.items() if n != "run_id"])
"""Steps of one run, which has its name elsewhere."""
FILE_SCHEMA = pa.schema(
    [(n, CODED_STRING if t == "str" else ARROW[t]) for n, (t, _) in STEP_COLUMNS.items()]
)
RUNS_SCHEMA = pa.schema([(name, ARROW[dtype]) for name, (dtype, _) in RUN_COLUMNS.items()])
_SPLIT = [name for name, (dtype, _) in STEP_COLUMNS.items() if dtype not in ("str", "bool")]
"""The columns of numbers: they are split into planes of bytes, so that the even ones among them
compress."""
_FILLERS: dict[DType, object] = {"str": "", "bool": False, "int32": 0, "int64": 0}
"""What stands for a missing value in columns that have no null."""


def absent_column(dtype: DType, rows: int) -> pa.Array:
    """Return a column of that type without a value in any row."""
    return pa.repeat(pa.scalar(_FILLERS.get(dtype), ARROW[dtype]), rows)


def columns_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Return the columns of `runs.parquet` that some of the rows have."""
    there = {name for row in rows for name in row}
    return {
        name: [row.get(name, _FILLERS.get(dtype)) for row in rows]
        for name, (dtype, _) in RUN_COLUMNS.items()
        if name in there
    }


def runs_table(columns: Mapping[str, Sequence[Any]]) -> pa.Table:
    """Return columns of `runs.parquet` as a table of `RUNS_SCHEMA`; absent ones are missing.

    Raises
    ------
    ValueError, TypeError, OverflowError : a value is of another type than its column.
    """
    rows = len(columns["run_id"])
    arrays = [
        pa.array(columns[name], ARROW[dtype], from_pandas=True)
        if name in columns
        else absent_column(dtype, rows)
        for name, (dtype, _) in RUN_COLUMNS.items()
    ]
    return _without_gaps(pa.Table.from_arrays(arrays, schema=RUNS_SCHEMA))


def _without_gaps(runs: pa.Table) -> pa.Table:
    """Return a table of `RUNS_SCHEMA`; ValueError where a number is missing that no run lacks."""
    gaps = [
        n for n, (t, _) in RUN_COLUMNS.items() if t in ("int32", "int64") and runs[n].null_count
    ]
    if gaps:
        raise ValueError(f"{gaps[0]}: no number")
    return runs


def step_batch(steps: Mapping[str, NDArray[Any]]) -> pa.RecordBatch:
    """Return the columns of the steps of one run.

    Parameters
    ----------
    steps : (N,) arrays by the names of `STEP_COLUMNS`; whole numbers that are missing are
        `ABSENT`, and a column that is not there has no value in any row.
    """
    rows = len(steps["k"])
    arrays = [_array(name, steps, rows) for name in STEPS_SCHEMA.names]
    return pa.RecordBatch.from_arrays(arrays, schema=STEPS_SCHEMA)


def no_steps() -> pa.RecordBatch:
    """Return those of a run that left none."""
    return pa.RecordBatch.from_arrays(
        [pa.array([], field.type) for field in STEPS_SCHEMA], schema=STEPS_SCHEMA
    )


def _array(name: str, steps: Mapping[str, NDArray[Any]], rows: int) -> pa.Array:
    dtype = STEP_COLUMNS[name][0]
    if name not in steps:
        return absent_column(dtype, rows)
    values = steps[name]
    if dtype == "Int64":
        return pa.array(values, pa.int64(), mask=values == ABSENT)
    if dtype != "float64":
        return pa.array(values, ARROW[dtype])
    numbers = np.ascontiguousarray(values, dtype=np.float64)
    return pa.array(numbers, mask=np.isnan(numbers))


def concat_runs(batches: Mapping[str, pa.RecordBatch]) -> pa.Table:
    """Return one table of the steps of several runs, by their names."""
    steps = pa.Table.from_batches(batches.values(), STEPS_SCHEMA)
    counts = [batch.num_rows for batch in batches.values()]
    codes = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    names = pa.DictionaryArray.from_arrays(codes, pa.array(list(batches), pa.string()))
    for name in STRING_COLUMNS[1:]:
        at = steps.schema.get_field_index(name)
        steps = steps.set_column(at, name, steps[name].dictionary_encode())
    return steps.add_column(0, "run_id", names).unify_dictionaries()


def encode_steps(table: pa.Table, metadata: Mapping[str, str] | None = None) -> bytes:
    """Return whole runs, of `FILE_SCHEMA`, as a Parquet file of one row group, in which each page
    has its check sum."""
    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(
        sink,
        FILE_SCHEMA.with_metadata(metadata),
        compression="zstd",
        use_dictionary=STRING_COLUMNS,
        column_encoding=dict.fromkeys(_SPLIT, "BYTE_STREAM_SPLIT"),
        write_page_checksum=True,
        # Of names that are hashes, and of numbers in no order, they help nobody to skip.
        write_statistics=False,
        # A table reads as what its columns are, in whatever program, not as what they were here;
        # only with its schema are metadata written.
        store_schema=metadata is not None,
    ) as writer:
        if table.num_rows:
            whole = table.unify_dictionaries().combine_chunks()
            writer.write_table(whole.replace_schema_metadata(metadata), row_group_size=len(table))
    data: bytes = sink.getvalue().to_pybytes()
    return data


def stored_steps(table: pa.Table) -> pa.Table:
    """Return the columns of `FILE_SCHEMA` of a table of steps, those that are absent as missing;
    ValueError, or one of Arrow, where they are of other types."""
    return _completed(table, STEP_COLUMNS).cast(FILE_SCHEMA)


def _completed(table: pa.Table, columns: Columns) -> pa.Table:
    for name in columns.keys() - set(table.column_names):
        table = table.append_column(name, absent_column(columns[name][0], len(table)))
    return table.select(list(columns))


def write_runs(path: Path, runs: pa.Table, metadata: Mapping[str, str]) -> None:
    """Write rows of `runs.parquet`, with the keys of studies behind its columns, whole or not at
    all.

    Parameters
    ----------
    metadata : stored beside them in the file.
    """
    part = new_file(path.with_name(f"{path.name}.part"))
    try:
        table = runs.replace_schema_metadata(dict(metadata))
        pq.write_table(table, part, compression="zstd", write_page_checksum=True)
        put(part, path)
    finally:
        part.unlink(missing_ok=True)


def runs_of_frame(frame: pd.DataFrame) -> pa.Table:
    """Return a frame of runs as a table of `RUNS_SCHEMA`, with the keys of studies behind it."""
    runs = as_runs(frame).reset_index(drop=True)
    keys = pa.Schema.from_pandas(runs[[name for name in runs if name not in RUN_COLUMNS]])
    schema = pa.schema([*RUNS_SCHEMA, *keys])
    return pa.Table.from_pandas(runs, schema, preserve_index=False)


def stored_runs(table: pa.Table) -> pa.Table:
    """Return the columns of `RUNS_SCHEMA` of a table of runs, those that are absent as missing;
    ValueError, or one of Arrow, where they are of other types."""
    return _without_gaps(_completed(table, RUN_COLUMNS).cast(RUNS_SCHEMA))


def frame_of_runs(table: pa.Table) -> pd.DataFrame:
    """Return a table of `RUNS_SCHEMA` as a frame, by run_id."""
    whole = {pa.int64(): pd.Int64Dtype()}
    runs: pd.DataFrame = as_runs(table.to_pandas(types_mapper=whole.get))
    return runs.set_index("run_id", drop=False)


def filter_runs(table: pa.Table, names: Container[str]) -> pa.Table:
    """Return the rows of those runs."""
    coded = table["run_id"].combine_chunks()
    wanted = np.array([name in names for name in coded.dictionary.to_pylist()], dtype=np.bool_)
    if not wanted.any():
        # A slice would hold on to all of the table.
        return table.schema.empty_table()
    return table if wanted.all() else table.filter(pa.array(wanted[coded.indices.to_numpy()]))


def rename_runs(table: pa.Table, names: Mapping[str, str]) -> pa.Table:
    """Return the rows of those runs, under new names."""
    some = filter_runs(table, names)
    coded = some["run_id"].combine_chunks()
    new = pa.array([names.get(name, name) for name in coded.dictionary.to_pylist()], pa.string())
    renamed = pa.DictionaryArray.from_arrays(coded.indices, new).cast(CODED_STRING)
    return some.set_column(0, "run_id", renamed)
