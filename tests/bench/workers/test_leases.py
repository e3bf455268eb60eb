"""Campaigns that know nothing of each other share a machine: its cores, and its quiet."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from dpbench import load_results, locks, run_campaign
from dpbench.bench.progress import Silent
from dpbench.cli.main import main
from dpbench.errors import InputError
from dpbench.locks import BusyError, find_safe_lock_folder, hold_free_core_lock
from dpbench.notebook.runs import run_closed_loop
from dpbench.scenario.scenario import load_scenario
from dpbench.solvers.open import open_workspace
from tests.bench.deterministic import run_suite, suite_file, suite_toml

pytestmark = pytest.mark.slow

HEAD: dict[str, Any] = {"rounds": 1, "warmup_steps": 0}
LOOPS = suite_toml(**HEAD, closed_loop=[{"scenarios": ["paper"], "steps": 5}])
REPLAYS = suite_toml(**HEAD, replay=[{"scenario": "paper", "steps": 5}])
OTHERS = "hold_machine_lock({}, Holder('results/other'))"
HOLDING = """
from dpbench.locks import EXCLUSIVE, SHARED, Holder, hold_free_core_lock, hold_machine_lock
with {lease} as held:
    print(held, flush=True)
    input()
"""


@contextmanager
def holding(lease: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A process that has a lease until it is killed, and what it got."""
    command = [sys.executable, "-c", HOLDING.format(lease=lease)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        assert process.stdout is not None
        yield process, process.stdout.readline().strip()
        process.kill()


@pytest.fixture(autouse=True)
def temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leases of this test alone, also for the processes that it starts."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(locks, "tempfile", SimpleNamespace(gettempdir=lambda: str(tmp_path)))


@pytest.mark.alone  # What runs side by side has one core each.
def test_a_core_is_leased_to_one_process_at_a_time() -> None:
    cores = sorted(os.sched_getaffinity(0))
    with holding("hold_free_core_lock()") as (_, core):
        taken = int(core)
        with hold_free_core_lock() as first, hold_free_core_lock() as second:
            assert taken in cores and (first != taken or len(cores) == 1)
            # More work than cores: one of them has two.
            assert second in cores
    with hold_free_core_lock() as core_again:
        assert core_again == taken == cores[0]


class Remarks(Silent):
    """A progress that keeps what a wait was said for, and kills who is waited for."""

    def __init__(self, other: subprocess.Popen[str]) -> None:
        self.waits: list[str] = []
        self._other = other

    def waiting(self, text: str) -> None:
        self.waits.append(text)
        self._other.kill()


@pytest.mark.parametrize(
    ("lease", "suite", "waits"),
    [
        ("EXCLUSIVE", REPLAYS, True),
        ("SHARED", REPLAYS, True),
        ("EXCLUSIVE", LOOPS, True),
        ("SHARED", LOOPS, False),
    ],
)
def test_replays_are_timed_alone(lease: str, suite: str, waits: bool, tmp_path: Path) -> None:
    with holding(OTHERS.format(lease)) as (other, held):
        assert held == "True"
        progress = Remarks(other)
        out = run_suite(tmp_path, suite, progress=progress)
        named = f"process {other.pid} (results/other, since 20"
    assert [named in text for text in progress.waits] == [True] * waits
    runs = load_results(out).runs
    assert set(runs["outcome"]) == {"finished"}
    assert runs["concurrency"].dropna().eq(1).all()


def test_without_locks_nothing_is_ranked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nowhere = SimpleNamespace(gettempdir=lambda: str(tmp_path / "nowhere"))
    monkeypatch.setattr(locks, "tempfile", nowhere)
    runs = load_results(run_suite(tmp_path, REPLAYS)).runs
    assert runs["outcome"].tolist() == ["finished"] and runs["concurrency"].tolist() == [2]


@pytest.mark.parametrize(("option", "seconds"), [("--no-wait", []), ("--wait", ["0.3"])])
def test_a_wait_ends_where_it_was_asked_to(
    option: str, seconds: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["run", str(suite_file(tmp_path, REPLAYS)), "--out", str(tmp_path / "out"), "--quiet"]
    with holding(OTHERS.format("SHARED")) as (other, _):
        assert main([*words, option, *seconds]) == 2
    out, err = capfd.readouterr()
    named = f"process {other.pid} (results/other, since 20"
    lines = [line for line in err.splitlines() if "compiling" not in line]
    assert out == "" and len(lines) == 1 + len(seconds) and all(named in line for line in lines)
    assert "this machine: in use by" in lines[-1]


def test_nobody_waits_without_timing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with holding(OTHERS.format("EXCLUSIVE")):
        assert main(["run", str(suite_file(tmp_path, REPLAYS)), "--dry-run", "--quiet"]) == 0
        assert run_closed_loop(load_scenario("paper").truncate(3), open_workspace("daqp"))
    assert "1 cells to run" in capsys.readouterr().out


def test_a_campaign_that_was_killed_is_not_named(tmp_path: Path) -> None:
    with holding(OTHERS.format("SHARED")) as (killed, _):
        named = (find_safe_lock_folder() / "machine").read_text(encoding="utf-8")
    assert f'"pid": {killed.pid}' in named
    with holding(OTHERS.format("SHARED")) as (other, _):
        with (find_safe_lock_folder() / "machine").open("a", encoding="utf-8") as file:
            file.write('null\n{"pid": 1, "since": 1e99, "work": ""}\n\x00[[[\n')
        with pytest.raises(BusyError) as busy:
            run_suite(tmp_path, REPLAYS, wait_s=0.0)
    assert f"process {other.pid} " in str(busy.value) and str(killed.pid) not in str(busy.value)


def _linked(folder: Path) -> None:
    folder.with_name("elsewhere").mkdir()
    folder.symlink_to(folder.with_name("elsewhere"))


def _open_to_all(folder: Path) -> None:
    folder.mkdir()
    folder.chmod(0o777)


def _of_another(folder: Path) -> None:
    folder.mkdir()
    os.chown(folder, 65534, 65534)


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (_linked, "a link"),
        (Path.touch, "a file"),
        (_open_to_all, "a folder that others can write to (mode 777)"),
        pytest.param(
            _of_another,
            "a folder of user",
            marks=pytest.mark.skipif(os.getuid() != 0, reason="only root gives folders away"),
        ),
    ],
)
def test_writable_lease_folders(make: Callable[[Path], object], fault: str, tmp_path: Path) -> None:
    folder = tmp_path / f"dpbench-leases-{os.getuid()}"
    make(folder)
    with pytest.raises(InputError) as refused:
        run_campaign("smoke", tmp_path / "out")
    assert f"{folder}: found {fault}" in str(refused.value)
    assert not (tmp_path / "out").exists()
