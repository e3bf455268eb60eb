"""Runs and steps as Arrow, with the columns and types of the two tables, and how they are written.

A table of steps is of whole runs, each in one piece and in the order of its steps. No run of a file
is in two row groups, so each row group can be read by itself. A part is the cells of a batch: a
Parquet file with the steps in one row group, and the columns of `runs.parquet` as JSON in its
metadata.
"""

import json
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dpbench.bench.record.schema import (
    MISSING_INT,
    RUN_COLUMNS,
    STEP_COLUMNS,
    Columns,
    DType,
    convert_to_run_columns,
)
from dpbench.files.regular_files import create_empty_file, rename_durably

_ARROW: dict[DType, pa.DataType] = {
    "str": pa.string(),
    "bool": pa.bool_(),
    "int32": pa.int32(),
    "int64": pa.int64(),
    "Int64": pa.int64(),
    "float64": pa.float64(),
}
_CODED_STRING = pa.dictionary(pa.int32(), pa.string())
STRING_COLUMNS = [name for name, (dtype, _) in STEP_COLUMNS.items() if dtype == "str"]
"""Columns of strings, stored in memory as dictionaries."""
STEPS_SCHEMA = pa.schema([(n, _ARROW[t]) for n, (t, _) in STEP_COLUMNS.items() if n != "run_id"])
"""Steps of one run, without its name."""
FILE_SCHEMA = pa.schema(
    [(n, _CODED_STRING if t == "str" else _ARROW[t]) for n, (t, _) in STEP_COLUMNS.items()]
)
RUNS_SCHEMA = pa.schema([(name, _ARROW[dtype]) for name, (dtype, _) in RUN_COLUMNS.items()])
NO_RUNS = RUNS_SCHEMA.empty_table()
_NUMBER_COLUMNS = [n for n, (dtype, _) in STEP_COLUMNS.items() if dtype not in ("str", "bool")]
"""Columns split into planes of bytes, so that regular numbers compress."""
_FILLERS: dict[DType, object] = {"str": "", "bool": False, "int32": 0, "int64": 0}
"""Values in place of missing ones in columns without null."""
_WHOLE_NUMBERS = [n for n, (dtype, _) in RUN_COLUMNS.items() if dtype in ("int32", "int64")]


def make_placeholder_column(dtype: DType, rows: int) -> pa.Array:
    """Return an Arrow column of placeholders: null, or "", False, 0 where a type has no null."""
    return pa.repeat(pa.scalar(_FILLERS.get(dtype), _ARROW[dtype]), rows)


def rows_to_columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Return rows of `runs.parquet` as lists by column, without columns that no row has."""
    names = {name for row in rows for name in row}
    return {
        name: [row.get(name, _FILLERS.get(dtype)) for row in rows]
        for name, (dtype, _) in RUN_COLUMNS.items()
        if name in names
    }


def build_runs_table(columns: Mapping[str, Sequence[Any]]) -> pa.Table:
    """Build a full table of runs from columns; ValueError or TypeError for wrong types."""
    arrays = {
        name: pa.array(columns[name], _ARROW[dtype], from_pandas=True)
        for name, (dtype, _) in RUN_COLUMNS.items()
        if name in columns
    }
    return _refuse_missing_numbers(
        _make_table_of_all_columns(arrays, len(columns["run_id"]), RUN_COLUMNS)
    )


def _make_table_of_all_columns(arrays: Mapping[str, Any], rows: int, columns: Columns) -> pa.Table:
    """Return an Arrow table with all `columns`, from given arrays; absent ones have no values."""
    absent = {dtype: make_placeholder_column(dtype, rows) for dtype in get_args(DType)}
    full = [
        arrays[name] if name in arrays else absent[dtype] for name, (dtype, _) in columns.items()
    ]
    return pa.Table.from_arrays(full, list(columns))


def _refuse_missing_numbers(runs: pa.Table) -> pa.Table:
    """Return a table of runs unchanged; ValueError if it lacks a number which every run has."""
    for name in _WHOLE_NUMBERS:
        if runs[name].null_count:
            raise ValueError(f"{name}: not a number")
    return runs


def make_step_record_batch(steps: Mapping[str, NDArray[Any]]) -> pa.RecordBatch:
    """Return the steps of one run as an Arrow record batch, from (N,) arrays by `STEP_COLUMNS`.

    A missing whole number is `MISSING_INT`; an absent column has no value in any row.
    """
    rows = len(steps["k"])
    arrays = [_make_step_column(name, steps, rows) for name in STEPS_SCHEMA.names]
    return pa.RecordBatch.from_arrays(arrays, schema=STEPS_SCHEMA)


def make_empty_record_batch() -> pa.RecordBatch:
    """Return an Arrow record batch of steps without rows."""
    return make_step_record_batch({"k": np.zeros(0, np.int32)})


def _make_step_column(name: str, steps: Mapping[str, NDArray[Any]], rows: int) -> pa.Array:
    """Return one column of steps as an Arrow array; missing numbers become null."""
    dtype = STEP_COLUMNS[name][0]
    if name not in steps:
        return make_placeholder_column(dtype, rows)
    values = steps[name]
    if dtype == "Int64":
        return pa.array(values, pa.int64(), mask=values == MISSING_INT)
    if dtype != "float64":
        return pa.array(values, _ARROW[dtype])
    numbers = np.ascontiguousarray(values, dtype=np.float64)
    return pa.array(numbers, mask=np.isnan(numbers))


def join_steps_of_runs(batches: Mapping[str, pa.RecordBatch]) -> pa.Table:
    """Return the steps of several runs, by run_id, as one Arrow table."""
    steps = pa.Table.from_batches(batches.values(), STEPS_SCHEMA)
    counts = [batch.num_rows for batch in batches.values()]
    codes = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    names = pa.DictionaryArray.from_arrays(codes, pa.array(list(batches), pa.string()))
    for name in STRING_COLUMNS[1:]:
        at = steps.schema.get_field_index(name)
        steps = steps.set_column(at, name, steps[name].dictionary_encode())
    return steps.add_column(0, "run_id", names).unify_dictionaries()


def open_step_writer(sink: Any, metadata: Mapping[str, str] | None = None) -> pq.ParquetWriter:
    """Open a Parquet file of steps for writing, with page checksums."""
    return pq.ParquetWriter(
        sink,
        FILE_SCHEMA.with_metadata(metadata),
        compression="zstd",
        use_dictionary=STRING_COLUMNS,
        column_encoding=dict.fromkeys(_NUMBER_COLUMNS, "BYTE_STREAM_SPLIT"),
        write_page_checksum=True,
        # Statistics of hashes and of unordered numbers let no reader skip anything.
        write_statistics=False,
        # Without Arrow's schema a table reads as its plain column types in any program; only with
        # it are metadata written.
        store_schema=metadata is not None,
    )


def write_row_group(writer: pq.ParquetWriter, table: pa.Table) -> None:
    """Write steps as one row group of a Parquet file; nothing of a table without rows."""
    if table.num_rows:
        whole = table.unify_dictionaries().combine_chunks()
        writer.write_table(
            whole.replace_schema_metadata(writer.schema.metadata), row_group_size=len(table)
        )


def add_missing_step_columns(table: pa.Table) -> pa.Table:
    """Return a table of steps with all columns of `steps.parquet`; ValueError for wrong types."""
    return _cast_columns(table, STEP_COLUMNS, FILE_SCHEMA)


def _cast_columns(table: pa.Table, columns: Columns, schema: pa.Schema) -> pa.Table:
    """Return an Arrow table with exactly these columns, cast to a schema; absent ones empty."""
    arrays = {name: table[name] for name in table.column_names if name in columns}
    return _make_table_of_all_columns(arrays, len(table), columns).cast(schema)


def write_runs(path: Path, runs: pa.Table, metadata: Mapping[str, str]) -> None:
    """Write a table of runs to a Parquet file with `metadata`, whole or not at all."""
    part = create_empty_file(path.with_name(f"{path.name}.part"))
    try:
        table = runs.replace_schema_metadata(dict(metadata))
        pq.write_table(table, part, compression="zstd", write_page_checksum=True)
        rename_durably(part, path)
    finally:
        part.unlink(missing_ok=True)


def runs_from_frame(frame: pd.DataFrame) -> pa.Table:
    """Return a data frame of runs as an Arrow table, its study columns last."""
    runs = convert_to_run_columns(frame).reset_index(drop=True)
    keys = pa.Schema.from_pandas(runs[[name for name in runs if name not in RUN_COLUMNS]])
    schema = pa.schema([*RUNS_SCHEMA, *keys])
    return pa.Table.from_pandas(runs, schema, preserve_index=False)


def add_missing_run_columns(table: pa.Table) -> pa.Table:
    """Return a table of runs with all columns of `runs.parquet`; ValueError for wrong types."""
    return _refuse_missing_numbers(_cast_columns(table, RUN_COLUMNS, RUNS_SCHEMA))


def convert_to_nullable_frame(table: pa.Table) -> pd.DataFrame:
    """Return an Arrow table as a data frame with nullable whole numbers."""
    whole = {pa.int64(): pd.Int64Dtype()}
    frame: pd.DataFrame = table.replace_schema_metadata(None).to_pandas(
        types_mapper=whole.get, use_threads=False
    )
    return frame


def runs_to_frame(table: pa.Table) -> pd.DataFrame:
    """Return an Arrow table of runs as a data frame, indexed by run_id."""
    for at, (name, (dtype, _)) in enumerate(RUN_COLUMNS.items()):
        if dtype == "bool" and table[name].null_count:
            table = table.set_column(at, name, pc.fill_null(table[name], False))
    runs = convert_to_nullable_frame(table)
    for name in _WHOLE_NUMBERS:
        runs[name] = runs[name].astype("int64")
    return runs.set_index("run_id", drop=False)


def filter_steps_by_run_id(table: pa.Table, names: Container[str]) -> pa.Table:
    """Return the rows of a table of steps whose run_id is in `names`."""
    coded = table["run_id"].combine_chunks()
    wanted = np.array([name in names for name in coded.dictionary.to_pylist()], dtype=np.bool_)
    if not wanted.any():
        # A slice would keep the whole table in memory.
        return table.schema.empty_table()
    return table if wanted.all() else table.filter(pa.array(wanted[coded.indices.to_numpy()]))


def filter_and_rename_run_ids(table: pa.Table, names: Mapping[str, str]) -> pa.Table:
    """Return the rows of a table of steps whose run_id is in `names`, under new run_ids."""
    some = filter_steps_by_run_id(table, names)
    coded = some["run_id"].combine_chunks()
    new = pa.array([names.get(name, name) for name in coded.dictionary.to_pylist()], pa.string())
    renamed = pa.DictionaryArray.from_arrays(coded.indices, new).cast(_CODED_STRING)
    return some.set_column(0, "run_id", renamed)


Row = dict[str, Any]
"""A row of `runs.parquet`, by column."""
RUNS = "runs"
"""Key in the metadata of a part that holds the columns of its runs."""
DAMAGE = (OSError, ValueError, KeyError, TypeError, IndexError, pa.ArrowException)
"""Exceptions that reading a damaged record or table raises."""


def _convert_to_json_value(value: object) -> object:
    """Return a NumPy number as a Python one for JSON, a missing one as None; TypeError else."""
    if value is pd.NA:
        return None
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} in a row")


@dataclass(frozen=True, eq=False)
class BatchPart:
    """The finished runs of a batch: the outcome of each by run_id, and the bytes of their file."""

    outcomes: Mapping[str, str]
    data: bytes


def make_batch_part(cells: Mapping[str, tuple[Row, pa.RecordBatch]]) -> BatchPart:
    """Return the Parquet file, as bytes, of a batch's finished runs with their steps."""
    steps = join_steps_of_runs({name: batch for name, (_, batch) in cells.items()})
    return encode_part(rows_to_columns([row for row, _ in cells.values()]), steps)


def encode_part(columns: Mapping[str, Sequence[Any]], steps: pa.Table) -> BatchPart:
    """Return the Parquet file, as bytes, of runs given by columns and all their steps."""
    outcomes = dict(zip(columns["run_id"], columns["outcome"], strict=True))
    sink = pa.BufferOutputStream()
    metadata = {RUNS: json.dumps(columns, default=_convert_to_json_value)}
    with open_step_writer(sink, metadata) as writer:
        write_row_group(writer, steps)
    return BatchPart(outcomes, sink.getvalue().to_pybytes())


def parse_batch_part(data: bytes) -> BatchPart:
    """Return a batch's finished runs from its file's bytes; an error of `DAMAGE` if damaged."""
    columns = parse_runs_of_part(pq.read_metadata(pa.BufferReader(data)).metadata)
    return BatchPart(dict(zip(columns["run_id"], columns["outcome"], strict=True)), data)


def parse_runs_of_part(metadata: Mapping[bytes, bytes] | None) -> dict[str, list[Any]]:
    """Return the runs, by column, in a batch file's metadata; raise one of `DAMAGE` without any."""
    try:
        columns = json.loads((metadata or {})[RUNS.encode()])
    except RecursionError as error:
        raise ValueError("runs that are nested too deeply") from error
    values = columns.values() if isinstance(columns, dict) else []
    sizes = {len(column) if isinstance(column, list) else -1 for column in values}
    if len(sizes) != 1 or -1 in sizes or "run_id" not in columns:
        raise ValueError("no columns of runs")
    found: dict[str, list[Any]] = columns
    return found
