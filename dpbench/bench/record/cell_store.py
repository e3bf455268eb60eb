"""Finished cells on disk: parts while a campaign runs, the public tables at its end.

The cells of a batch are one file in `cells/`, a part with its checksum in its name. At the end of a
campaign all parts become `steps.parquet` and `runs.parquet`. A cell is finished when its row is in
a part or in `runs.parquet` and its steps can be read. Of several copies, as after a kill, the
latest counts.
"""

import json
import re
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from dpbench.bench.record.cell import OUTCOMES
from dpbench.bench.record.schema import SCHEMA_VERSION
from dpbench.bench.record.step_table import (
    DAMAGE,
    FILE_SCHEMA,
    NO_RUNS,
    BatchPart,
    add_missing_run_columns,
    add_missing_step_columns,
    build_runs_table,
    encode_part,
    filter_steps_by_run_id,
    open_step_writer,
    parse_runs_of_part,
    runs_to_frame,
    write_row_group,
    write_runs,
)
from dpbench.errors import InputError
from dpbench.files.regular_files import (
    create_empty_file,
    make_folder_if_missing,
    open_regular_file,
    rename_durably,
    write_bytes_atomically,
)
from dpbench.files.tables import decode_dictionary_columns_to_text, open_untrusted_parquet_table

PART_CELLS = 256
"""Cells of a part that is made of others, at most."""
GROUP_ROWS = 2**17
"""Rows of a row group of `steps.parquet`, unless a single run has more."""
CHECKED_ROWS = 512
"""Rows of runs that are looked through at a time."""
_FINISHED = sorted(set(OUTCOMES) - {"lost", "invalid"})
_CHECKSUM_KEY = "steps_crc32"
"""Key in the metadata of `runs.parquet` that holds the checksum of the file of its steps."""
_LAST_PART_KEY = "last_part"
"""Key there that holds the number of the last part before it was written; later ones are newer."""
_PART = re.compile(r"part-(?P<number>\d{5}|[1-9]\d{5,8})-(?P<crc32>[0-9a-f]{8})\.parquet")
_UNFINISHED_FILE = re.compile(
    r"(?:part-|exact-|design-)[\w-]+(?:\.\w+)*\.part|exact-\w+(?:\.part)+\.npz"
)
"""Names of files that are still being written."""
_OWN_FILE = re.compile(
    rf"{_PART.pattern}|{_UNFINISHED_FILE.pattern}|exact-\w+\.npz|design-\w+\.json|\.\w+"
)
"""The names of all files that campaigns write beside their cells."""


@dataclass(frozen=True, eq=False)
class StepGroup:
    """Step rows of the runs `names` in a row group of a Parquet file, read on demand."""

    names: list[str]
    read: Callable[[], pa.Table]

    def read_table(self) -> pa.Table:
        """Return the steps of these runs as an Arrow table; an error of `DAMAGE` if unreadable."""
        return filter_steps_by_run_id(add_missing_step_columns(self.read()), set(self.names))


class Source(ABC):
    """Files that finished runs are read from: the result tables, or one batch's file."""

    steps: Path

    @abstractmethod
    def iterate_rows(self) -> Iterator[pa.Table]:
        """Yield rows of finished runs as Arrow tables; an error of `DAMAGE` if damaged."""

    @abstractmethod
    def is_undamaged(self) -> bool:
        """Return whether the file of steps is undamaged, by its checksum."""

    def read_rows(self, columns: Sequence[str] = ()) -> pa.Table:
        """Return some or all columns of finished runs as one table; no rows if unreadable."""
        none = NO_RUNS.select(columns or NO_RUNS.column_names)
        try:
            # One after the other, as whole tables are large.
            some = (table.select(none.column_names) for table in self.iterate_rows())
            return pa.concat_tables([none, *some])
        except DAMAGE:
            return none

    def read_outcomes_by_run_id(self) -> dict[str, str]:
        """Return the outcome of finished runs by run_id, without runs whose steps are damaged."""
        finished: dict[str, str] = {}
        try:
            for table in self.iterate_rows():
                key = (table[name].to_pylist() for name in ("run_id", "outcome"))
                finished |= dict(zip(*key, strict=True))
        except DAMAGE:
            return {}
        if not finished or self.is_undamaged():
            return finished
        read = {name for group in self.yield_step_groups(finished) for name in group.names}
        return {name: outcome for name, outcome in finished.items() if name in read}

    def yield_step_groups(self, names: Collection[str]) -> Iterator[StepGroup]:
        """Yield the readable Parquet row groups with steps of the runs `names`."""
        checked = ["run_id"] if self.is_undamaged() else None
        with suppress(*DAMAGE), open_untrusted_parquet_table(self.steps) as file:
            for index in range(file.num_row_groups):
                try:
                    table = file.read_row_group(index, columns=checked)
                    there = pc.unique(table["run_id"]).to_pylist()
                except DAMAGE:
                    continue
                if own := [name for name in there if name in names]:
                    yield StepGroup(own, partial(file.read_row_group, index))


class PublicTables(Source):
    """The files `runs.parquet` and `steps.parquet` of a result folder."""

    def __init__(self, out: Path) -> None:
        self.runs, self.steps = out / "runs.parquet", out / "steps.parquet"

    def iterate_rows(self) -> Iterator[pa.Table]:
        """Yield the rows of finished runs in `runs.parquet`, some hundred at a time."""
        with open_untrusted_parquet_table(self.runs) as file:
            # All columns, which tells whether they can be read, of some rows at a time, as the
            # descriptions of cells are long. Threads would cost more than they save.
            for batch in file.iter_batches(batch_size=CHECKED_ROWS, use_threads=False):
                table = decode_dictionary_columns_to_text(pa.Table.from_batches([batch]), self.runs)
                yield _select_finished_rows(add_missing_run_columns(table))

    def read_run_ids(self) -> list[str]:
        """Return the run_ids of all rows of `runs.parquet`, in order."""
        try:
            with open_untrusted_parquet_table(self.runs) as file:
                return [str(n) for n in file.read(columns=["run_id"])["run_id"].to_pylist()]
        except DAMAGE:
            return []

    def is_undamaged(self) -> bool:
        """Return whether `steps.parquet` has the checksum noted in `runs.parquet`."""
        found = self._read_metadata().get(_CHECKSUM_KEY.encode())
        return found == b"%08x" % _compute_crc32_of_file(self.steps)

    def read_last_part_number(self) -> int:
        """Return the number of the last part that is no newer than these tables; 0 if unknown."""
        found = self._read_metadata().get(_LAST_PART_KEY.encode(), b"")
        # Of a foreign folder it may have any length; names of parts have nine digits at most.
        return int(found) if found.isdigit() and len(found) < 10 else 0

    def _read_metadata(self) -> dict[bytes, bytes]:
        """Return the metadata of `runs.parquet`; none where it is damaged or missing."""
        try:
            return pq.read_metadata(self.runs).metadata or {}
        except DAMAGE:
            return {}

    def write(self, rows: pa.Table, steps: "StepFile", last_part: int) -> None:
        """Move a finished file of steps to `steps.parquet`, then write `runs.parquet`.

        last_part : number of the last part that is written so far.
        """
        steps.close()
        noted = {
            _CHECKSUM_KEY: f"{_compute_crc32_of_file(steps.path):08x}",
            _LAST_PART_KEY: str(last_part),
        }
        rename_durably(steps.path, self.steps)
        write_runs(self.runs, rows, noted)


class Part(Source):
    """A Parquet file in the folder `cells` with the finished runs of one batch."""

    def __init__(self, steps: Path) -> None:
        self.steps = steps
        self._rows: pa.Table | None = None

    def iterate_rows(self) -> Iterator[pa.Table]:
        """Yield the rows of finished runs in a batch's file; ValueError if it is damaged."""
        if not self.is_undamaged():
            raise ValueError("a damaged part")
        if self._rows is None:
            with open_regular_file(self.steps) as file:
                columns = parse_runs_of_part(pq.read_metadata(file).metadata)
            self._rows = _select_finished_rows(_parse_runs_of_batch(columns))
        yield self._rows

    def is_undamaged(self) -> bool:
        """Return whether a batch's file has the checksum in its name."""
        named = _PART.fullmatch(self.steps.name)
        return named is not None and int(named["crc32"], 16) == _compute_crc32_of_file(self.steps)


def _parse_runs_of_batch(columns: Mapping[str, Sequence[Any]]) -> pa.Table:
    """Return a batch file's runs as an Arrow table, without rows of wrong types."""
    try:
        runs = build_runs_table(columns)
    except (ValueError, TypeError, OverflowError):
        each = range(len(columns["run_id"]))
        alone = [{name: [column[at]] for name, column in columns.items()} for at in each]
        single = [_parse_runs_of_batch(one) for one in alone if len(alone) > 1]
        return pa.concat_tables([NO_RUNS, *single])
    described = [_is_json_object(text) for text in runs["cell"].to_pylist()]
    return runs if all(described) else runs.filter(pa.array(described))


def _is_json_object(text: str | None) -> bool:
    """Return whether a text is a JSON object."""
    try:
        return isinstance(json.loads(text or ""), dict)
    except (ValueError, RecursionError):
        return False


def _select_finished_rows(runs: pa.Table) -> pa.Table:
    """Return the rows of finished runs of the current schema version."""
    became = pc.is_in(runs["outcome"], pa.array(_FINISHED))
    wanted = pc.and_(became, pc.equal(runs["schema"], SCHEMA_VERSION))
    # A damaged row without a name belongs to no cell, which then runs again.
    wanted = pc.and_(wanted, runs["run_id"].is_valid())
    # Filtering so many columns takes longer than all else, and mostly keeps all rows.
    return runs if pc.all(wanted, min_count=0, skip_nulls=False).as_py() else runs.filter(wanted)


def _compute_crc32_of_file(path: Path) -> int:
    """Return the CRC-32 of a file; of a missing one, that of no bytes."""
    check = 0
    with suppress(OSError, InputError), open_regular_file(path) as file:
        while block := file.read(2**20):
            check = zlib.crc32(block, check)
    return check


class StepFile:
    """A Parquet file of steps that is being written, whole runs at a time."""

    def __init__(self, path: Path) -> None:
        self.path, self.rows = create_empty_file(path), 0
        self._writer = open_step_writer(path)
        self._waiting, self._count = list[pa.Table](), 0

    def add(self, table: pa.Table) -> None:
        """Add the steps of whole runs, to be merged into large row groups."""
        self._waiting.append(table)
        self._count += table.num_rows
        self.rows += table.num_rows
        if self._count >= GROUP_ROWS:
            self._write_row_group()

    def _write_row_group(self) -> None:
        """Write the added steps as one row group of the Parquet file."""
        waiting, self._waiting, self._count = self._waiting, [], 0
        if waiting:
            write_row_group(self._writer, pa.concat_tables(waiting))

    def close(self) -> None:
        """Write the steps that are left and the Parquet footer; nothing the second time."""
        self._write_row_group()
        self._writer.close()


class CellStore:
    """The finished runs of a result folder: its result tables, and files of newer batches.

    `folder` holds the part files, `last_part` is the number of the latest; `finished` has the
    outcome of each finished cell, by run_id.
    """

    def __init__(self, out: Path) -> None:
        self.out, self.folder, self.public = out, out / "cells", PublicTables(out)
        out.mkdir(parents=True, exist_ok=True)
        make_folder_if_missing(self.folder)
        self._stale: set[str] = set()
        self._delete_unfinished_files()
        numbers = _number_part_files(self.folder)
        self.parts = [Part(path) for path in numbers]
        self.last_part = max(self.public.read_last_part_number(), *numbers.values(), 0)
        self._before: set[Source] = {self.public, *self.parts}
        self._latest = b""
        self.finished = _read_outcomes(self.public, self.parts)

    def _delete_unfinished_files(self) -> None:
        """Remove the unfinished files of an earlier run from the result folder."""
        for path in (self.public.runs, self.public.steps):
            path.with_name(f"{path.name}.part").unlink(missing_ok=True)
        for path in self.folder.iterdir():
            if _UNFINISHED_FILE.fullmatch(path.name):
                path.unlink(missing_ok=True)

    @property
    def remarks(self) -> list[str]:
        """A remark on unknown files in the folder `cells`, such as those of sync programs."""
        others = sorted(p.name for p in self.folder.iterdir() if not _OWN_FILE.fullmatch(p.name))
        if not others:
            return []
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        return [f"{self.folder}: ignored {others[0]!r}{more}, which no campaign wrote"]

    def mark_unfinished(self, run_ids: Iterable[str]) -> None:
        """Treat stored runs as unfinished, so that they are done again."""
        self._stale |= set(run_ids)
        for run_id in self._stale:
            self.finished.pop(run_id, None)

    def write_part_file(self, part: BatchPart) -> None:
        """Write the file of a batch's finished runs, once; OSError where there is no room."""
        if part.data == self._latest:
            return
        name = f"part-{self.last_part + 1:05d}-{zlib.crc32(part.data):08x}.parquet"
        write_bytes_atomically(self.folder / name, part.data)
        self.parts.append(Part(self.folder / name))
        self.last_part, self._latest = self.last_part + 1, part.data
        self.finished |= part.outcomes

    def write_rows_and_steps(self, rows: pa.Table, steps: pa.Table) -> None:
        """Write finished runs and their steps, read from other files, as new batch files."""
        for first in range(0, len(rows), PART_CELLS):
            columns = rows.slice(first, PART_CELLS).to_pydict()
            some = filter_steps_by_run_id(steps, set(columns["run_id"])) if len(steps) else steps
            self.write_part_file(encode_part(columns, some))

    def copy_runs_of_other_folder(self, other: "CellStore") -> None:
        """Copy the readable finished runs of another result folder into this one."""
        rows, sources = other.collect_rows_and_sources()
        read: set[str] = set()
        for group in other.yield_step_groups(sources):
            try:
                table = group.read_table()
            except DAMAGE:
                continue
            self.write_rows_and_steps(filter_runs_by_run_id(rows, group.names), table)
            read |= set(group.names)
        self.write_rows_and_steps(select_runs_without_steps(rows, read), FILE_SCHEMA.empty_table())

    def collect_rows_and_sources(self) -> tuple[pa.Table, dict[str, Source]]:
        """Return the rows of all finished runs, and by run id the file with its latest copy."""
        tables, sources = [NO_RUNS], dict[str, Source]()
        for source in (self.public, *self.parts):
            table = source.read_rows()
            if self._stale and source in self._before:
                stale = pc.is_in(table["run_id"], pa.array(sorted(self._stale)))
                table = table.filter(pc.invert(stale))
            tables.append(table)
            sources |= dict.fromkeys(table["run_id"].to_pylist(), source)
        rows = pa.concat_tables(tables)
        last = {name: at for at, name in enumerate(rows["run_id"].to_pylist())}
        if len(last) < len(rows):
            rows = rows.take(pa.array(sorted(last.values())))
        return rows, sources

    def read_finished_runs(self) -> pd.DataFrame:
        """Return the rows of all finished runs as a data frame, by run_id."""
        return runs_to_frame(self.collect_rows_and_sources()[0])

    def yield_step_groups(self, sources: Mapping[str, Source]) -> Iterator[StepGroup]:
        """Yield the Parquet row groups with the steps of finished runs, from the given files."""
        names: dict[Source, set[str]] = {}
        for name, source in sources.items():
            names.setdefault(source, set()).add(name)
        for source, own in names.items():
            yield from source.yield_step_groups(own)

    def delete_parts(self, parts: Iterable[Part]) -> None:
        """Delete batch files whose runs are now stored in the result tables."""
        for part in list(parts):
            part.steps.unlink(missing_ok=True)
            self.parts.remove(part)


def read_finished_outcomes(out: Path) -> dict[str, str]:
    """Return the outcome of each finished run of a result folder by run_id; change no file."""
    folder = out / "cells"
    parts = [Part(path) for path in _number_part_files(folder)] if folder.is_dir() else []
    return _read_outcomes(PublicTables(out), parts)


def count_batches_newer_than_tables(out: Path) -> int:
    """Return how many batches in `cells` a run has left that was interrupted after the tables."""
    folder = out / "cells"
    if not folder.is_dir() or folder.is_symlink():
        return 0
    last = PublicTables(out).read_last_part_number()
    return sum(number > last for number in _number_part_files(folder).values())


def _number_part_files(folder: Path) -> dict[Path, int]:
    """Return the files of finished batches in a folder with their numbers, in this order."""
    numbers = {
        path: int(named["number"])
        for path in folder.iterdir()
        if (named := _PART.fullmatch(path.name))
    }
    return {path: numbers[path] for path in sorted(numbers, key=lambda one: (numbers[one], one))}


def _read_outcomes(public: PublicTables, parts: Iterable[Part]) -> dict[str, str]:
    """Return the outcome of each finished run by run_id, of several copies the latest."""
    finished: dict[str, str] = {}
    for source in (public, *parts):
        finished |= source.read_outcomes_by_run_id()
    return finished


def select_runs_without_steps(runs: pa.Table, read: Collection[str]) -> pa.Table:
    """Return the rows of runs that recorded no steps, except those in `read`."""
    none = runs.filter(pc.equal(runs["steps_done"], 0))
    return filter_runs_by_run_id(none, set(none["run_id"].to_pylist()) - set(read))


def filter_runs_by_run_id(runs: pa.Table, names: Collection[str]) -> pa.Table:
    """Return the rows of a table of runs whose run_id is in `names`."""
    return runs.filter(pc.is_in(runs["run_id"], pa.array(sorted(names), pa.string())))
