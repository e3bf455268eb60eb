"""Finished cells: what a journal, parts and public tables hold, and what no kill costs."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from dpbench.bench.judge.rows import step_rows
from dpbench.bench.judge.rules import StepColumns
from dpbench.bench.record import cell_store
from dpbench.bench.record.cell_store import (
    CellStore,
    Journal,
    Part,
    StepFile,
    packed,
    records_in,
    unpacked,
)
from dpbench.bench.record.recorded_steps import read_steps, scan_steps
from dpbench.bench.record.schema import ABSENT, SCHEMA_VERSION, STEP_COLUMNS, as_steps
from dpbench.bench.record.step_table import concat_runs, filter_runs, runs_table, step_batch
from dpbench.errors import InputError


def steps_of(seed: int, count: int = 7) -> StepColumns:
    """Made-up steps of a closed loop, some numbers missing."""
    rng = np.random.default_rng(seed)
    steps: StepColumns = {}
    for name, (dtype, _) in STEP_COLUMNS.items():
        if dtype == "Int64":
            steps[name] = rng.integers(ABSENT, 10**6, count)
        elif dtype == "float64":
            steps[name] = rng.normal(size=count)
        elif dtype == "bool":
            steps[name] = rng.random(count) < 0.5
    steps |= {"k": np.arange(count, dtype=np.int32), "repeat": np.zeros(count, dtype=np.int32)}
    steps |= {"n_active": np.ones(count, dtype=np.int32), "status": np.full(count, "SOLVED")}
    steps["certificate"] = np.full(count, "linear")
    steps["gap"][0] = np.nan
    return steps


def row_of(name: str, **changes: Any) -> dict[str, Any]:
    """A row with what the store looks at."""
    row = {"run_id": name, "outcome": "finished", "schema": SCHEMA_VERSION, "steps_done": 7}
    row |= {"cell": json.dumps({"scenario": name})}
    clock = {"first_sample": 5.0, "every_sample": np.float64(2.0)}
    return row | clock | {"N_p": pd.NA, "settle_s": np.inf, "effort_s": 0.1 + 0.2} | changes


def record(name: str, seed: int = 0, **changes: Any) -> bytes:
    return packed(row_of(name, **changes), step_batch(steps_of(seed)))


def filled(out: Path, *names: str) -> CellStore:
    """A store with those cells, each of other steps."""
    store = CellStore(out)
    for seed, name in enumerate(names):
        store.append(name, "finished", record(name, seed))
    return store


def names_in(store: CellStore) -> list[str]:
    """The runs whose steps the store gives, in order, each as often as it gives them."""
    tables = [table["run_id"].to_pylist() for table in store.steps()]
    return [name for names in tables for name in names[::7]]


def test_a_record_comes_back_bit_for_bit() -> None:
    """Row and steps."""
    batch = step_batch(steps_of(1))
    row, again = unpacked(packed(row_of("a"), batch))
    assert again.equals(batch) and again.schema.equals(batch.schema)
    assert row["settle_s"] == np.inf and row["effort_s"] == 0.1 + 0.2 and row["N_p"] is None


def test_steps_come_back_bit_for_bit(tmp_path: Path) -> None:
    """All columns, from the file."""
    steps = steps_of(2)
    file = StepFile(tmp_path / "steps.parquet")
    file.add(concat_runs({"a": step_batch(steps)}))
    file.close()
    found = as_steps(read_steps(tmp_path, list(STEP_COLUMNS)).to_pandas())
    pd.testing.assert_frame_equal(found, step_rows("a", steps), check_exact=True)


def test_only_the_runs_and_columns_that_are_asked_for(tmp_path: Path, monkeypatch: Any) -> None:
    """In tables of whole runs, each of them once."""
    monkeypatch.setattr(cell_store, "GROUP_ROWS", 10)
    file, names = StepFile(tmp_path / "steps.parquet"), ["a", "b", "c", "d", "e"]
    for seed, name in enumerate(names):
        file.add(concat_runs({name: step_batch(steps_of(seed))}))
    file.close()
    tables = list(scan_steps(tmp_path, ["run_id", "dtau_x_N", "t_s"]))
    assert [table.num_rows for table in tables] == [14, 14, 7]
    for seed, name in enumerate(names):
        some = read_steps(tmp_path, ["dtau_x_N", "t_s"], {name})
        assert some.column_names == ["dtau_x_N", "t_s"]
        assert some["dtau_x_N"].to_pylist() == steps_of(seed)["dtau_x_N"].tolist()
        assert some["t_s"].to_pylist() == steps_of(seed)["t_s"].tolist()
    assert len(read_steps(tmp_path, ["k"], {"nobody"})) == 0


def test_of_no_runs_nothing_is_held() -> None:
    """What waits to be written beside a table must not keep the table in memory."""
    table = concat_runs({"a": step_batch(steps_of(0)), "b": step_batch(steps_of(1))})
    assert filter_runs(table, {"b"})["run_id"].unique().to_pylist() == ["b"]
    nothing = filter_runs(table, {"c"})
    assert nothing.schema.equals(table.schema) and len(nothing) == 0
    assert nothing.get_total_buffer_size() < 100 < table.get_total_buffer_size()


def test_what_another_schema_left_in_the_journal_is_not_finished(tmp_path: Path) -> None:
    """Its columns are others: it is run again, and what stands beside it is kept."""
    store = CellStore(tmp_path)
    old = step_batch(steps_of(1)).select(["k", "repeat"])
    store.append("old", "finished", packed(row_of("old", schema=SCHEMA_VERSION - 1), old))
    store.append("new", "finished", record("new"))
    again = CellStore(tmp_path)
    assert again.finished == {"new": "finished"} and names_in(again) == ["new"]


@pytest.mark.parametrize("lost", [1, 20, 5000])
def test_a_journal_that_was_cut_off_has_all_whole_records(lost: int, tmp_path: Path) -> None:
    """Killed in the midst of a record, it costs that record."""
    journal = Journal(tmp_path / "journal")
    for name in "abc":
        journal.append(record(name))
    os.truncate(tmp_path / "journal", journal.size - lost)
    journal.close()
    assert [unpacked(found)[0]["run_id"] for found in records_in(tmp_path / "journal")] == [
        "a",
        "b",
    ]


def test_a_damaged_record_costs_itself_alone(tmp_path: Path) -> None:
    """A byte of the second of three is another one."""
    path = tmp_path / "journal"
    journal = Journal(path)
    sizes = []
    for name in "abc":
        journal.append(record(name))
        sizes.append(journal.size)
    journal.close()
    data = bytearray(path.read_bytes())
    data[(sizes[0] + sizes[1]) // 2] ^= 1
    path.write_bytes(data)
    assert [unpacked(found)[0]["run_id"] for found in records_in(path)] == ["a", "c"]


def test_a_record_without_room_leaves_the_others(tmp_path: Path, monkeypatch: Any) -> None:
    """What was written of it goes again."""
    journal, pwrite = Journal(tmp_path / "journal"), os.pwrite

    def full(file: int, data: memoryview, at: int) -> int:
        if at + len(data) > room:
            pwrite(file, data[: len(data) // 2], at)
            raise OSError("no room")
        return pwrite(file, data, at)

    journal.append(record("a"))
    room = journal.size
    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        with pytest.raises(OSError, match="no room"):
            journal.append(record("b"))
    journal.append(record("c"))
    journal.close()
    names = [unpacked(found)[0]["run_id"] for found in records_in(tmp_path / "journal")]
    assert names == ["a", "c"]


def test_many_cells_become_parts(tmp_path: Path, monkeypatch: Any) -> None:
    """Two files a part; what is left in the journal is found by the next campaign."""
    monkeypatch.setattr(cell_store, "PART_CELLS", 3)
    names = [f"run{i}" for i in range(8)]
    filled(tmp_path, *names)
    parts = sorted(path.name for path in (tmp_path / "cells").glob("*"))
    of_two = ["runs-00001.parquet", "runs-00002.parquet", "steps-00001.parquet"]
    assert parts == ["open.cells", *of_two, "steps-00002.parquet"]
    store = CellStore(tmp_path)
    assert list(store.finished) == names == names_in(store) == list(store.rows().index)


def test_runs_of_one_problem_lie_behind_each_other(tmp_path: Path) -> None:
    """In a part, whichever came first; each with its own steps."""
    store = CellStore(tmp_path)
    for seed, name in enumerate(["a1", "b1", "a2", "b2"]):
        cell = json.dumps({"scenario": name[0], "solver": name[1]})
        store.append(name, "finished", record(name, seed, cell=cell))
    store.close()
    assert names_in(store) == list(store.rows().index) == ["a1", "a2", "b1", "b2"]
    (steps,) = store.steps()
    gap = np.concatenate([steps_of(seed)["gap"] for seed in (0, 2, 1, 3)])
    np.testing.assert_array_equal(steps["gap"].to_numpy(), gap)


@pytest.fixture
def twice(tmp_path: Path) -> Iterator[CellStore]:
    """A cell in two parts, as after a kill while parts were being put together."""
    filled(tmp_path, "a", "b").close()
    store = CellStore(tmp_path)
    store.append("b", "finished", record("b", 9, steps_done=9))
    store.close()
    yield CellStore(tmp_path)


def test_a_cell_in_two_places_is_there_once(twice: CellStore) -> None:
    """With the row and the steps of the latest."""
    assert names_in(twice) == ["a", "b"]
    assert twice.rows().loc["b", "steps_done"] == 9
    (last,) = [t for t in twice.steps() if t["run_id"][0].as_py() == "b"]
    assert last["gap"].to_pylist()[1:] == steps_of(9)["gap"].tolist()[1:]


def test_what_is_forgotten_is_there_only_if_it_comes_again(tmp_path: Path) -> None:
    """As with --fresh: the others stay."""
    filled(tmp_path, "a", "b", "c").close()
    store = CellStore(tmp_path)
    store.forget(["a", "b"])
    store.append("b", "finished", record("b", 9))
    store.close()
    assert set(store.finished) == set(store.rows().index) == {"b", "c"}
    assert sorted(names_in(store)) == ["b", "c"]


def test_steps_without_their_runs_are_nothing(tmp_path: Path) -> None:
    """Killed between the two files of a part: its cells are not finished, and leave no rubbish."""
    filled(tmp_path, "a").close()
    (tmp_path / "cells" / "runs-00001.parquet").unlink()
    assert CellStore(tmp_path).finished == {}
    assert not list((tmp_path / "cells").glob("*.parquet"))


def test_of_a_damaged_file_the_groups_that_can_be_read_count(
    tmp_path: Path, monkeypatch: Any
) -> None:
    """Each run in a row group of its own: the damaged one is not finished, the others are."""
    monkeypatch.setattr(cell_store, "GROUP_ROWS", 1)
    part = Part(tmp_path / "runs.parquet", tmp_path / "steps.parquet")
    file = StepFile(tmp_path / "steps.part")
    for seed, name in enumerate("abc"):
        file.add(concat_runs({name: step_batch(steps_of(seed))}))
    file.close()
    part.write_runs(runs_table([row_of(n) for n in "abc"]), file.path)
    assert list(part.outcomes()) == ["a", "b", "c"]
    group = pq.ParquetFile(part.steps).metadata.row_group(1).column(10)
    data = bytearray(part.steps.read_bytes())
    data[group.data_page_offset + group.total_compressed_size - 3] ^= 1
    part.steps.write_bytes(data)
    assert list(part.outcomes()) == ["a", "c"]


def test_public_steps_that_are_newer_than_their_runs_cost_nothing(tmp_path: Path) -> None:
    """Killed between the two public tables: what the parts hold counts, once."""
    file = StepFile(tmp_path / "steps.part")
    file.add(concat_runs({"a": step_batch(steps_of(0))}))
    file.close()
    public = CellStore(tmp_path).public
    public.write_runs(runs_table([row_of("a")]), file.path)
    store = CellStore(tmp_path)
    store.append("b", "finished", record("b", 1))
    store.close()
    both = StepFile(tmp_path / "steps.parquet")
    both.add(concat_runs({name: step_batch(steps_of(i)) for i, name in enumerate("ab")}))
    both.close()
    store = CellStore(tmp_path)
    assert list(store.finished) == ["a", "b"] and names_in(store) == ["a", "b"]


COPIES = (
    *("runs-00001 (copy).parquet", "steps-00001 (copy).parquet", "steps-00007 (copy).parquet"),
    *("runs-00001 (conflicted copy 2026-11-22).parquet", "open (copy).cells", "runs-x.parquet"),
    "runs-00001.sync-conflict-20261122-101500-ABCDEFG.parquet",
)


def test_copies_that_sync_tools_leave_are_ignored_and_named(tmp_path: Path) -> None:
    """They are neither read nor removed, and the next part has the next number."""
    filled(tmp_path, "a", "b").close()
    source = tmp_path / "cells" / "runs-00001.parquet"
    for name in COPIES:
        (tmp_path / "cells" / name).write_bytes(source.read_bytes())
    store = CellStore(tmp_path)
    assert list(store.finished) == ["a", "b"] and names_in(store) == ["a", "b"]
    store.append("c", "finished", record("c"))
    store.close()
    assert [part.runs.stem for part in store.parts()[1:]] == ["runs-00001", "runs-00002"]
    (remark,) = store.remarks
    assert "ignored 'open (copy).cells' and 6 more" in remark and str(tmp_path) in remark
    assert all((tmp_path / "cells" / name).exists() for name in COPIES)


def test_own_files_are_not_remarked_on(tmp_path: Path) -> None:
    """Those of a campaign at work, whole and half done, and of designs and sources."""
    store = filled(tmp_path, "a")
    own = ["exact-0123456789ab.npz", "exact-0123456789ab.part.npz", "design-0123456789abcdef.json"]
    for name in (*own, ".lock", "steps-00002.part", "design-0123456789abcdef.json.part"):
        (tmp_path / "cells" / name).touch()
    assert store.remarks == []
    assert [path.name for path in tmp_path.rglob("*.part")] and CellStore(tmp_path).remarks == []
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.parametrize("link", [os.symlink, os.link], ids=["soft", "hard"])
def test_nothing_is_written_through_a_link(tmp_path: Path, link: Any) -> None:
    """Be it in place of the journal, a table, or a file that is not whole yet."""
    mine, out = tmp_path / "thesis.txt", tmp_path / "out"
    mine.write_text("mine", encoding="utf-8")
    (out / "cells").mkdir(parents=True)
    for name in (
        "open.cells",
        "steps-00001.part",
        "steps-00001.parquet",
        "runs-00001.parquet.part",
    ):
        link(mine, out / "cells" / name)
    store = filled(out, "a")
    store.close()
    link(mine, out / "cells" / "open.cells")
    store.append("b", "finished", record("b", 1))
    store.close()
    assert mine.read_text("utf-8") == "mine" and mine.stat().st_nlink == 1
    assert names_in(store) == ["a", "b"]


def test_a_linked_folder_of_cells_is_refused(tmp_path: Path) -> None:
    """Nothing is written or removed where it points to."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "steps-00001.parquet").touch()
    (tmp_path / "cells").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="cells: found a link"):
        CellStore(tmp_path)
    assert [path.name for path in (tmp_path / "elsewhere").iterdir()] == ["steps-00001.parquet"]


def test_tables_are_on_the_disk_before_the_journal_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both files, and then the names in their folder."""
    events: list[tuple[str, str]] = []
    store, fsync, replace, unlink = filled(tmp_path, "a"), os.fsync, Path.replace, Path.unlink

    def watched_fsync(number: int) -> None:
        events.append(("sync", Path(os.readlink(f"/proc/self/fd/{number}")).name))
        fsync(number)

    def watched_replace(path: Path, target: Path) -> Path:
        events.append(("name", target.name))
        return replace(path, target)

    def watched_unlink(path: Path, missing_ok: bool = False) -> None:
        if path.exists():
            events.append(("remove", path.name))
        unlink(path, missing_ok)

    monkeypatch.setattr(os, "fsync", watched_fsync)
    monkeypatch.setattr(Path, "replace", watched_replace)
    monkeypatch.setattr(Path, "unlink", watched_unlink)
    store.close()
    assert events == [
        ("sync", "steps-00001.part"),
        ("name", "steps-00001.parquet"),
        ("sync", "cells"),
        ("sync", "runs-00001.parquet.part"),
        ("name", "runs-00001.parquet"),
        ("sync", "cells"),
        ("remove", "open.cells"),
    ]
