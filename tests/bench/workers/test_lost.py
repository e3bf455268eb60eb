"""Accidents of the harness beside its cells: they are lost or run once more, and blame nobody."""

import errno
import os
import signal
import subprocess
import sys
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any

import pytest

from dpbench import load_results, run_campaign
from dpbench.bench.record.result_folder import read_lost_count_and_remarks
from dpbench.bench.workers import batch, child, scratch
from dpbench.bench.workers.child import KILLED_FORKSERVER
from dpbench.bench.workers.scratch import Scratch
from dpbench.cli.main import main
from tests.bench.deterministic import run_suite, suite_file, suite_toml
from tests.processes import is_running

pytestmark = pytest.mark.slow

STEPS = 8
HEAD: dict[str, Any] = {"solvers": ["quadprog"], "rounds": 1, "warmup_steps": 0}
LOOPS = [{"scenarios": ["paper"], "settings": ["default", "high"], "steps": STEPS}]
REPLAYS = [{"scenario": "paper", "steps": STEPS}]
PLUGIN = Path(__file__).parents[2] / "solvers" / "example_plugin.py"
KILLER = """
import os
import pathlib
import signal
import time

opened = open


def open(policy, options):
    always = options.get("tolerance", 1e-4) <= 1e-6
    marker = pathlib.Path(MARKER)
    if always or not marker.exists():
        marker.write_text(str(os.getpid()))
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(WAIT_S)
    return opened(policy, options)
"""
"""A solver whose process kills what it was forked from: at a tight tolerance always, at a loose one
if nobody did yet."""


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    return suite_file(tmp_path, suite_toml(**HEAD, closed_loop=LOOPS, replay=REPLAYS))


@pytest.mark.parametrize("suffixes", [("judged",), ("judged", "evaluated.json")])
def test_what_goes_away_between_judging_and_keeping_is_lost(
    suffixes: tuple[str, ...], suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, split = tmp_path / "out", batch._ItemProcess.split_items

    def tidied(self: Any) -> Any:
        ended = split(self)
        for suffix in suffixes:
            for path in self.folder.glob(f"*.{suffix}"):
                path.unlink()
        return ended

    with monkeypatch.context() as patch:
        patch.setattr(batch._ItemProcess, "split_items", tidied)
        assert read_lost_count_and_remarks(run_campaign(suite, out, jobs=1))[0] == 3
    runs = load_results(out).runs
    assert set(runs["outcome"]) == {"lost"}
    assert runs["outcome_detail"].str.contains(r"w(?:as|ere) removed").all()
    assert read_lost_count_and_remarks(run_campaign(suite, out))[0] == 0
    assert set(load_results(out).runs["steps_done"]) == {STEPS}


def test_aliases_are_lost_too(suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = run_campaign(suite, tmp_path / "out")
    runs = load_results(out).runs
    assert len(runs) == 3 and set(runs["outcome"]) == {"finished"}
    monkeypatch.setattr(scratch, "count_free_bytes", lambda place: 1000)
    run_campaign(suite, out, fresh=True)
    results = load_results(out)
    assert results.runs["outcome"].tolist() == ["lost"] * 3 and results.steps.empty


def run_with_killer(folder: Path, wait_s: float, *, jobs: int | None = None, **tables: Any) -> Path:
    module = folder / "killing.py"
    killer = KILLER.replace("MARKER", repr(str(folder / "marker")))
    killer = killer.replace("WAIT_S", str(wait_s))
    module.write_text(PLUGIN.read_text(encoding="utf-8") + killer, encoding="utf-8")
    text, solvers = suite_toml(**HEAD, **tables), ["admm", "quadprog"]
    return run_suite(folder, text, solver_module=module, solvers=solvers, jobs=jobs)


def test_cells_whose_template_is_killed_run_once_more(tmp_path: Path) -> None:
    out = run_with_killer(tmp_path, 600.0, jobs=1, closed_loop=LOOPS)
    runs = load_results(out).runs.set_index(["solver", "settings"])
    lost = runs.loc[runs["outcome"] != "finished", ["outcome", "outcome_detail"]]
    died = [KILLED_FORKSERVER.outcome, KILLED_FORKSERVER.detail]
    assert lost.T.to_dict("list") == {("admm", "high"): died}
    assert not is_running(int((tmp_path / "marker").read_text()))


@pytest.mark.alone  # the one template dies while it starts the workers of a group, in real time
def test_replays_whose_template_is_killed_run_once_more(tmp_path: Path) -> None:
    runs = load_results(run_with_killer(tmp_path, 0.0, replay=REPLAYS)).runs
    assert (tmp_path / "marker").exists()
    assert runs["outcome"].tolist() == ["finished"] * 2, runs["outcome_detail"].tolist()
    assert set(runs["steps_done"]) == {STEPS}


def test_without_any_process_the_command_ends_in_one_line(
    suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def none_left(process: object) -> None:
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    command = ["run", str(suite), "--out", str(tmp_path / "out"), "--quiet"]
    with monkeypatch.context() as patch:
        patch.setattr(ForkServerProcess, "start", none_left)
        patch.setattr(child, "STARTS", 2)
        assert main(command) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("dpbench: no process can be started any more") and "kept" in line
    assert main(command) == 0


HOLD = """
import sys, time
from pathlib import Path
from dpbench.temporary_folders import make_temporary_folder_for_block
with make_temporary_folder_for_block(Path(sys.argv[1])) as folder:
    (folder / "log").write_bytes(b"a log")
    print(folder, flush=True)
    time.sleep(600)
"""


def test_places_are_cleared_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        left = Path(holder.stdout.readline().strip())
        os.kill(holder.pid, signal.SIGKILL)
    monkeypatch.setattr(scratch, "MEMORY", tmp_path)
    with Scratch(tmp_path):
        assert not left.exists()
