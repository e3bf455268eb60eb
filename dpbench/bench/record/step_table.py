"""Steps as Arrow: the columns a file stores of them, how they are written, and all of them again.

A table is of whole runs, each in one piece and in the order of its steps. In a file no run lies in
two row groups, so that each of these can be read by itself.
"""

from __future__ import annotations

from collections.abc import Collection, Container, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dpbench.arrays import Floats, Ints
from dpbench.bench.record.raw_log import OF_SOLVER
from dpbench.bench.record.schema import (
    ABSENT,
    DERIVED,
    RUN_COLUMNS,
    SAME_AS,
    STEP_COLUMNS,
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
STORED = [name for name in STEP_COLUMNS if name not in DERIVED]
"""The columns of `steps.parquet`."""
NAMES = pa.dictionary(pa.int32(), pa.string())
"""The type of words in memory: each is kept once for all its rows."""
OF_STEPS = pa.schema([(n, ARROW[STEP_COLUMNS[n][0]]) for n in STORED[1:]])
"""Stored steps of one run, which has its name elsewhere."""
WORDS = [name for name in STORED if STEP_COLUMNS[name][0] == "str"]
"""The columns of words: the same few over and over."""
OF_FILE = pa.schema(
    [(name, NAMES if name in WORDS else ARROW[STEP_COLUMNS[name][0]]) for name in STORED]
)
OF_RUNS = pa.schema([(name, ARROW[dtype]) for name, (dtype, _) in RUN_COLUMNS.items()])
_ENCODINGS = {
    "float64": "BYTE_STREAM_SPLIT",
    "Int64": "DELTA_BINARY_PACKED",
    "int32": "DELTA_BINARY_PACKED",
}
"""Floats are split into planes of bytes, so that the even ones among them compress; of whole
numbers the differences are stored."""
INSIDE = tuple(f"{phase}_ns" for phase in OF_SOLVER)
"""The columns of the phases that are the solver's."""
OF_CLOCK = ("sample_s", "first_sample", "every_sample")
"""Columns of `runs.parquet` that the times of steps follow from."""


def step_batch(steps: Mapping[str, NDArray[Any]]) -> pa.RecordBatch:
    """The stored columns of the steps of one run.

    Parameters
    ----------
    steps : (N,) arrays by the names of `STEP_COLUMNS`; whole numbers that are missing are
        `ABSENT`, and a column that is not there has no value in any row.
    """
    rows = len(steps["k"])
    arrays = [_array(name, steps, rows) for name in STORED[1:]]
    return pa.RecordBatch.from_arrays(arrays, schema=OF_STEPS)


def no_steps() -> pa.RecordBatch:
    """Those of a run that left none."""
    return pa.RecordBatch.from_arrays([pa.array([], f.type) for f in OF_STEPS], schema=OF_STEPS)


def _array(name: str, steps: Mapping[str, NDArray[Any]], rows: int) -> pa.Array:
    dtype = STEP_COLUMNS[name][0]
    if name not in steps:
        return (
            pa.array(np.zeros(rows, np.bool_)) if dtype == "bool" else pa.nulls(rows, ARROW[dtype])
        )
    values = steps[name]
    if dtype == "Int64":
        return pa.array(values, pa.int64(), mask=values == ABSENT)
    if dtype != "float64":
        return pa.array(values, ARROW[dtype])
    numbers = np.ascontiguousarray(values, dtype=np.float64)
    if name in SAME_AS:
        # Equal bit for bit: a zero of the other sign, or another NaN, is another number here.
        other = np.ascontiguousarray(steps[SAME_AS[name]], dtype=np.float64)
        return pa.array(numbers, mask=numbers.view(np.int64) == other.view(np.int64))
    return pa.array(numbers, mask=np.isnan(numbers))


def with_names(batches: Mapping[str, pa.RecordBatch]) -> pa.Table:
    """One table of the steps of several runs, by their names."""
    steps = pa.Table.from_batches(batches.values(), OF_STEPS)
    counts = [batch.num_rows for batch in batches.values()]
    codes = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    names = pa.DictionaryArray.from_arrays(codes, pa.array(list(batches), pa.string()))
    for name in WORDS[1:]:
        at = steps.schema.get_field_index(name)
        steps = steps.set_column(at, name, steps[name].dictionary_encode())
    return steps.add_column(0, "run_id", names).unify_dictionaries()


def step_writer(path: Path) -> pq.ParquetWriter:
    """Who writes a file of steps, each table of `OF_FILE` as one row group; each page carries its
    check sum."""
    types = {name: STEP_COLUMNS[name][0] for name in STORED}
    return pq.ParquetWriter(
        path,
        OF_FILE,
        compression="zstd",
        use_dictionary=WORDS,
        column_encoding={n: _ENCODINGS[t] for n, t in types.items() if t in _ENCODINGS},
        write_page_checksum=True,
        # A table reads as what its columns are, in whatever program, not as what they were here.
        store_schema=False,
    )


def write_steps(writer: pq.ParquetWriter, table: pa.Table) -> None:
    """Write whole runs as one row group."""
    if table.num_rows:
        writer.write_table(table, row_group_size=table.num_rows)


def write_runs(path: Path, runs: pd.DataFrame, metadata: Mapping[str, str]) -> None:
    """Write rows of `runs.parquet`, of its columns and types and with the keys of studies behind
    them, whole or not at all.

    Parameters
    ----------
    metadata : kept beside them in the file.
    """
    part, runs = new_file(path.with_name(f"{path.name}.part")), runs.reset_index(drop=True)
    try:
        keys = pa.Schema.from_pandas(runs[[name for name in runs if name not in RUN_COLUMNS]])
        schema = pa.schema([*OF_RUNS, *keys])
        table = pa.Table.from_pandas(runs, schema, preserve_index=False)
        table = table.replace_schema_metadata(dict(metadata))
        pq.write_table(table, part, compression="zstd", write_page_checksum=True)
        put(part, path)
    finally:
        part.unlink(missing_ok=True)


def stored_runs(table: pa.Table) -> pa.Table:
    """The columns of `OF_RUNS` of a table of runs; ValueError, or one of Arrow, where they are of
    other types."""
    if not set(OF_RUNS.names) <= set(table.column_names):
        table = pa.Table.from_pandas(as_runs(table.to_pandas()), OF_RUNS, preserve_index=False)
    return table.select(OF_RUNS.names).cast(OF_RUNS)


def frame_of_runs(table: pa.Table) -> pd.DataFrame:
    """A table of `OF_RUNS` as a frame, by run_id."""
    whole = {pa.int64(): pd.Int64Dtype()}
    runs: pd.DataFrame = as_runs(table.to_pandas(types_mapper=whole.get))
    return runs.set_index("run_id", drop=False)


def of_runs(table: pa.Table, names: Container[str]) -> pa.Table:
    """The rows of those runs."""
    coded = table["run_id"].combine_chunks()
    wanted = np.array([name in names for name in coded.dictionary.to_pylist()], dtype=np.bool_)
    if not wanted.any():
        # A slice would hold on to all of the table.
        return table.schema.empty_table()
    return table if wanted.all() else table.filter(pa.array(wanted[coded.indices.to_numpy()]))


def renamed_runs(table: pa.Table, names: Mapping[str, str]) -> pa.Table:
    """The rows of those runs, under new names."""
    some = of_runs(table, names)
    coded = some["run_id"].combine_chunks()
    new = pa.array([names.get(name, name) for name in coded.dictionary.to_pylist()], pa.string())
    renamed = pa.DictionaryArray.from_arrays(coded.indices, new).cast(NAMES)
    return some.set_column(0, "run_id", renamed)


def is_complete(names: Collection[str]) -> bool:
    """Whether a file with those columns has all of them, as those of earlier schemas have."""
    return set(DERIVED) <= set(names)


def needed_for(columns: Sequence[str]) -> list[str]:
    """The stored columns that some columns of steps are made from, `run_id` among them."""
    needed = {"run_id"}
    for name in columns:
        needed |= {name} - set(DERIVED)
        if name in SAME_AS:
            needed.add(SAME_AS[name])
        if name == "t_s":
            needed.add("k")
        elif name == "total_ns":
            needed |= {*INSIDE, "allocation_ns"}
        elif name in DERIVED:
            needed |= {"k", name.removeprefix("d")}
    return [name for name in STORED if name in needed]


def with_derived(table: pa.Table, columns: Sequence[str], clock: pd.DataFrame) -> pa.Table:
    """The asked columns of a table of stored ones, those that follow from others among them.

    Parameters
    ----------
    table : whole runs, with the columns of `needed_for(columns)`.
    clock : `OF_CLOCK` by run_id.
    """
    return pa.table({name: _column(table, name, clock) for name in columns})


def _column(table: pa.Table, name: str, clock: pd.DataFrame) -> pa.ChunkedArray | pa.Array:
    if name in table.column_names:
        stored = table[name]
        return pc.coalesce(stored, table[SAME_AS[name]]) if name in SAME_AS else stored
    if name == "total_ns":
        total = total_of({n: _integers(table[n]) for n in (*INSIDE, "allocation_ns")})
        return pa.array(total, mask=total == ABSENT)
    k = table["k"].to_numpy()
    if name == "t_s":
        return pa.array(_times(table["run_id"], k, clock), from_pandas=True)
    applied = table[name.removeprefix("d")].to_numpy()
    return pa.array(change_of(applied, k), from_pandas=True)


def _integers(column: pa.ChunkedArray) -> Ints:
    whole: Ints = column.cast(pa.int64()).fill_null(ABSENT).to_numpy()
    return whole


def _times(names: pa.ChunkedArray, k: NDArray[Any], clock: pd.DataFrame) -> Floats:
    """The times of steps (N,) of the runs `names` (N,)."""
    coded = names.combine_chunks()
    coded = coded if pa.types.is_dictionary(coded.type) else coded.dictionary_encode()
    codes = coded.indices.to_numpy()
    of_runs = clock.reindex(coded.dictionary.to_pandas())
    sample_s, first, every = (
        of_runs[name].to_numpy(np.float64, na_value=np.nan) for name in OF_CLOCK
    )
    known = ~np.isnan(first)
    starts, strides = (np.where(known, n, 0.0).astype(np.int64)[codes] for n in (first, every))
    return times_of(k, starts, strides, np.where(known, sample_s, np.nan)[codes])


def total_of(steps: Mapping[str, NDArray[Any]]) -> Ints:
    """(N,) the time of each step: of its phases, and of the second QP of a cascade.

    Each (N,) of whole nanoseconds, `ABSENT` where there is none; so is their sum where no phase
    is there.
    """
    phases = [steps[phase] for phase in INSIDE]
    parts = [*phases, steps["allocation_ns"]] if "allocation_ns" in steps else phases
    total = np.zeros(len(phases[0]), dtype=np.int64)
    for part in parts:
        total += np.maximum(part, 0)
    total[np.maximum.reduce(phases) < 0] = ABSENT
    return total


def change_of(values: Floats, k: NDArray[Any]) -> Floats:
    """(N,) change against the row before; against zero where a run begins, at k = 0."""
    before = np.roll(values, 1)
    before[k == 0] = 0.0
    change: Floats = values - before
    return change


def times_of(
    k: NDArray[Any],
    first: Ints | int,
    every: Ints | int,
    sample_s: Floats | float,
) -> Floats:
    """(N,) time of each step k (N,) [s]: (first + every·k)·sample_s."""
    t_s: Floats = (first + every * k) * sample_s
    return t_s
