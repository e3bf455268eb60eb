"""The steps of a result folder, asked for by run and by column: never the whole of them at once.

    scan    all runs that are wanted, in the order of the table, some hundred thousand rows each
    of      one run, wherever it stands

A file is read row group by row group, and of each the columns alone that are asked for, or that
what is asked for follows from; row groups without a wanted run are not read. So memory is that of
one row group, however many runs there are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from dpbench.bench.record.schema import (
    ADDED,
    DERIVED,
    RENAMED,
    STEP_COLUMNS,
    Columns,
    as_columns,
    as_steps,
)
from dpbench.bench.record.step_table import (
    ARROW,
    OF_CLOCK,
    OF_FILE,
    WORDS,
    is_complete,
    needed_for,
    of_runs,
    with_derived,
)
from dpbench.errors import ResultsError, renamed
from dpbench.files.tables import in_full, opened_table

ALL = tuple(STEP_COLUMNS)
KEPT_GROUPS = 2
"""So many row groups, each with the columns that were asked for, are kept for the next question."""


class StepTable(ABC):
    """The rows of `steps.parquet`, those of a run behind each other.

    Attributes
    ----------
    rows : how many there are.
    """

    rows: int

    @abstractmethod
    def scan(
        self, columns: Sequence[str], run_ids: Container[str] | None = None
    ) -> Iterator[pd.DataFrame]:
        """The rows of whole runs, some hundred thousand at a time, with some of `STEP_COLUMNS`.

        Parameters
        ----------
        run_ids : only the steps of these runs; None for all.

        Raises
        ------
        ResultsError : the file is damaged where it is read.
        """

    @abstractmethod
    def of(self, run_id: str, columns: Sequence[str] = ALL) -> pd.DataFrame:
        """The rows of one run; none where it left none. Raises as `scan` does."""

    @abstractmethod
    def frame(self) -> pd.DataFrame:
        """All rows with all columns, in memory."""


class StepsInMemory(StepTable):
    """The rows of a data frame with the columns of `STEP_COLUMNS`."""

    def __init__(self, frame: pd.DataFrame) -> None:
        self._frame, self.rows = frame, len(frame)

    def scan(
        self, columns: Sequence[str], run_ids: Container[str] | None = None
    ) -> Iterator[pd.DataFrame]:
        """All of them in one table."""
        some = self._frame[list(columns)]
        if run_ids is not None:
            wanted = [
                np.full(end - first, name in run_ids) for name, (first, end) in self._places.items()
            ]
            some = some[np.concatenate([np.zeros(0, dtype=np.bool_), *wanted])]
        if len(some):
            yield some

    def of(self, run_id: str, columns: Sequence[str] = ALL) -> pd.DataFrame:
        """A slice of the table."""
        first, end = self._places.get(run_id, (0, 0))
        return self._frame.iloc[first:end][list(columns)]

    def frame(self) -> pd.DataFrame:
        """The table itself."""
        return self._frame

    @cached_property
    def _places(self) -> dict[str, tuple[int, int]]:
        return places_of(self._frame["run_id"])


@dataclass(frozen=True)
class _Piece:
    """The runs that begin in a row group, and the groups that hold them: that one alone, unless an
    early release cut the last run in two. Of each run the first row and the one behind its last."""

    groups: list[int]
    places: dict[str, tuple[int, int]]

    @property
    def rows(self) -> slice:
        """Where they stand."""
        places = list(self.places.values())
        return slice(places[0][0], places[-1][1])

    def goes_on(self, rows: int, group: int, in_group: int) -> _Piece:
        """With `in_group` rows more of its last run, in a group behind its `rows` rows."""
        last = list(self.places)[-1]
        longer = self.places[last][0], rows + in_group
        return _Piece([*self.groups, group], self.places | {last: longer})


class StepsOnDisk(StepTable):
    """The rows of the `steps.parquet` of a result folder.

    Raises
    ------
    ResultsError : the file is missing or damaged, or lacks a column, or one is of another type.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._path = folder, folder / "steps.parquet"
        with readable(self._path), opened_table(self._path, error=ResultsError) as file:
            schema, self.rows = file.schema_arrow, file.metadata.num_rows
        self._stored = {RENAMED.get(name, name): name for name in schema.names}
        self._complete = is_complete(self._stored)
        self._check(schema)
        self._read = lru_cache(maxsize=KEPT_GROUPS)(self._piece)

    def tables(
        self, columns: Sequence[str], run_ids: Container[str] | None = None
    ) -> Iterator[pa.Table]:
        """As `scan`, as Arrow tables."""
        for piece in self._pieces:
            names = piece.places if run_ids is None else [n for n in piece.places if n in run_ids]
            if names:
                rows = piece.rows
                table = self._table(piece.groups, columns)
                table = table.slice(rows.start, rows.stop - rows.start)
                if len(names) < len(piece.places):
                    table = of_runs(table, set(names))
                yield table.select(list(columns))

    def scan(
        self, columns: Sequence[str], run_ids: Container[str] | None = None
    ) -> Iterator[pd.DataFrame]:
        """A row group, or what is wanted of it, at a time."""
        for table in self.tables(columns, run_ids):
            yield _as_frame(table, columns)

    def of(self, run_id: str, columns: Sequence[str] = ALL) -> pd.DataFrame:
        """Out of its row group, which is kept for the runs beside it."""
        at = self._piece_of.get(run_id)
        if at is None:
            return as_columns(pd.DataFrame(), _chosen(columns))
        first, end = self._pieces[at].places[run_id]
        return self._read(at, tuple(columns)).iloc[first:end]

    def frame(self) -> pd.DataFrame:
        """The whole file."""
        tables = [_as_frame(table, ALL) for table in self.tables(ALL)]
        return as_steps(pd.concat(tables, ignore_index=True) if tables else pd.DataFrame())

    def _check(self, schema: pa.Schema) -> None:
        """That the file has the columns of a step table, of their types."""
        wanted = set(STEP_COLUMNS) - ADDED - (set() if self._complete else set(DERIVED))
        missing = sorted(wanted - set(self._stored))
        if missing:
            raise lacking(self._path, missing)
        old = [name for name in self._stored.values() if name in RENAMED]
        if old:
            now = ", ".join(RENAMED[name] for name in old)
            renamed(str(self._path), f"column {', '.join(old)}", now)
        for name, stored in self._stored.items():
            if name in STEP_COLUMNS and not _fits(schema.field(stored).type, name):
                raise of_another_type(self._path, f"{stored}: {schema.field(stored).type}")

    @cached_property
    def _pieces(self) -> list[_Piece]:
        pieces: list[_Piece] = []
        rows = 0
        with readable(self._path), pq.ParquetFile(self._path, read_dictionary=["run_id"]) as file:
            for group in range(file.num_row_groups):
                names = file.read_row_group(group, columns=["run_id"])["run_id"]
                places = places_of(names.combine_chunks().to_pandas())
                if pieces and (last := list(pieces[-1].places)[-1]) in places:
                    pieces[-1] = pieces[-1].goes_on(rows, group, places.pop(last)[1])
                    rows += len(names)
                if places:
                    pieces.append(_Piece([group], places))
                    rows = len(names)
        return pieces

    @cached_property
    def _piece_of(self) -> dict[str, int]:
        return {name: at for at, piece in enumerate(self._pieces) for name in piece.places}

    def _piece(self, at: int, columns: tuple[str, ...]) -> pd.DataFrame:
        return _as_frame(self._table(self._pieces[at].groups, columns), columns)

    def _table(self, groups: list[int], columns: Sequence[str]) -> pa.Table:
        """Some columns of some row groups, and `run_id`."""
        asked = list(dict.fromkeys(["run_id", *columns]))
        needed = asked if self._complete else needed_for(asked)
        stored = {name: self._stored[name] for name in needed if name in self._stored}
        with readable(self._path):
            words = [self._stored[name] for name in WORDS]
            with pq.ParquetFile(self._path, read_dictionary=words) as file:
                table = file.read_row_groups(groups, columns=list(stored.values()))
            table = table.select(list(stored.values())).rename_columns(list(stored))
            for name in [name for name in needed if name not in stored]:
                missing = pa.nulls(len(table), ARROW[STEP_COLUMNS[name][0]])
                table = table.append_column(name, missing)
            return table if self._complete else with_derived(table, asked, self._clock)

    @cached_property
    def _clock(self) -> pd.DataFrame:
        """`OF_CLOCK` by run_id; where the runs cannot be read, none."""
        return read_clock(self._folder)


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
    yield from StepsOnDisk(Path(out)).tables(columns, run_ids)


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
    with readable(path):
        with opened_table(path, error=ResultsError) as file:
            wanted = [name for name in ("run_id", *OF_CLOCK) if name in file.schema_arrow.names]
            table = in_full(file.read(columns=wanted), path, error=ResultsError)
        clock: pd.DataFrame = table.to_pandas(ignore_metadata=True)
        return clock.set_index("run_id")


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """What goes wrong as a table is read, as `ResultsError`."""
    try:
        yield
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        if isinstance(error, ResultsError):
            raise
        raise ResultsError(
            str(path), "", f"a damaged file ({str(error)[:120]})", "a parquet table; run again"
        ) from error


def lacking(path: Path, columns: Sequence[str]) -> ResultsError:
    """That a table has not some columns."""
    named = ", ".join(columns[:3]) + (", …" if len(columns) > 3 else "")
    return ResultsError(str(path), named, "no such columns", "the columns of schema.py")


def of_another_type(path: Path, which: str) -> ResultsError:
    """That a table has other things in a column."""
    return ResultsError(
        str(path), "", f"a column of another type ({which})", "the types of schema.py"
    )


def places_of(labels: pd.Series[Any] | np.ndarray) -> dict[str, tuple[int, int]]:
    """Of labels (N,) that are ordered: the first place of each, and the one after its last."""
    codes, names = pd.factorize(labels)
    ends = np.append(np.flatnonzero(np.diff(codes)) + 1, len(codes)).tolist() if len(codes) else []
    return dict(zip(map(str, names), zip([0, *ends], ends, strict=False), strict=True))


def _chosen(columns: Sequence[str]) -> Columns:
    return {name: STEP_COLUMNS[name] for name in columns}


def _as_frame(table: pa.Table, columns: Sequence[str]) -> pd.DataFrame:
    """Some columns of a table with the types of the schema; the few words stay a word each."""
    whole = {pa.int64(): pd.Int64Dtype()}
    frame: pd.DataFrame = table.select(list(columns)).to_pandas(types_mapper=whole.get)
    types = {
        name: STEP_COLUMNS[name][0]
        for name in columns
        if not isinstance(frame[name].dtype, pd.CategoricalDtype)
    }
    return frame.astype({n: t for n, t in types.items() if frame[n].dtype != t})


def _fits(stored: pa.DataType, name: str) -> bool:
    """Whether a stored type can be that of a column; whole numbers of which some are missing may
    have become others in a program that has no such type."""
    number = (pa.types.is_integer, pa.types.is_floating)
    kinds = {
        "str": (pa.types.is_string, pa.types.is_large_string, pa.types.is_dictionary),
        "bool": (pa.types.is_boolean,),
    }
    known = kinds.get(STEP_COLUMNS[name][0], number)
    return pa.types.is_null(stored) or any(fits(stored) for fits in known)
