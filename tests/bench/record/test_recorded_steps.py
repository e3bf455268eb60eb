"""Steps asked for by run and column: the same from a file as from a table in memory, and no more of
the file is read than is asked for."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dpbench.bench.record import cell_store
from dpbench.bench.record.cell_store import StepFile
from dpbench.bench.record.recorded_steps import StepsOnDisk
from dpbench.bench.record.schema import MISSING_INT, STEP_COLUMNS
from dpbench.bench.record.step_table import join_steps_of_runs, make_step_record_batch
from dpbench.errors import ResultsError
from tests.bench.record.test_cell_store import steps_of
from tests.result_folder import StepsInMemory

NAMES = ("a", "b", "c", "d", "e")
ASKED = ("run_id", "k", "t_s", "total_ns", "status", "dtau_x_N", "cmd_y_N", "true")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Five runs of seven steps as a campaign writes them, two of them a row group."""
    monkeypatch.setattr(cell_store, "GROUP_ROWS", 14)
    file = StepFile(tmp_path / "steps.parquet")
    for seed, name in enumerate(NAMES):
        file.add(join_steps_of_runs({name: make_step_record_batch(steps_of(seed))}))
    file.close()
    return tmp_path


def _same(one: pd.DataFrame, other: pd.DataFrame) -> None:
    plain = [
        t.astype({"run_id": "str", "status": "str"}).reset_index(drop=True) for t in (one, other)
    ]
    pd.testing.assert_frame_equal(*plain, check_exact=True)


def test_a_file_answers_as_a_table_in_memory_does(folder: Path) -> None:
    file = StepsOnDisk(folder)
    memory = StepsInMemory(file.read_all_steps())
    assert file.rows == memory.rows == 7 * len(NAMES)

    def together(table: StepsOnDisk, wanted: set[str] | None) -> pd.DataFrame:
        return pd.concat(list(table.scan(ASKED, wanted)), ignore_index=True)

    for wanted in (None, {"b"}, {"d", "a", "nobody"}):
        _same(together(file, wanted), together(memory, wanted))
    for name in NAMES:
        _same(file.read_run(name, ASKED), memory.read_run(name, ASKED))
    assert list(file.read_run("nobody", ASKED).columns) == list(ASKED)
    assert len(file.read_run("nobody")) == len(memory.read_run("nobody")) == 0
    assert not list(file.scan(ASKED, {"nobody"})) + list(memory.scan(ASKED, {"nobody"}))


def test_tables_hold_whole_runs(folder: Path) -> None:
    tables = list(StepsOnDisk(folder).scan(("run_id", "k")))
    assert len(tables) > 1
    runs = [(name, list(of_run)) for t in tables for name, of_run in t.groupby("run_id")["k"]]
    assert runs == [(name, [*range(7)]) for name in NAMES]


def test_only_what_is_asked_for_is_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[tuple[int, set[str]]] = []
    inner = pq.ParquetFile.read_row_group

    def seen(file: Any, group: int, columns: list[str]) -> pa.Table:
        if columns != ["run_id"]:
            read.append((group, set(columns)))
        return inner(file, group, columns=columns)

    monkeypatch.setattr(pq.ParquetFile, "read_row_group", seen)
    steps = StepsOnDisk(folder)
    list(steps.scan(("k", "total_ns"), {"e", "a"}))
    assert read == [(0, {"run_id", "k", "total_ns"}), (2, {"run_id", "k", "total_ns"})]
    for name in ("c", "d", "c"):
        steps.read_run(name, ("k",))
    assert len(read) == 3, "neighbours are in the row group that was read last"


def test_a_column_that_is_in_no_file_is_missing(folder: Path) -> None:
    path = folder / "steps.parquet"
    table = pq.read_table(path)
    pq.write_table(table.drop_columns(["gap", "latency_ns", "status", "late"]), path)
    found = StepsOnDisk(folder).read_all_steps()
    assert list(found.columns) == list(STEP_COLUMNS)
    assert found["gap"].isna().all() and found["latency_ns"].isna().all()
    assert (found["status"] == "").all() and not found["late"].any()
    pq.write_table(table.drop_columns(["k"]), path)
    with pytest.raises(ResultsError, match=r"steps\.parquet: k: no such column;"):
        StepsOnDisk(folder)


def test_every_documented_column_is_in_the_file(folder: Path) -> None:
    steps = pd.read_parquet(folder / "steps.parquet")
    assert list(steps.columns) == list(STEP_COLUMNS)
    for seed, name in enumerate(NAMES):
        own, expected = steps[steps["run_id"] == name], steps_of(seed)
        for column, (dtype, _) in list(STEP_COLUMNS.items())[1:]:
            values = expected[column]
            if dtype == "Int64":
                values = np.where(values == MISSING_INT, np.nan, values)
            np.testing.assert_array_equal(own[column].to_numpy(), values, err_msg=column)


def test_what_pandas_noted_is_not_followed(folder: Path) -> None:
    path, wanted = folder / "steps.parquet", StepsOnDisk(folder).read_all_steps()
    noted = pq.read_table(path).replace_schema_metadata({"pandas": '{"index_columns": ["'})
    pq.write_table(noted, path)
    pd.testing.assert_frame_equal(StepsOnDisk(folder).read_all_steps(), wanted)


def test_damage_is_said_where_it_is_read(folder: Path) -> None:
    path = folder / "steps.parquet"
    place = pq.read_metadata(path).row_group(1).column(7)
    data = bytearray(path.read_bytes())
    first = place.dictionary_page_offset or place.data_page_offset
    data[first : first + place.total_compressed_size] = bytes(place.total_compressed_size)
    path.write_bytes(data)
    steps = StepsOnDisk(folder)
    with pytest.raises(ResultsError, match=r"steps\.parquet: found a damaged file"):
        list(steps.scan(tuple(STEP_COLUMNS)))
