"""Shards of a suite, run apart and gathered, are the suite."""

import json
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from dpbench import load_results, run_campaign
from dpbench.bench.engines.shards import SHARD_FILE, Shard, ShardRecord
from dpbench.bench.gather import join_result_folders
from dpbench.bench.plan.run_request import RunRequest
from dpbench.bench.record.cell_store import CellStore
from dpbench.bench.record.step_table import runs_from_frame, runs_to_frame, write_runs
from dpbench.cli.main import main
from dpbench.errors import InputError
from dpbench.solvers import plugins
from tests.bench.deterministic import assert_same, suite_file, suite_toml

pytestmark = pytest.mark.slow
PLUGIN = Path(__file__).parents[2] / "solvers" / "example_plugin.py"


@pytest.fixture(scope="module")
def shards(suite: Path) -> list[Path]:
    folders = [suite.parent / f"shard{i}" for i in (1, 2, 3)]
    for i, folder in enumerate(folders, 1):
        words = ["cells", str(suite), "--shard", f"{i}/3", "--out", str(folder)]
        assert main(words) == 0
    return folders


@pytest.fixture
def copies(shards: list[Path], tmp_path: Path) -> list[Path]:
    return [Path(shutil.copytree(folder, tmp_path / folder.name)) for folder in shards]


def test_gathered_shards_are_one_run(
    shards: list[Path], undisturbed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cells = [set(load_results(folder).runs["run_id"]) for folder in shards]
    assert all(cells) and not (cells[0] & cells[1] | cells[0] & cells[2] | cells[1] & cells[2])
    out = tmp_path / "out"
    assert main(["gather", *map(str, shards), "--out", str(out), "--quiet"]) == 0
    assert capsys.readouterr().err == ""
    assert_same(out, undisturbed)
    assert (out / "report.html").is_file()


def test_missing_shards(copies: list[Path], suite: Path, undisturbed: Path, tmp_path: Path) -> None:
    damaged = CellStore(copies[0]).public.steps
    data = bytearray(damaged.read_bytes())
    data[: len(data) // 2] = bytes(len(data) // 2)
    damaged.write_bytes(data)
    there = len(load_results(copies[1]).runs)
    out = join_result_folders(copies[:2], tmp_path / "out")
    results = load_results(out)
    assert (results.runs["outcome"] == "finished").sum() == there
    assert set(results.runs["outcome"]) == {"finished", "lost"}
    assert "missing shards: 3/3" in results.suite["remarks"]
    run_campaign(suite, out)
    assert_same(out, undisturbed)


def test_a_killed_shard_is_gathered(copies: list[Path], undisturbed: Path, tmp_path: Path) -> None:
    killed = CellStore(copies[2])
    CellStore(tmp_path / "parts").copy_runs_of_other_folder(killed)
    killed.public.runs.unlink()
    killed.public.steps.unlink()
    for part in (tmp_path / "parts" / "cells").iterdir():
        part.rename(killed.folder / part.name)
    (copies[2] / "suite.json").unlink()
    (copies[2] / "machine.json").unlink()
    assert_same(join_result_folders(copies, tmp_path / "out"), undisturbed)


def changed(folder: Path, **entries: object) -> None:
    """A shard that says something else of itself."""
    path = folder / SHARD_FILE
    document = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(document | entries), encoding="utf-8")


def test_foreign_shards_are_refused(copies: list[Path], undisturbed: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    changed(copies[0], harness_version="0.0.9")
    with pytest.raises(InputError, match=r"shard1 of dpbench 0\.0\.9"):
        join_result_folders(copies, out)
    changed(
        copies[0],
        harness_version=json.loads((copies[1] / SHARD_FILE).read_text())["harness_version"],
    )
    changed(copies[0], digest="0" * 16)
    with pytest.raises(InputError, match="whose suite or options differ"):
        join_result_folders(copies, out)
    with pytest.raises(InputError, match="has changed since"):
        join_result_folders(copies[:1], out)
    changed(copies[1], shard={"index": 1, "count": 4})
    with pytest.raises(InputError, match="found shards I/3 and I/4;"):
        join_result_folders(copies[1:], out)
    with pytest.raises(InputError, match="no shard in this folder; required"):
        join_result_folders([undisturbed], out)
    assert not out.exists()


def test_moved_suites(copies: list[Path], suite: Path, undisturbed: Path, tmp_path: Path) -> None:
    asked = json.loads((copies[0] / SHARD_FILE).read_text())["asked"]
    for i, folder in enumerate(copies[:2]):
        changed(folder, asked=asked | {"suite": f"/on/host{i}/tiny.toml"})
    assert_same(join_result_folders(copies, tmp_path / "out"), undisturbed)
    with pytest.raises(InputError, match=r"no file /on/host0/tiny\.toml.*--suite"):
        join_result_folders(copies[:2], tmp_path / "other")
    changed(copies[2], asked=asked | {"suite": "/on/host2/tiny.toml"})
    assert_same(join_result_folders(copies, tmp_path / "other", suite=suite), undisturbed)


def test_a_plug_in_is_not_run_because_a_shard_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of two: the option is given for each."""
    module, marker = tmp_path / "admm.py", tmp_path / "was run"
    suite = suite_file(tmp_path, suite_toml(closed_loop=[{"scenarios": ["calm"], "steps": 5}]))
    text = f"open({str(marker)!r}, 'w').close()\n{PLUGIN.read_text(encoding='utf-8')}"
    module.write_text(text, encoding="utf-8")
    shard, out = tmp_path / "shard", tmp_path / "out"
    second = tmp_path / "second.py"
    second.write_text(PLUGIN.read_text(encoding="utf-8").replace('"admm"', '"second"'))
    plugin = ["--solver-module", str(module), "--solver-module", str(second)]
    solvers = ["--solver", "admm", "--solver", "second"]
    words = ["cells", str(suite), *solvers, "--out", str(shard), *plugin]
    assert main(words) == 0
    marker.unlink()
    capsys.readouterr()
    monkeypatch.setattr(plugins, "_LOADED", {})  # as in another process
    command = ["gather", str(shard), "--out", str(out), "--quiet"]
    assert main(command) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "admm.py, " in line and "second.py; " in line and "--solver-module" in line
    assert not marker.exists() and not out.exists()
    asked = json.loads((shard / SHARD_FILE).read_text())["asked"]
    changed(shard, asked=asked | {"solver_module": str(tmp_path / "other.py")})
    (tmp_path / "other.py").write_text(f"open({str(marker)!r} + '2', 'w')", encoding="utf-8")
    assert main([*command, *plugin]) == 0
    assert not Path(f"{marker}2").exists()
    assert load_results(out).runs["outcome"].tolist() == ["finished", "finished"]


def test_links_are_not_gathered(copies: list[Path], undisturbed: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("{}", encoding="utf-8")
    (copies[0] / "cells" / f"design-{16 * 'a'}.json").symlink_to(tmp_path / "secret")
    (copies[1] / "cells" / "part-00001 (copy).parquet").touch()
    out = join_result_folders(copies, tmp_path / "out")
    assert_same(out, undisturbed)
    assert not list((out / "cells").glob("design-*"))
    (remark,) = load_results(out).suite["remarks"]
    assert "ignored 'part-00001 (copy).parquet'" in remark


def test_another_machine_is_kept_for_each_cell(copies: list[Path], tmp_path: Path) -> None:
    other = "ffffffffffff"
    machine = json.loads((copies[1] / SHARD_FILE).read_text())["machine"]
    public = CellStore(copies[1]).public
    rows = runs_to_frame(public.read_rows()).assign(machine_id=other)
    check = pq.read_metadata(public.runs).metadata[b"steps_crc32"].decode()
    write_runs(public.runs, runs_from_frame(rows), {"steps_crc32": check})
    changed(copies[1], machine=machine | {"id": other})
    results = load_results(join_result_folders(copies, tmp_path / "out"))
    assert results.runs["run_id"].is_unique and set(results.runs["outcome"]) == {"finished"}
    counts = results.runs["machine_id"].value_counts()
    assert counts[other] == len(rows) and set(counts.index) == {other, machine["id"]}
    assert {one["id"] for one in (results.machine, *results.machine["others"])} == set(counts.index)
    assert "2 kinds of machines" in results.suite["remarks"][0]


@pytest.mark.parametrize(
    "entries",
    [
        {"shard": {"index": 1, "count": 10**9}},
        {"shard": {"index": 0, "count": 3}},
        {"shard": {"index": "1", "count": 3}},
        {"shard": []},
        {"asked": {"suite": 5}},
        {"asked": {"suite": "smoke", "other": 1}},
        {"machine": {}},
        {"machine": []},
        {"digest": None},
        {"revision": 1},
        {"more": 1},
    ],
)
def test_a_damaged_description_of_a_shard_is_one_line(
    entries: dict[str, object], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    about = {"id": "abc", "cpu_model": "x"}
    ShardRecord(RunRequest(suite="smoke"), Shard(1, 3), "0" * 16, about).write(tmp_path)
    assert str(ShardRecord.read(tmp_path).shard) == "1/3"
    changed(tmp_path, **entries)
    assert main(["gather", str(tmp_path), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f"{SHARD_FILE}: {next(iter(entries))}" in line


@pytest.mark.parametrize("text", ["0/3", "4/3", "1/1000000000", "1", "a/b", "1/" + "9" * 5000])
def test_what_is_no_shard_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"`shard`: found .*1/4, with I from 1 to N"):
        Shard.from_text(text)
