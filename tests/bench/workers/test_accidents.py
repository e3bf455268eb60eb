"""Harm by a solver to its process is charged to it; accidents of the harness are `lost`."""

import errno
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pandas as pd
import pytest

from dpbench import load_results, run_campaign
from dpbench.bench.campaign import Campaign
from dpbench.bench.engines.dispatcher import Dispatcher
from dpbench.bench.progress import Silent
from dpbench.bench.record.cell import HARNESS_VERSION, Cell
from dpbench.bench.record.cell_store import CellStore
from dpbench.bench.record.raw_log import RawLog, is_log_full_size_and_writable, make_replay_layout
from dpbench.bench.record.result_folder import read_lost_count_and_remarks
from dpbench.bench.record.step_table import BatchPart
from dpbench.bench.sequences.source import choose_source_file
from dpbench.bench.workers import child as supervise, interleaved as interleave, scratch
from dpbench.bench.workers.jobs import Result
from dpbench.cli.main import main
from tests.bench.deterministic import run_suite, suite_file, suite_toml

pytestmark = pytest.mark.slow

STEPS = 8
HEAD: dict[str, Any] = {"solvers": ["quadprog"], "rounds": 1, "warmup_steps": 0}
LOOP = [{"scenarios": ["paper"], "steps": STEPS}]
REPLAY = [{"scenario": "paper", "steps": STEPS, "routes": ["qpsolvers", "native"]}]
RANDOM = [{"families": ["no_rows"], "sizes": [[3, 0], [4, 0]], "steps": STEPS}]
SUITE = suite_toml(**HEAD, closed_loop=LOOP, replay=REPLAY)
LEAVING = Path(__file__).with_name("leaving_plugin.py")
ENOUGH, SHORT = 10**9, 10**3


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    return suite_file(tmp_path, SUITE)


def run(suite: Path, out: Path) -> int:
    return read_lost_count_and_remarks(run_campaign(suite, out))[0]


def outcomes(out: Path) -> list[str]:
    """Return the outcomes of all rows, each of which stands for another cell."""
    runs = load_results(out).runs
    assert runs["run_id"].is_unique
    return list(runs["outcome"])


def leave(way: str, tmp_path: Path, limit_s: float = 60.0) -> Path:
    """The folder of a run of a solver that leaves at its sixth call in a process."""
    replay = [{"scenario": "paper", "steps": STEPS, "routes": ["native"]}]
    tables = {"closed_loop": LOOP, "replay": replay, "random": RANDOM}
    head = HEAD | {"solvers": ["leaving"], "cell_limit_s": limit_s}
    suite = suite_file(tmp_path, suite_toml(**head, **tables))
    module = tmp_path / "leaving_plugin.py"
    module.write_text(LEAVING.read_text(encoding="utf-8").replace('"system_exit"]', f'"{way}"]'))
    out = tmp_path / "out"
    arguments = ["run", str(suite), "--out", str(out)]
    assert main([*arguments, "--solver-module", str(module), "--solver", "leaving"]) == 0
    return out


@pytest.mark.alone  # What else runs could use up a limit of two seconds.
@pytest.mark.parametrize(
    ("way", "words"), [("sleep", "interrupted"), ("stay", "did not return and was killed")]
)
def test_a_hang_costs_its_step(
    way: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervise, "GRACE_S", 0.5)
    results = load_results(leave(way, tmp_path, limit_s=2.0))
    runs = results.runs
    assert set(runs["outcome"]) == {"finished"}, runs["outcome_detail"].tolist()
    assert runs["outcome_detail"].str.contains(words, regex=False).any()
    assert set(runs["steps_done"]) == {STEPS}
    steps = results.steps.set_index("run_id").loc[runs["run_id"][runs["mode"] == "closed_loop"]]
    assert steps["k"].tolist() == [*range(STEPS)]
    assert steps["k"][steps["status"] == "TIME_LIMIT"].tolist() == [5]


@pytest.mark.parametrize(
    ("way", "outcome", "words"),
    [
        ("exit", "crashed", "its process left with exit code 0"),
        ("system_exit", "crashed", "SystemExit(0)"),
        ("abort", "crashed", "killed by SIGABRT"),
    ],
)
def test_a_leaving_solver_is_charged(way: str, outcome: str, words: str, tmp_path: Path) -> None:
    runs = load_results(leave(way, tmp_path)).runs
    assert len(runs) == 4 and runs["run_id"].is_unique
    assert set(runs["outcome"]) == {outcome}, runs["outcome_detail"].tolist()
    assert runs["outcome_detail"].str.contains(words, regex=False).all()
    # A replay that is timed solves three steps before its first.
    replayed = (runs["mode"] == "replay") & (runs["scenario"] != "")
    assert runs["steps_done"].where(~replayed, 2).tolist() == runs["steps_done"].tolist()
    assert set(runs.loc[~replayed, "steps_done"]) == {5}


def test_logs_lie_elsewhere(suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = {scratch.MEMORY: SHORT}
    monkeypatch.setattr(scratch, "count_free_bytes", lambda place: free.get(place, ENOUGH))
    assert run(suite, tmp_path / "out") == 0
    assert outcomes(tmp_path / "out") == ["finished"] * 3
    remarks = load_results(tmp_path / "out").suite["remarks"]
    (remark,) = remarks
    assert "2 parts" in remark and "/dev/shm has 0.0 MB" in remark


def test_without_room_anywhere_cells_are_lost_until_there_is(
    suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["run", str(suite), "--out", str(out)]
    with monkeypatch.context() as patch:
        patch.setattr(scratch, "count_free_bytes", lambda place: SHORT)
        assert main(command) == 1
    assert outcomes(out) == ["lost"] * 3
    lines = capsys.readouterr().err.splitlines()
    (line,) = (line for line in lines if "3 of 3 cells were lost" in line)
    assert "no room" in line and "same command" in line
    assert main(command) == 0
    assert "lost" not in capsys.readouterr().err
    assert outcomes(out) == ["finished"] * 3


def test_columns_of_an_earlier_time_do_not_stay_with_a_crash(tmp_path: Path) -> None:
    text = suite_toml(**HEAD | {"solvers": ["leaving"]}, closed_loop=LOOP)
    module, marker = tmp_path / "dying.py", tmp_path / "marker"
    dying = DYING.replace("MARKER", repr(str(marker)))
    module.write_text(LEAVING.read_text(encoding="utf-8") + dying, encoding="utf-8")
    arguments = {"solver_module": module, "solvers": ["leaving"]}
    out = run_suite(tmp_path, text, **arguments)
    assert list(load_results(out).runs["steps_done"]) == [5]
    marker.touch()
    run_suite(tmp_path, text, fresh=True, **arguments)
    runs = load_results(out).runs
    assert (list(runs["outcome"]), list(runs["steps_done"])) == (["crashed"], [0])
    assert "while it was opened" in runs["outcome_detail"].iloc[0]


DYING = """
opened = open
def open(policy, options):
    if os.path.exists(MARKER):
        os._exit(0)
    return opened(policy, options)
"""


PARTING = """
import weakref
opened = open
def open(policy, options):
    workspace = opened(policy, options)
    weakref.finalize(workspace, os._exit, 0).atexit = False
    return workspace
"""


def test_a_library_that_dies_when_it_is_let_go_costs_no_cell(tmp_path: Path) -> None:
    module, text = tmp_path / "parting.py", suite_toml(**HEAD, random=RANDOM)
    module.write_text(LEAVING.read_text(encoding="utf-8").replace("== 6", "== 0") + PARTING)
    out = run_suite(tmp_path, text, solver_module=module, solvers=["leaving"])
    runs = load_results(out).runs
    assert list(runs["outcome"]) == ["finished"] * 2, list(runs["outcome_detail"])


def test_a_worker_that_died_between_rounds_ends_no_campaign(tmp_path: Path) -> None:
    cell = cast(Cell, SimpleNamespace(limit_s=1.0))
    child = supervise.ServingChild(
        supervise.start_forkserver(), print, ("bye",), tmp_path, "a", limit_s=1.0
    )
    child.process.join()
    worker = interleave.ReplayWorker("a", cell, child)
    interleave.ReplayGroup(cast(Any, None), tmp_path, tmp_path, []).run_round(worker, 1)
    assert not worker.serving


def mounted(size: str) -> list[str]:
    """The head of a command that runs with a /dev/shm of that size; skips where that cannot be."""
    mount = f'mount -t tmpfs -o size={size} tmpfs /dev/shm && exec "$@"'
    head = ["unshare", "--mount", "sh", "-c", mount, "sh"]
    try:
        allowed = subprocess.run([*head, "true"], capture_output=True, check=False).returncode == 0
    except OSError:
        allowed = False
    if not allowed:
        pytest.skip("mounting a file system is not permitted here")
    return head


def test_a_full_dev_shm_costs_no_cell(suite: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "dpbench", "run", str(suite), "--out", str(out)]
    done = subprocess.run([*mounted("1m"), *command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert outcomes(out) == ["finished"] * 3
    assert "/dev/shm has" in done.stderr


FILLED = """
import sys
from pathlib import Path
from dpbench.bench.workers import scratch
from dpbench.cli.main import main
# The room was there when it was looked for, and is gone when a worker comes for it.
Path("/dev/shm/filling").write_bytes(bytes(2**20))
scratch.count_free_bytes = lambda place: 10**9
raise SystemExit(main(sys.argv[1:]))
"""


def test_a_disk_that_fills_meanwhile_loses_cells(suite: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-c", FILLED, "run", str(suite), "--out", str(out)]
    done = subprocess.run([*mounted("1m"), *command], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    runs = load_results(out).runs
    assert list(runs["outcome"]) == ["lost"] * 3
    assert runs["outcome_detail"].str.contains("No space left on device").all()
    assert run(suite, out) == 0
    assert outcomes(out) == ["finished"] * 3


class _Remover(Silent):
    """A person who tidies up in the midst of a replay."""

    def __init__(self, place: Path) -> None:
        self._place = place

    def advance(self, work: int, what: str) -> None:
        if what == "replay paper, round 0":
            for folder in self._place.glob("dpbench-*"):
                shutil.rmtree(folder)


def test_a_removed_scratch(suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory, out = tmp_path / "memory", tmp_path / "out"
    memory.mkdir()
    monkeypatch.setattr(scratch, "MEMORY", memory)
    random = [RANDOM[0] | {"routes": ["qpsolvers"]}]
    suite_file(tmp_path, suite_toml(**HEAD, closed_loop=LOOP, replay=REPLAY, random=random))
    run_campaign(suite, out, progress=_Remover(memory))
    runs = load_results(out).runs
    lost = (runs["mode"] == "replay") & (runs["scenario"] != "")
    assert runs["outcome"].tolist() == ["lost" if gone else "finished" for gone in lost]
    assert read_lost_count_and_remarks(out)[0] == lost.sum() == 2
    kept = runs.loc[~lost, "raw_max_ns"].tolist()
    assert run(suite, out) == 0
    assert set(outcomes(out)) == {"finished"}
    assert load_results(out).runs.loc[~lost.to_numpy(), "raw_max_ns"].tolist() == kept


def truncate(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)


def forget_cells(out: Path) -> None:
    """Let the cells run again, with the files that their QPs are made from."""
    (out / "runs.parquet").unlink()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result folder whose copies are damaged, beside its suite."""
    base = tmp_path_factory.mktemp("accidents")
    run_suite(base, SUITE)
    return base


@pytest.fixture
def copied(finished: Path, tmp_path: Path) -> Path:
    shutil.copytree(finished, tmp_path / "copy")
    return tmp_path / "copy"


def made_source(out: Path) -> tuple[Cell, Path]:
    """A cell of a result folder, and the reference loop behind it, as while it is needed."""
    cell = Cell.from_json(load_results(out).runs["cell"].iloc[0])
    path = out / "cells" / f"exact-{cell.source_key(HARNESS_VERSION)}.npz"
    choose_source_file(cell).make_file(path)
    return cell, path


def test_a_damaged_source_is_made_anew(copied: Path) -> None:
    out = copied / "out"
    _, source = made_source(out)
    truncate(source)
    forget_cells(out)
    assert run(copied / "tiny.toml", out) == 0
    assert outcomes(out) == ["finished"] * 3
    assert not source.exists(), "it is kept as long as it is needed, and no longer"


@pytest.mark.parametrize("times", [1, 2])
def test_a_source_damaged_later(times: int, copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, left, take = copied / "out", [times], Dispatcher._note_made_sources
    forget_cells(out)

    def damaged(self: Dispatcher, results: Sequence[Result]) -> None:
        take(self, results)
        for path in (out / "cells").glob("exact-*.npz") if left[0] > 0 else ():
            flip(path)
        left[0] -= 1

    with monkeypatch.context() as patch:
        patch.setattr(Dispatcher, "_note_made_sources", damaged)
        assert run(copied / "tiny.toml", out) == times - 1
    assert outcomes(out) == [["finished", "lost"][times - 1], "finished", "finished"]
    assert run(copied / "tiny.toml", out) == 0
    assert outcomes(out) == ["finished"] * 3


@pytest.mark.parametrize("outcome", ["splendid", "lost"])
def test_an_outcome_nobody_knows_is_none(outcome: str, copied: Path) -> None:
    path = copied / "out" / "runs.parquet"
    pd.read_parquet(path).assign(outcome=outcome).to_parquet(path)
    assert CellStore(copied / "out").finished == {}


@pytest.mark.parametrize("table", ["runs", "steps"])
def test_damaged_cells_run_again(table: str, copied: Path) -> None:
    out = copied / "out"
    before = load_results(out).runs
    truncate(out / f"{table}.parquet")
    assert run(copied / "tiny.toml", out) == 0
    after = load_results(out).runs
    assert outcomes(out) == ["finished"] * 3 and set(after["steps_done"]) == {STEPS}
    assert not (before["raw_max_ns"] == after["raw_max_ns"]).any()


def test_parts_damaged_meanwhile_are_lost(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, write = copied / "out", Campaign.write_results
    forget_cells(out)

    def late(self: Campaign, *rest: Any, **more: Any) -> None:
        truncate(self.store.parts[-1].steps)
        write(self, *rest, **more)

    with monkeypatch.context() as patch:
        patch.setattr(Campaign, "write_results", late)
        lost = run(copied / "tiny.toml", out)
    assert 1 <= lost <= 2 and outcomes(out) == ["finished"] * (3 - lost) + ["lost"] * lost
    assert run(copied / "tiny.toml", out) == 0
    assert outcomes(out) == ["finished"] * 3


def test_stale_folders_go(copied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed behind its last cell, a run leaves a folder to the next, which has nothing to run."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left = tmp_path / "dpbench-scratch-killed"
    (left / "sockets").mkdir(parents=True)
    assert run(copied / "tiny.toml", copied / "out") == 0
    assert not left.exists()


def test_a_referee_that_fails_loses_the_cell(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, where = copied / "out", scratch.Scratch.choose_folder
    failing = load_results(out).runs["run_id"].iloc[0]
    forget_cells(out)

    def spoilt(self: scratch.Scratch, *rest: Any) -> Path:
        folder = where(self, *rest)
        (folder / f"{failing}.judged").mkdir(exist_ok=True)
        return folder

    with monkeypatch.context() as patch:
        patch.setattr(scratch.Scratch, "choose_folder", spoilt)
        assert run(copied / "tiny.toml", out) == 1
    assert outcomes(out) == ["lost", "finished", "finished"]
    detail = load_results(out).runs["outcome_detail"].iloc[0]
    assert detail.startswith("the referee failed on it: IsADirectoryError")
    assert run(copied / "tiny.toml", out) == 0
    assert outcomes(out) == ["finished"] * 3


def test_a_part_without_room(suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, add = tmp_path / "out", CellStore.write_part_file

    def full(self: CellStore, part: BatchPart) -> None:
        refused.add(part.data)
        if len(refused) == 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        add(self, part)

    refused: set[bytes] = set()
    with monkeypatch.context() as patch:
        patch.setattr(CellStore, "write_part_file", full)
        assert run(suite, out) == 1
    runs = load_results(out).runs
    assert sorted(runs["outcome"]) == ["finished", "finished", "lost"]
    assert runs["outcome_detail"].str.contains("No space left on device").sum() == 1
    assert run(suite, out) == 0 and outcomes(out) == ["finished"] * 3


def test_a_log_has_its_room_or_is_none(tmp_path: Path) -> None:
    path = tmp_path / "a.raw"
    RawLog.create(path, make_replay_layout(1, 50, 3, 3))
    size = path.stat().st_size
    assert 512 * path.stat().st_blocks >= size and is_log_full_size_and_writable(path)
    os.truncate(path, size - 1)
    assert not is_log_full_size_and_writable(path)
    with pytest.raises(OSError, match=r"."):
        RawLog.create(
            tmp_path / "b.raw", make_replay_layout(2**20, 2**20, 8, 8) | {"done": ("i8", (1,))}
        )
    assert not list(tmp_path.glob("b.raw")) and not list(tmp_path.glob("*.blank"))
