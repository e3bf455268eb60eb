"""Finished cells on their way from the process that judged them into a result folder.

A part is the cells of a batch: a Parquet file with the steps in one row group, of the columns of
`steps.parquet`, and the columns of `runs.parquet` as JSON in its metadata.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from dpbench.bench.record.step_table import columns_of, concat_runs, encode_steps

Row = dict[str, Any]
"""A row of `runs.parquet`, by column."""
RUNS = "runs"
"""Where the metadata of a part have the columns of its runs."""
DAMAGE = (OSError, ValueError, KeyError, TypeError, IndexError, pa.ArrowException)
"""What reading a damaged record or table raises."""


def _plain(value: object) -> object:
    """Return a number of NumPy, or a missing one, as JSON has it."""
    if value is pd.NA:
        return None
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} in a row")


@dataclass(frozen=True, eq=False)
class BatchPart:
    """The finished cells of a batch: the outcome of each by run_id, and the bytes of the part."""

    outcomes: Mapping[str, str]
    data: bytes


def batch_part(cells: Mapping[str, tuple[Row, pa.RecordBatch]]) -> BatchPart:
    """Return a part of cells, each a row and steps, by run_id."""
    steps = concat_runs({name: batch for name, (_, batch) in cells.items()})
    return part_of(columns_of([row for row, _ in cells.values()]), steps)


def part_of(columns: Mapping[str, Sequence[Any]], steps: pa.Table) -> BatchPart:
    """Return a part of the columns of runs and of all their steps (`FILE_SCHEMA`)."""
    outcomes = dict(zip(columns["run_id"], columns["outcome"], strict=True))
    return BatchPart(outcomes, encode_steps(steps, {RUNS: json.dumps(columns, default=_plain)}))


def read_part(data: bytes) -> BatchPart:
    """Return the part in the bytes of a file; one of `DAMAGE` where there is none."""
    columns = runs_in(pq.read_metadata(pa.BufferReader(data)).metadata)
    return BatchPart(dict(zip(columns["run_id"], columns["outcome"], strict=True)), data)


def runs_in(metadata: Mapping[bytes, bytes] | None) -> dict[str, list[Any]]:
    """Return the columns of runs in the metadata of a part; one of `DAMAGE` without any."""
    try:
        columns = json.loads((metadata or {})[RUNS.encode()])
    except RecursionError as error:
        raise ValueError("runs that are nested too deep") from error
    values = columns.values() if isinstance(columns, dict) else []
    sizes = {len(column) if isinstance(column, list) else -1 for column in values}
    if len(sizes) != 1 or -1 in sizes or "run_id" not in columns:
        raise ValueError("no columns of runs")
    found: dict[str, list[Any]] = columns
    return found
