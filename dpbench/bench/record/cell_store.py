"""Finished cells on disk, from the first record to the public tables.

A finished cell goes into a journal, a file that only grows. Each of its records is an Arrow IPC
stream of one batch, the steps of a run, whose schema carries the row of the run as JSON; before it
stand its length and its check sum. What was cut off in the midst of a record, or damaged since, is
no record; all others are.

Some hundred cells become a part, two files in `cells/`, the steps first and the runs last; in it
runs of one problem lie behind each other. At the end of a campaign all parts become
`steps.parquet` and `runs.parquet`. A cell is finished when its row stands in a table of runs, or in
the journal, and its steps can be read. Where a cell is in several places, after a campaign was
killed as it tidied up, the latest holds.
"""

from __future__ import annotations

import json
import os
import re
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from dpbench.bench.record.cell import OUTCOMES, problem_key_of
from dpbench.bench.record.schema import SCHEMA_VERSION
from dpbench.bench.record.step_table import (
    FILE_SCHEMA,
    RUNS_SCHEMA,
    STEPS_SCHEMA,
    concat_runs,
    filter_runs,
    frame_of_runs,
    runs_table,
    step_writer,
    stored_runs,
    write_runs,
    write_steps,
)
from dpbench.errors import InputError
from dpbench.files.documents import parse_json
from dpbench.files.opening import opened
from dpbench.files.tables import in_full, opened_table
from dpbench.files.writing import make_folder, new_file, put

_HEAD = struct.Struct("<4sQI")
"""Mark, length and CRC-32 of the record behind it."""
_MARK = b"DPB1"
_ROW = b"run"

Row = dict[str, Any]
"""A row of `runs.parquet`, by column."""


def packed(row: Row, steps: pa.RecordBatch) -> bytes:
    """A finished run as the bytes of a record."""
    text = json.dumps(row, default=_plain, ensure_ascii=False)
    batch = steps.replace_schema_metadata({_ROW: text.encode()})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema) as stream:
        stream.write_batch(batch)
    record: bytes = sink.getvalue().to_pybytes()
    return record


def unpacked(record: bytes) -> tuple[Row, pa.RecordBatch]:
    """What `packed` made bytes of."""
    with pa.ipc.open_stream(record) as stream:
        batch = stream.read_next_batch()
    row: Row = json.loads(batch.schema.metadata[_ROW])
    return row, batch.replace_schema_metadata(None)


def _is_sound(row: Row, batch: pa.RecordBatch) -> bool:
    """Whether a record, whose check sum anybody can make, is of a run of this schema; ValueError or
    ArrowInvalid where its parts do not fit."""
    batch.validate(full=True)
    described = isinstance(parse_json(str(row["cell"])), dict)
    return described and row["schema"] == SCHEMA_VERSION and batch.schema.equals(STEPS_SCHEMA)


def _typed(rows: Mapping[str, Row]) -> pa.Table:
    """Return rows as a table, without those that have a value of another type."""
    try:
        return runs_table(list(rows.values()))
    except (ValueError, TypeError, OverflowError):
        alone = [_typed({name: row}) for name, row in rows.items() if len(rows) > 1]
        return pa.concat_tables([RUNS_SCHEMA.empty_table(), *alone])


def _plain(value: object) -> object:
    """What JSON has for a number of NumPy, and for one that is missing."""
    if value is pd.NA:
        return None
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} in a row")


class Journal:
    """Appends records to a new file at `path`; OSError where it cannot be made."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(new_file(path), os.O_WRONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        self.size = 0

    def append(self, record: bytes) -> None:
        """Write one record behind the last; OSError where there is no room, and nothing is left of
        it then."""
        data = memoryview(_HEAD.pack(_MARK, len(record), zlib.crc32(record)) + record)
        try:
            written = 0
            while written < len(data):
                written += os.pwrite(self._file, data[written:], self.size + written)
        except OSError:
            os.ftruncate(self._file, self.size)
            raise
        self.size += len(data)

    def close(self) -> None:
        """No more records."""
        os.close(self._file)


def records_in(path: Path) -> Iterator[bytes]:
    """The whole records of a journal; none where there is no file.

    Behind a damaged head nothing can be found any more.
    """
    try:
        with opened(path) as file:
            data = memoryview(file.read())
    except (OSError, InputError):
        return
    at = 0
    while at + _HEAD.size <= len(data):
        mark, length, check = _HEAD.unpack_from(data, at)
        record = data[at + _HEAD.size : at + _HEAD.size + length]
        if mark != _MARK or len(record) < length:
            return
        if zlib.crc32(record) == check:
            yield bytes(record)
        at += _HEAD.size + length


PART_CELLS = 256
PART_BYTES = 2**26
"""Cells, or bytes, of a journal from which it becomes a part."""
GROUP_ROWS = 2**17
"""Rows of a row group, unless a single run has more."""
CHECKED_ROWS = 512
"""Rows of runs that are looked through at a time."""
_FINISHED = set(OUTCOMES) - {"lost", "invalid"}
_CHECK = "steps_crc32"
"""What the metadata of a table of runs say of the file of its steps."""
_PART = re.compile(r"(?P<kind>runs|steps)-(?P<number>\d{5}|[1-9]\d{5,8})\.parquet")
_STEM = r"(?:(?:runs|steps)-\d{5,9}|(?:exact|design)-\w+)"
_LEFT_OVER = re.compile(rf"{_STEM}(?:\.\w+)*\.part|exact-\w+(?:\.part)+\.npz")
"""What a file is called before it is whole."""
_OWN = re.compile(
    rf"{_PART.pattern}|{_LEFT_OVER.pattern}|exact-\w+\.npz|design-\w+\.json|open\.cells|\.\w+"
)
"""The names of all files that campaigns write beside their cells."""
DAMAGE = (OSError, ValueError, KeyError, pa.ArrowException)
"""What reading a damaged table raises."""


@dataclass(frozen=True)
class Part:
    """A table of runs, and the file of their steps."""

    runs: Path
    steps: Path

    def table(self) -> pa.Table:
        """Return the rows of finished runs, of `RUNS_SCHEMA`; none where the table is damaged."""
        try:
            # Hundreds of columns of some hundred rows: threads would cost more than they save.
            with opened_table(self.runs) as file:
                rows = stored_runs(in_full(file.read(use_threads=False), self.runs))
        except DAMAGE:
            return RUNS_SCHEMA.empty_table()
        became = pc.is_in(rows["outcome"], pa.array(sorted(_FINISHED)))
        return rows.filter(pc.and_(became, pc.equal(rows["schema"], SCHEMA_VERSION)))

    def rows(self) -> pd.DataFrame:
        """The same by run_id."""
        return frame_of_runs(self.table())

    def names(self) -> list[str]:
        """The run_ids of all its rows, in their order."""
        try:
            with opened_table(self.runs) as file:
                return [str(n) for n in file.read(columns=["run_id"])["run_id"].to_pylist()]
        except DAMAGE:
            return []

    def groups(self) -> Iterator[pa.Table]:
        """The row groups of the steps that can be read."""
        with ExitStack() as stack:
            try:
                file = stack.enter_context(opened_table(self.steps))
            except DAMAGE:
                return
            for i in range(file.num_row_groups):
                with suppress(*DAMAGE):
                    yield file.read_row_group(i).select(FILE_SCHEMA.names).cast(FILE_SCHEMA)

    def outcomes(self) -> dict[str, str]:
        """Of each finished run its outcome; a run whose steps cannot be read is none."""
        finished: dict[str, str] = {}
        try:
            with opened_table(self.runs) as file:
                # All columns, which tells whether they can be read; some rows at a time, as the
                # descriptions of cells are long.
                for rows in file.iter_batches(batch_size=CHECKED_ROWS, use_threads=False):
                    key = (rows[name].to_pylist() for name in ("run_id", "outcome", "schema"))
                    finished |= {
                        name: outcome
                        for name, outcome, schema in zip(*key, strict=True)
                        if outcome in _FINISHED and schema == SCHEMA_VERSION
                    }
        except DAMAGE:
            return {}
        if self._is_sound():
            return finished
        groups = [pc.unique(group["run_id"]).to_pylist() for group in self.groups()]
        read = {name for names in groups for name in names}
        return {name: became for name, became in finished.items() if name in read}

    def _is_sound(self) -> bool:
        """Whether the steps are, byte for byte, those that the runs were written beside."""
        try:
            said = (pq.read_metadata(self.runs).metadata or {}).get(_CHECK.encode())
        except DAMAGE:
            return False
        return said == _check_sum(self.steps)

    def write_runs(self, rows: pa.Table, steps: Path) -> None:
        """Write the rows beside `steps`, and put those in their place before."""
        check = _check_sum(steps)
        if steps != self.steps:
            put(steps, self.steps)
        write_runs(self.runs, rows, {_CHECK: check.decode()})

    def remove(self) -> None:
        """Both files, the runs first."""
        self.runs.unlink(missing_ok=True)
        self.steps.unlink(missing_ok=True)


def public_part(out: Path) -> Part:
    """The tables of a result folder that others read."""
    return Part(out / "runs.parquet", out / "steps.parquet")


def _check_sum(path: Path) -> bytes:
    """CRC-32 of a file; of one that is not there, of nothing."""
    check = 0
    with suppress(OSError, InputError), opened(path) as file:
        while block := file.read(2**20):
            check = zlib.crc32(block, check)
    return b"%08x" % check


class StepFile:
    """A file of steps on its way: tables of whole runs, gathered into row groups."""

    def __init__(self, path: Path) -> None:
        self.path, self.rows = new_file(path), 0
        self._writer, self._waiting, self._count = step_writer(path), list[pa.Table](), 0

    def add(self, table: pa.Table) -> None:
        """Add whole runs."""
        self._waiting.append(table)
        self._count += table.num_rows
        self.rows += table.num_rows
        if self._count >= GROUP_ROWS:
            self._flush()

    def _flush(self) -> None:
        if self._waiting:
            group = pa.concat_tables(self._waiting).unify_dictionaries().combine_chunks()
            write_steps(self._writer, group)
        self._waiting, self._count = [], 0

    def close(self) -> None:
        """Write what is left; nothing the second time."""
        self._flush()
        self._writer.close()


def _by_problem(rows: Mapping[str, Row]) -> list[str]:
    """The names of runs, those of one problem behind each other: of loops in one sea most steps
    have numbers in common, which are stored once where they are near."""
    problems = {name: problem_key_of(row["cell"]) for name, row in rows.items()}
    places = {problem: at for at, problem in enumerate(dict.fromkeys(problems.values()))}
    return sorted(rows, key=lambda name: places[problems[name]])


class CellStore:
    """The finished cells of a result folder.

    Attributes
    ----------
    folder : where journal and parts lie, `cells/`.
    finished : of each finished cell its outcome, by run_id.
    """

    def __init__(self, out: Path) -> None:
        self.out, self.folder = out, out / "cells"
        out.mkdir(parents=True, exist_ok=True)
        make_folder(self.folder)
        self._journal_path = self.folder / "open.cells"
        self._journal: Journal | None = None
        self._cells, self._turn_at = 0, PART_CELLS
        self._stale: set[str] = set()
        self._tidy()
        self._turn()
        self._before = set(self.parts())
        self.finished: dict[str, str] = {}
        for part in self.parts():
            self.finished |= part.outcomes()

    @property
    def public(self) -> Part:
        """The tables that others read."""
        return public_part(self.out)

    def parts(self) -> list[Part]:
        """All there are, the public tables first, the latest last."""
        return [self.public, *map(self._part, self._numbers("runs"))]

    def _numbers(self, kind: str) -> list[int]:
        """Those of the files of runs or of steps, in their order."""
        names = (_PART.fullmatch(path.name) for path in self.folder.iterdir())
        return sorted(int(name["number"]) for name in names if name and name["kind"] == kind)

    def _part(self, number: int) -> Part:
        runs, steps = (self.folder / f"{kind}-{number:05d}.parquet" for kind in ("runs", "steps"))
        return Part(runs, steps)

    def new_part(self) -> Part:
        """The next one."""
        return self._part(max(self._numbers("runs"), default=0) + 1)

    @property
    def remarks(self) -> list[str]:
        """A line on the files in it that no campaign writes, such as copies of a program that
        keeps folders in sync; none of them is read."""
        others = sorted(p.name for p in self.folder.iterdir() if not _OWN.fullmatch(p.name))
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        said = (
            f"{self.folder}: ignored {others[0]!r}{more}, which no campaign wrote" if others else ""
        )
        return [said] if said else []

    def forget(self, run_ids: Iterable[str]) -> None:
        """Take these cells as unfinished, whatever is there of them."""
        self._stale |= set(run_ids)
        for run_id in self._stale:
            self.finished.pop(run_id, None)

    def append(self, run_id: str, outcome: str, record: bytes) -> None:
        """Keep a finished cell, as `packed` makes it; OSError where there is no room."""
        if self._journal is None:
            self._journal = Journal(self._journal_path)
        self._journal.append(record)
        self.finished[run_id] = outcome
        self._cells += 1
        if self._cells >= self._turn_at or self._journal.size >= PART_BYTES:
            # Without room for a part the journal goes on, and the next ones try again.
            self._turn_at = self._cells + PART_CELLS
            with suppress(OSError):
                self._turn()

    def close(self) -> None:
        """Make a part of what the journal holds; nothing is appended any more."""
        self._turn()

    def _turn(self) -> None:
        """Make the journal a part."""
        rows: dict[str, Row] = {}
        steps: dict[str, pa.RecordBatch] = {}
        for record in records_in(self._journal_path):
            try:
                row, batch = unpacked(record)
                name = str(row["run_id"])
                if _is_sound(row, batch):
                    rows[name], steps[name] = row, batch
            except DAMAGE:
                continue
        table = _typed({name: rows[name] for name in _by_problem(rows)})
        if len(table):
            part = self.new_part()
            file = StepFile(part.steps.with_suffix(".part"))
            try:
                file.add(concat_runs({name: steps[name] for name in table["run_id"].to_pylist()}))
                file.close()
                part.write_runs(table, file.path)
            finally:
                file.path.unlink(missing_ok=True)
        if self._journal is not None:
            self._journal.close()
        self._journal, self._cells, self._turn_at = None, 0, PART_CELLS
        self._journal_path.unlink(missing_ok=True)

    def _tidy(self) -> None:
        """Remove what a killed campaign left half done."""
        for path in (self.public.runs, self.public.steps):
            path.with_name(f"{path.name}.part").unlink(missing_ok=True)
        for path in self.folder.iterdir():
            if _LEFT_OVER.fullmatch(path.name):
                path.unlink(missing_ok=True)
        for number in set(self._numbers("steps")) - set(self._numbers("runs")):
            self._part(number).steps.unlink(missing_ok=True)

    def adopt(self, other: CellStore) -> None:
        """Take over the finished cells of another store, as a part; what cannot be read is none."""
        part, read = self.new_part(), set[str]()
        file = StepFile(part.steps.with_suffix(".part"))
        try:
            for table in other.steps():
                read |= set(pc.unique(table["run_id"]).to_pylist())
                file.add(table)
            file.close()
            rows = other.table()
            kept = pc.is_in(rows["run_id"], pa.array(sorted(read), pa.string()))
            rows = rows.filter(pc.or_(kept, pc.equal(rows["steps_done"], 0)))
            if len(rows):
                part.write_runs(rows, file.path)
        finally:
            file.close()
            file.path.unlink(missing_ok=True)

    def rows(self) -> pd.DataFrame:
        """The rows of all finished cells, by run_id: of several the latest."""
        return frame_of_runs(self.table())

    def table(self) -> pa.Table:
        """As `rows`, as a table of `RUNS_SCHEMA`."""
        rows = pa.concat_tables([self._valid(part) for part in self.parts()])
        last = {name: at for at, name in enumerate(rows["run_id"].to_pylist())}
        return rows if len(last) == len(rows) else rows.take(pa.array(sorted(last.values())))

    def _valid(self, part: Part) -> pa.Table:
        """The rows of a part but for those that were forgotten since they were written."""
        rows = part.table()
        if part not in self._before or not self._stale:
            return rows
        return rows.filter(pc.invert(pc.is_in(rows["run_id"], pa.array(sorted(self._stale)))))

    def steps(self) -> Iterator[pa.Table]:
        """The steps of all finished cells once, in tables of whole runs: of several the latest."""
        owner: dict[str, Part] = {}
        for part in self.parts():
            owner |= dict.fromkeys(self._valid(part)["run_id"].to_pylist(), part)
        owned: dict[Part, set[str]] = {part: set() for part in self.parts()}
        for name, part in owner.items():
            owned[part].add(name)
        for part, names in owned.items():
            for group in part.groups():
                yield filter_runs(group, names)
