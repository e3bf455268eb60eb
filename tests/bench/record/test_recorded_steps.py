"""Steps asked for by run and column: the same from a file as from a table in memory, and no more of
the file is read than is asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dpbench.bench.record import cell_store
from dpbench.bench.record.cell_store import StepFile
from dpbench.bench.record.recorded_steps import StepsInMemory, StepsOnDisk, StepTable
from dpbench.bench.record.schema import DERIVED, SAME_AS, STEP_COLUMNS, as_runs
from dpbench.bench.record.step_table import INSIDE, step_batch, with_names, write_runs
from dpbench.errors import ResultsError
from tests.bench.record.test_cell_store import row_of, steps_of

NAMES = ("a", "b", "c", "d", "e")
ASKED = ("run_id", "k", "t_s", "total_ns", "status", "dtau_x_N", "cmd_y_N", "true")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Five runs of seven steps as a campaign writes them, two of them a row group."""
    monkeypatch.setattr(cell_store, "GROUP_ROWS", 14)
    file = StepFile(tmp_path / "steps.parquet")
    for seed, name in enumerate(NAMES):
        file.add(with_names({name: step_batch(steps_of(seed))}))
    file.close()
    write_runs(tmp_path / "runs.parquet", as_runs(pd.DataFrame(map(row_of, NAMES))), {})
    return tmp_path


@pytest.fixture
def early(folder: Path) -> Path:
    """The same as an early release wrote it: all columns, runs cut in pieces by row groups."""
    frame = StepsOnDisk(folder).frame()
    frame.to_parquet(folder / "steps.parquet", index=False, row_group_size=5)
    return folder


def _same(one: pd.DataFrame, other: pd.DataFrame) -> None:
    plain = [
        t.astype({"run_id": "str", "status": "str"}).reset_index(drop=True) for t in (one, other)
    ]
    pd.testing.assert_frame_equal(*plain, check_exact=True)


@pytest.mark.parametrize("written", ["folder", "early"])
def test_a_file_answers_as_a_table_in_memory_does(
    written: str, request: pytest.FixtureRequest
) -> None:
    """All runs, some, one, and one that left nothing."""
    file = StepsOnDisk(request.getfixturevalue(written))
    memory = StepsInMemory(file.frame())
    assert file.rows == memory.rows == 7 * len(NAMES)

    def together(table: StepTable, wanted: set[str] | None) -> pd.DataFrame:
        return pd.concat(list(table.scan(ASKED, wanted)), ignore_index=True)

    for wanted in (None, {"b"}, {"d", "a", "nobody"}):
        _same(together(file, wanted), together(memory, wanted))
    for name in NAMES:
        _same(file.of(name, ASKED), memory.of(name, ASKED))
    assert list(file.of("nobody", ASKED).columns) == list(ASKED)
    assert len(file.of("nobody")) == len(memory.of("nobody")) == 0
    assert not list(file.scan(ASKED, {"nobody"})) + list(memory.scan(ASKED, {"nobody"}))


@pytest.mark.parametrize("written", ["folder", "early"])
def test_tables_hold_whole_runs(written: str, request: pytest.FixtureRequest) -> None:
    """In the order of the file, each run once and not cut in two."""
    tables = list(StepsOnDisk(request.getfixturevalue(written)).scan(("run_id", "k")))
    assert len(tables) > 1
    runs = [(name, list(of_run)) for t in tables for name, of_run in t.groupby("run_id")["k"]]
    assert runs == [(name, [*range(7)]) for name in NAMES]


def test_only_what_is_asked_for_is_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The row groups that hold a run, and the columns that the asked ones are made from."""
    read: list[tuple[list[int], list[str]]] = []
    inner = pq.ParquetFile.read_row_groups

    def seen(file: Any, groups: list[int], columns: list[str]) -> pa.Table:
        read.append((groups, columns))
        return inner(file, groups, columns=columns)

    monkeypatch.setattr(pq.ParquetFile, "read_row_groups", seen)
    steps = StepsOnDisk(folder)
    list(steps.scan(("k", "total_ns"), {"e", "a"}))
    of_total = ["run_id", "k", *INSIDE, "allocation_ns"]
    assert [groups for groups, _ in read] == [[0], [2]]
    assert all(set(columns) == set(of_total) for _, columns in read)
    for name in ("c", "d", "c"):
        steps.of(name, ("k",))
    assert len(read) == 3, "neighbours are in the row group that was read last"


def test_the_layout_is_what_is_documented(folder: Path) -> None:
    """With pyarrow and pandas alone: every column that is in no file, or is null there, follows
    from the others by the formulas of the reference."""
    stored, runs = pq.read_table(folder / "steps.parquet"), pd.read_parquet(folder / "runs.parquet")
    assert set(stored.column_names) == set(STEP_COLUMNS) - set(DERIVED)
    steps = stored.to_pandas(types_mapper={pa.int64(): pd.Int64Dtype()}.get)
    clock = steps[["run_id"]].merge(runs, on="run_id")
    sample = clock["first_sample"].to_numpy() + clock["every_sample"].to_numpy() * steps["k"]
    found = {"t_s": sample * clock["sample_s"].to_numpy()}
    found["total_ns"] = steps[[*INSIDE, "allocation_ns"]].sum(axis=1)
    found["total_ns"] = found["total_ns"].where(steps[list(INSIDE)].notna().any(axis=1))
    for name in [name for name in DERIVED if name.startswith("dtau_")]:
        applied = steps[name.removeprefix("d")]
        found[name] = applied - applied.shift().where(steps["k"] != 0, 0.0)
    for name, other in SAME_AS.items():
        found[name] = steps[name].fillna(steps[other])
    expected = StepsOnDisk(folder).frame()
    assert set(found) == set(DERIVED) | set(SAME_AS)
    for name, values in found.items():
        numbers = [c.to_numpy(np.float64, na_value=np.nan) for c in (values, expected[name])]
        np.testing.assert_array_equal(*numbers, err_msg=name)


def test_a_part_has_the_layout_of_the_public_tables(tmp_path: Path) -> None:
    """What a running campaign keeps can be read by anybody, too."""
    store = cell_store.CellStore(tmp_path)
    record = cell_store.packed(row_of("a"), step_batch(steps_of(0)))
    store.append("a", "finished", record)
    store.close()
    (part,) = store.parts()[1:]
    steps, runs = pq.read_table(part.steps), pd.read_parquet(part.runs)
    assert set(steps.column_names) == set(STEP_COLUMNS) - set(DERIVED)
    assert steps["run_id"].to_pylist() == ["a"] * 7 and runs["run_id"].tolist() == ["a"]


def test_damage_is_said_where_it_is_read(folder: Path) -> None:
    """A page that was changed on the disk, with the name of the file."""
    path = folder / "steps.parquet"
    place = pq.read_metadata(path).row_group(1).column(7)
    data = bytearray(path.read_bytes())
    first = place.dictionary_page_offset or place.data_page_offset
    data[first : first + place.total_compressed_size] = bytes(place.total_compressed_size)
    path.write_bytes(data)
    steps = StepsOnDisk(folder)
    with pytest.raises(ResultsError, match=r"steps\.parquet: found a damaged file"):
        list(steps.scan(tuple(STEP_COLUMNS)))
