"""The steps of a result folder by run and column, read row group by row group.

Only requested columns are read, and only row groups with requested runs: memory is that of one row
group, however many runs there are.
"""

from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from dpbench.bench.record.schema import STEP_COLUMNS, convert_to_columns, convert_to_step_columns
from dpbench.bench.record.step_table import (
    FILE_SCHEMA,
    STRING_COLUMNS,
    convert_to_nullable_frame,
    filter_steps_by_run_id,
    make_placeholder_column,
)
from dpbench.errors import ResultsError
from dpbench.files.tables import open_untrusted_parquet_table

ALL_COLUMNS = tuple(STEP_COLUMNS)
KEY_COLUMNS = {"run_id", "repeat", "k"}
"""The columns that name a step, without which a table is none of steps."""
STEPS_NEEDED = (
    "a new run of the suite; without steps, only `runs`, `tables`, `verdict()`, `ladder()`, "
    "`ships()`, `to_latex()` and `to_csv()` are available"
)
"""Remedy in a folder without steps, and the data that are available there."""
_NOT_PUBLISHED = (
    "a folder with steps. This one was published without them: open its report.html, or repeat "
    "its run with `dpbench run SUITE`"
)
CACHED_GROUPS = 2
"""Number of row groups, with the columns requested, that are kept for the next request."""


class StepsOnDisk:
    """The rows of a result folder's `steps.parquet`, read on demand; ResultsError if damaged.

    A file that `is_optional` and missing has no rows.
    """

    def __init__(self, folder: Path, *, is_optional: bool = False) -> None:
        self._path, self.is_missing = folder / "steps.parquet", False
        if is_optional and not self._path.exists():
            self.rows, self._row_ranges_by_group_and_run, self.is_missing = 0, [], True
            return
        if (folder / "runs.parquet").exists() and not self._path.exists():
            raise ResultsError(str(self._path), "", "no such file", _NOT_PUBLISHED)
        with (
            convert_table_errors(self._path),
            open_untrusted_parquet_table(self._path, error=ResultsError) as file,
        ):
            schema, self.rows = file.schema_arrow, file.metadata.num_rows
        self._stored = set(schema.names)
        self._refuse_wrong_columns(schema)
        self._read = lru_cache(maxsize=CACHED_GROUPS)(
            lambda group, columns: _convert_table_to_frame(
                self._read_group(group, columns), columns
            )
        )

    def yield_tables(
        self, columns: Sequence[str], run_ids: Container[str] | None = None
    ) -> Iterator[pa.Table]:
        """Yield the wanted columns of some runs as Arrow tables, one per row group."""
        for group, places in enumerate(self._row_ranges_by_group_and_run):
            names = places if run_ids is None else [name for name in places if name in run_ids]
            if names:
                table = self._read_group(group, columns)
                if len(names) < len(places):
                    table = filter_steps_by_run_id(table, set(names))
                yield table.select(list(columns))

    def scan(
        self, columns: Sequence[str], run_ids: Container[str] | None = None
    ) -> Iterator[pd.DataFrame]:
        """Yield columns of some runs (None: all) as data frames; ResultsError if damaged."""
        for table in self.yield_tables(columns, run_ids):
            yield _convert_table_to_frame(table, columns)

    def read_run(self, run_id: str, columns: Sequence[str] = ALL_COLUMNS) -> pd.DataFrame:
        """Return the steps of one run; its row group stays in memory for the next call.

        Raises
        ------
        ResultsError : in a folder without the file.
        """
        self.require_file()
        group = self._group_index_by_run.get(run_id)
        if group is None:
            return convert_to_columns(
                pd.DataFrame(), {name: STEP_COLUMNS[name] for name in columns}
            )
        first, end = self._row_ranges_by_group_and_run[group][run_id]
        return self._read(group, tuple(columns)).iloc[first:end]

    def require_file(self) -> None:
        """Raise ResultsError in a folder without `steps.parquet`."""
        if self.is_missing:
            raise ResultsError(str(self._path), "", "no such file", STEPS_NEEDED)

    def read_all_steps(self) -> pd.DataFrame:
        """Return the steps of all runs as one data frame."""
        tables = [
            _convert_table_to_frame(table, ALL_COLUMNS) for table in self.yield_tables(ALL_COLUMNS)
        ]
        return convert_to_step_columns(
            pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
        )

    def _refuse_wrong_columns(self, schema: pa.Schema) -> None:
        """Raise ResultsError if a key column is missing or any known column has a wrong type."""
        missing = sorted(KEY_COLUMNS - self._stored)
        if missing:
            raise make_missing_columns_error(self._path, missing)
        for name in STEP_COLUMNS.keys() & self._stored:
            if not _is_type_readable_as_column(schema.field(name).type, name):
                raise make_wrong_type_error(self._path, f"{name}: {schema.field(name).type}")

    @cached_property
    def _row_ranges_by_group_and_run(self) -> list[dict[str, tuple[int, int]]]:
        """Each run's first row, and the row after its last, per row group of `steps.parquet`."""
        with (
            convert_table_errors(self._path),
            pq.ParquetFile(self._path, read_dictionary=["run_id"]) as file,
        ):
            groups = [
                file.read_row_group(group, columns=["run_id"])["run_id"]
                for group in range(file.num_row_groups)
            ]
            return [
                find_row_ranges_by_label(names.combine_chunks().to_pandas()) for names in groups
            ]

    @cached_property
    def _group_index_by_run(self) -> dict[str, int]:
        """Index of the Parquet row group that holds each run's steps, by run_id."""
        return {
            name: group
            for group, places in enumerate(self._row_ranges_by_group_and_run)
            for name in places
        }

    def _read_group(self, group: int, columns: Sequence[str]) -> pa.Table:
        """Return columns of a row group of `steps.parquet` as an Arrow table, absent ones empty."""
        asked = list(dict.fromkeys(["run_id", *columns]))
        stored = [name for name in asked if name in self._stored]
        strings = [name for name in STRING_COLUMNS if name in stored]
        with (
            convert_table_errors(self._path),
            pq.ParquetFile(self._path, read_dictionary=strings) as file,
        ):
            table = file.read_row_group(group, columns=stored)
        for name in [name for name in asked if name not in self._stored]:
            table = table.append_column(
                name, make_placeholder_column(STEP_COLUMNS[name][0], len(table))
            )
        return table.select(asked)


def scan_steps(
    out: str | Path, columns: Sequence[str], run_ids: Container[str] | None = None
) -> Iterator[pa.Table]:
    """Yield columns of `steps.parquet` as Arrow tables, whole runs at a time.

    Memory is that of one such table, whatever the number of runs.

    Parameters
    ----------
    columns : of `STEP_COLUMNS`; only these are read.
    run_ids : only the steps of these runs; None for all.

    Raises
    ------
    ResultsError : naming the file, when it is missing or damaged, or has no such column.
    """
    yield from StepsOnDisk(Path(out)).yield_tables(columns, run_ids)


def read_steps(
    out: str | Path, columns: Sequence[str], run_ids: Container[str] | None = None
) -> pa.Table:
    """Return columns of `steps.parquet` as one Arrow table."""
    tables = list(scan_steps(out, columns, run_ids))
    if tables:
        return pa.concat_tables(tables).unify_dictionaries()
    return pa.table({name: pa.array([], FILE_SCHEMA.field(name).type) for name in columns})


@contextmanager
def convert_table_errors(path: Path) -> Iterator[None]:
    """Turn errors of reading a Parquet table within the block into `ResultsError`."""
    try:
        yield
    except (OSError, ValueError, TypeError, KeyError, pa.ArrowException) as error:
        if isinstance(error, ResultsError):
            raise
        raise ResultsError(
            str(path), "", "a damaged file", "a Parquet table; run the suite again"
        ) from error


def make_missing_columns_error(path: Path, columns: Sequence[str]) -> ResultsError:
    """Return the `ResultsError` for a table that lacks columns."""
    named = ", ".join(columns[:3]) + (", …" if len(columns) > 3 else "")
    return ResultsError(
        str(path),
        named,
        "no such column" if len(columns) == 1 else "no such columns",
        "the columns that `run_campaign()` writes",
    )


def make_wrong_type_error(path: Path, which: str) -> ResultsError:
    """Return the `ResultsError` for a table with a column of another type."""
    found = f"a column of another type ({which})"
    return ResultsError(str(path), "", found, "the types that `run_campaign()` writes")


def find_row_ranges_by_label(labels: "pd.Series[Any] | np.ndarray") -> dict[str, tuple[int, int]]:
    """Return the first row of each label in sorted labels (N,), and the row after its last."""
    codes, names = pd.factorize(labels)
    ends = np.append(np.flatnonzero(np.diff(codes)) + 1, len(codes)).tolist() if len(codes) else []
    return dict(zip(map(str, names), zip([0, *ends], ends, strict=False), strict=True))


def _convert_table_to_frame(table: pa.Table, columns: Sequence[str]) -> pd.DataFrame:
    """Return columns of an Arrow table as a data frame with the schema's types."""
    frame = convert_to_nullable_frame(table.select(list(columns)))
    types = {
        name: STEP_COLUMNS[name][0]
        for name in columns
        if not isinstance(frame[name].dtype, pd.CategoricalDtype)
    }
    return frame.astype({n: t for n, t in types.items() if frame[n].dtype != t})


def _is_type_readable_as_column(stored: pa.DataType, name: str) -> bool:
    """Return whether a stored type can be read as a column's; integers may be floats."""
    number = (pa.types.is_integer, pa.types.is_floating)
    kinds = {
        "str": (pa.types.is_string, pa.types.is_large_string, pa.types.is_dictionary),
        "bool": (pa.types.is_boolean,),
    }
    known = kinds.get(STEP_COLUMNS[name][0], number)
    return pa.types.is_null(stored) or any(fits(stored) for fits in known)
