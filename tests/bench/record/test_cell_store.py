"""Finished cells: what parts and public tables hold, and what no kill costs."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from dpbench.bench.judge.rows import make_step_rows
from dpbench.bench.judge.rules import StepColumns
from dpbench.bench.progress import Silent
from dpbench.bench.record import cell_store
from dpbench.bench.record.cell_store import CellStore, StepFile, count_batches_newer_than_tables
from dpbench.bench.record.recorded_steps import read_steps, scan_steps
from dpbench.bench.record.schema import (
    MISSING_INT,
    RUN_COLUMNS,
    SCHEMA_VERSION,
    STEP_COLUMNS,
    convert_to_run_columns,
    convert_to_step_columns,
)
from dpbench.bench.record.step_table import (
    BatchPart,
    add_missing_step_columns,
    build_runs_table,
    filter_steps_by_run_id,
    join_steps_of_runs,
    make_batch_part,
    make_empty_record_batch,
    make_step_record_batch,
    rows_to_columns,
)
from dpbench.bench.tabulate import RequestedRuns, tabulate


def steps_of(seed: int, count: int = 7) -> StepColumns:
    """Made-up steps of a closed loop, some numbers missing."""
    rng = np.random.default_rng(seed)
    steps: StepColumns = {}
    for name, (dtype, _) in STEP_COLUMNS.items():
        if dtype == "Int64":
            steps[name] = rng.integers(MISSING_INT, 10**6, count)
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


def part(*names: str, seed: int = 0, **changes: Any) -> BatchPart:
    return make_batch_part(
        {
            name: (row_of(name, **changes), make_step_record_batch(steps_of(seed + i)))
            for i, name in enumerate(names)
        }
    )


def filled(out: Path, *names: str) -> CellStore:
    """A store with those cells, each in a part of its own."""
    store = CellStore(out)
    for seed, name in enumerate(names):
        store.write_part_file(part(name, seed=seed))
    return store


def write_public(out: Path, *names: str) -> None:
    store = CellStore(out)
    steps = StepFile(out / "steps.part")
    for seed, name in enumerate(names):
        steps.add(join_steps_of_runs({name: make_step_record_batch(steps_of(seed))}))
    rows = build_runs_table(rows_to_columns([row_of(name) for name in names]))
    store.public.write(rows, steps, store.last_part)


def tables_of(store: CellStore) -> list[pa.Table]:
    _, sources = store.collect_rows_and_sources()
    tables = [group.read_table() for group in store.yield_step_groups(sources)]
    names = [name for table in tables for name in table["run_id"].unique().to_pylist()]
    assert len(names) == len(set(names))
    return [
        filter_steps_by_run_id(t, {n}) for t in tables for n in t["run_id"].unique().to_pylist()
    ]


def names_in(store: CellStore) -> list[str]:
    return [table["run_id"][0].as_py() for table in tables_of(store)]


def test_steps_come_back_bit_for_bit(tmp_path: Path) -> None:
    steps = steps_of(2)
    file = StepFile(tmp_path / "steps.parquet")
    file.add(join_steps_of_runs({"a": make_step_record_batch(steps)}))
    file.close()
    found = convert_to_step_columns(read_steps(tmp_path, list(STEP_COLUMNS)).to_pandas())
    pd.testing.assert_frame_equal(found, make_step_rows("a", steps), check_exact=True)


def test_only_the_runs_and_columns_that_are_asked_for(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(cell_store, "GROUP_ROWS", 10)
    file, names = StepFile(tmp_path / "steps.parquet"), ["a", "b", "c", "d", "e"]
    for seed, name in enumerate(names):
        file.add(join_steps_of_runs({name: make_step_record_batch(steps_of(seed))}))
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
    table = join_steps_of_runs(
        {"a": make_step_record_batch(steps_of(0)), "b": make_step_record_batch(steps_of(1))}
    )
    assert filter_steps_by_run_id(table, {"b"})["run_id"].unique().to_pylist() == ["b"]
    nothing = filter_steps_by_run_id(table, {"c"})
    assert nothing.schema.equals(table.schema) and len(nothing) == 0
    assert nothing.get_total_buffer_size() < 100 < table.get_total_buffer_size()


def test_what_another_schema_left_is_not_finished(tmp_path: Path) -> None:
    store = CellStore(tmp_path)
    store.write_part_file(part("old", schema=SCHEMA_VERSION - 1))
    store.write_part_file(part("new", seed=1))
    again = CellStore(tmp_path)
    assert again.finished == {"new": "finished"} and names_in(again) == ["new"]


@pytest.mark.parametrize(
    "wrong",
    [{"N_p": "many"}, {"seed": None}, {"run_id": 5}, {"run_id": None}, {"cell": "{"}, {"cell": 5}],
)
def test_a_row_of_other_types_is_not_finished(tmp_path: Path, wrong: dict[str, Any]) -> None:
    rows = {"a": row_of("a"), "b": row_of("b") | wrong, "c": row_of("c")}
    steps = make_step_record_batch(steps_of(0))
    CellStore(tmp_path).write_part_file(
        make_batch_part({name: (row, steps) for name, row in rows.items()})
    )
    store = CellStore(tmp_path)
    assert (
        list(store.finished)
        == list(store.read_finished_runs().index)
        == ["a", "c"]
        == names_in(store)
    )


@pytest.mark.parametrize("at", [0, 10, -100, -1])
@pytest.mark.parametrize("how", ["flipped", "cut", "empty"])
def test_a_damaged_part_costs_itself_alone(tmp_path: Path, at: int, how: str) -> None:
    store = filled(tmp_path, "a", "b", "c")
    path = store.parts[1].steps
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes({"flipped": data, "cut": data[:at], "empty": b""}[how])
    for seen in (store, CellStore(tmp_path)):
        assert list(seen.read_finished_runs().index) == names_in(seen) == ["a", "c"]
    assert list(CellStore(tmp_path).finished) == ["a", "c"]


def test_a_part_without_room_leaves_the_others(tmp_path: Path, monkeypatch: Any) -> None:
    store, write = filled(tmp_path, "a"), Path.write_bytes

    def full(path: Path, data: bytes) -> None:
        write(path, data[: len(data) // 2])
        raise OSError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        with pytest.raises(OSError, match="no room"):
            store.write_part_file(part("b", seed=1))
    assert len(list((tmp_path / "cells").iterdir())) == 1
    store.write_part_file(part("c", seed=2))
    assert list(store.finished) == ["a", "c"] == list(CellStore(tmp_path).finished)


def test_a_batch_is_one_file(tmp_path: Path) -> None:
    store, batch = CellStore(tmp_path), part("a", "b")
    for _ in range(2):
        store.write_part_file(batch)
    (path,) = (tmp_path / "cells").iterdir()
    assert path.read_bytes() == batch.data
    steps = pq.read_table(path)
    assert steps.column_names == list(STEP_COLUMNS)
    assert steps["run_id"].to_pylist() == 7 * ["a"] + 7 * ["b"]


def test_cells_without_steps_are_finished(tmp_path: Path) -> None:
    store = CellStore(tmp_path)
    crashed = row_of("c", outcome="crashed", steps_done=0), make_empty_record_batch()
    store.write_part_file(
        make_batch_part({"a": (row_of("a"), make_step_record_batch(steps_of(0))), "c": crashed})
    )
    store.write_part_file(
        make_batch_part({"d": (row_of("d", steps_done=0), make_empty_record_batch())})
    )
    assert CellStore(tmp_path).finished == {"a": "finished", "c": "crashed", "d": "finished"}
    assert names_in(store) == ["a"]


def test_joining_parts(tmp_path: Path) -> None:
    store = filled(tmp_path, "a", "b", "c")
    rows, sources = store.collect_rows_and_sources()
    file = StepFile(tmp_path / "steps.part")
    for group in store.yield_step_groups(sources):
        file.add(group.read_table())
    store.public.write(rows, file, store.last_part)
    assert file.rows == 21
    groups = pq.ParquetFile(tmp_path / "steps.parquet", page_checksum_verification=True)
    assert groups.num_row_groups == 1
    found = add_missing_step_columns(groups.read())
    batches = {name: make_step_record_batch(steps_of(seed)) for seed, name in enumerate("abc")}
    assert found.equals(add_missing_step_columns(join_steps_of_runs(batches)))
    assert store.public.is_undamaged() and list(store.public.read_outcomes_by_run_id()) == [
        "a",
        "b",
        "c",
    ]


@pytest.fixture
def twice(tmp_path: Path) -> Iterator[CellStore]:
    """A cell in two parts, as after a kill while parts were being put together."""
    CellStore(tmp_path).write_part_file(part("a", "b"))
    CellStore(tmp_path).write_part_file(part("b", seed=9, steps_done=9))
    yield CellStore(tmp_path)


def test_a_cell_in_two_places_is_there_once(twice: CellStore) -> None:
    assert names_in(twice) == ["a", "b"]
    assert twice.read_finished_runs().loc["b", "steps_done"] == 9
    last = tables_of(twice)[1]
    assert last["gap"].to_pylist()[1:] == steps_of(9)["gap"].tolist()[1:]


def test_what_is_forgotten_is_there_only_if_it_comes_again(tmp_path: Path) -> None:
    filled(tmp_path, "a", "b", "c")
    store = CellStore(tmp_path)
    store.mark_unfinished(["a", "b"])
    store.write_part_file(part("b", seed=9))
    assert set(store.finished) == set(store.read_finished_runs().index) == {"b", "c"}
    assert sorted(names_in(store)) == ["b", "c"]


def test_readable_groups_of_a_damaged_file_count(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(cell_store, "GROUP_ROWS", 1)
    write_public(tmp_path, *"abc")
    public = CellStore(tmp_path).public
    assert list(public.read_outcomes_by_run_id()) == ["a", "b", "c"]
    group = pq.ParquetFile(public.steps).metadata.row_group(1).column(10)
    data = bytearray(public.steps.read_bytes())
    data[group.data_page_offset + group.total_compressed_size - 3] ^= 1
    public.steps.write_bytes(data)
    assert list(public.read_outcomes_by_run_id()) == ["a", "c"] == names_in(CellStore(tmp_path))


def test_public_steps_that_are_newer_than_their_runs_cost_nothing(tmp_path: Path) -> None:
    write_public(tmp_path, "a")
    store = CellStore(tmp_path)
    store.write_part_file(part("b", seed=1))
    both = StepFile(tmp_path / "steps.parquet")
    both.add(
        join_steps_of_runs(
            {name: make_step_record_batch(steps_of(i)) for i, name in enumerate("ab")}
        )
    )
    both.close()
    store = CellStore(tmp_path)
    assert list(store.finished) == ["a", "b"] and names_in(store) == ["a", "b"]


COPIES = ("part-00001{} (copy).parquet", "part-00007 (copy){}.parquet", "runs-x{}.parquet")
COPIES += ("part-00001{} (conflicted copy 2026-11-22).parquet", "part-x{}.parquet")
COPIES += ("part-00001{}.sync-conflict-20261122-101500-ABCDEFG.parquet",)


def test_copies_that_sync_tools_leave_are_ignored_and_named(tmp_path: Path) -> None:
    CellStore(tmp_path).write_part_file(part("a", "b"))
    (source,) = (tmp_path / "cells").iterdir()
    copies = [source.with_name(name.format(source.stem[10:])) for name in COPIES]
    for copy in copies:
        copy.write_bytes(source.read_bytes())
    store = CellStore(tmp_path)
    assert list(store.finished) == ["a", "b"] and names_in(store) == ["a", "b"]
    store.write_part_file(part("c"))
    assert [one.steps.name[:11] for one in store.parts] == ["part-00001-", "part-00002-"]
    (remark,) = store.remarks
    assert "ignored 'part-00001-" in remark and " and 5 more" in remark
    assert str(tmp_path) in remark and all(copy.exists() for copy in copies)


def test_own_files_are_not_remarked_on(tmp_path: Path) -> None:
    store = filled(tmp_path, "a")
    own = ["exact-0123456789ab.npz", "exact-0123456789ab.part.npz", "design-0123456789abcdef.json"]
    own += ["part-00002-01234567.parquet.part", "design-0123456789abcdef.json.part", ".lock"]
    for name in own:
        (tmp_path / "cells" / name).touch()
    assert store.remarks == []
    assert [path.name for path in tmp_path.rglob("*.part")] and CellStore(tmp_path).remarks == []
    assert not list(tmp_path.rglob("*.part"))


def tabulate_only(name: str, store: CellStore) -> None:
    job = SimpleNamespace(run_id=name, cell=SimpleNamespace(settings="default"))
    job.planned = SimpleNamespace(alias_settings=[])
    tabulate(cast(Any, [job]), store, Silent())


def test_only_batches_after_the_tables_are_of_a_later_run(tmp_path: Path) -> None:
    """Parts of an interrupted larger run that are older than the tables are no later run."""
    assert count_batches_newer_than_tables(tmp_path) == 0
    store = filled(tmp_path, "a", "b")
    assert count_batches_newer_than_tables(tmp_path) == 2
    tabulate_only("a", store)
    assert names_in(CellStore(tmp_path)) == ["a", "b"] and len(CellStore(tmp_path).parts) == 1
    assert count_batches_newer_than_tables(tmp_path) == 0
    CellStore(tmp_path).write_part_file(part("c"))
    assert count_batches_newer_than_tables(tmp_path) == 1
    tabulate_only("c", CellStore(tmp_path))
    assert count_batches_newer_than_tables(tmp_path) == 0


def test_numbers_of_parts_go_on_where_all_are_in_the_tables(tmp_path: Path) -> None:
    tabulate_only("a", filled(tmp_path, "a"))
    assert not CellStore(tmp_path).parts
    CellStore(tmp_path).write_part_file(part("b"))
    assert count_batches_newer_than_tables(tmp_path) == 1


def test_tables_are_synced_before_parts_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
    (name,) = (path.name for path in (tmp_path / "cells").iterdir())
    tabulate_only("a", store)
    assert events == [
        ("sync", "steps.parquet.part"),
        ("name", "steps.parquet"),
        ("sync", tmp_path.name),
        ("sync", "runs.parquet.part"),
        ("name", "runs.parquet"),
        ("sync", tmp_path.name),
        ("remove", name),
    ]


def test_a_shard_without_cells_has_a_table_without_rows() -> None:
    rows = RequestedRuns([]).make_rows(
        convert_to_run_columns(pd.DataFrame()).set_index("run_id", drop=False)
    )
    assert len(rows) == 0 and set(RUN_COLUMNS) <= set(rows)
