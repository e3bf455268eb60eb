"""A plug-in that harms what is around it costs its own cells alone, and leaves nothing."""

import signal
import subprocess
import sys
from dataclasses import replace
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Any

import psutil
import pytest

from dpbench import load_results
from dpbench.bench.record.cell import Outcome
from dpbench.bench.workers import child as supervise
from dpbench.bench.workers.child import KILLED_FORKSERVER, Child, start_forkserver
from dpbench.bench.workers.orphans import list_children
from dpbench.bench.workers.shared_status import CUT, OUTPUT_BYTES
from tests.bench.deterministic import run_suite, suite_toml, wait_until
from tests.processes import is_running

HOSTILE = Path(__file__).parents[1] / "hostile_plugin.py"
USUAL: dict[str, Any] = {"cell_memory_gb": 0.3, "rounds": 1, "warmup_steps": 0}
SOLVER = """
import os, signal, subprocess, time
from dpbench.bench.workers.shared_status import Phase, set_phase
set_phase(Phase.SOLVER)
"""
"""The head of a process in which the solver is at work."""
DAEMON = """
if os.fork() == 0:
    os.setsid()
    if (pid := os.fork()) == 0:
        os.execvp("sleep", ["sleep", "600"])
    with open(NUMBER, "w") as file:
        file.write(str(pid))
    os._exit(0)
while not os.path.exists(NUMBER) or not open(NUMBER).read():
    time.sleep(0.01)
"""
"""Leaves a process in a session of its own, whose parent ended."""


@pytest.fixture
def context() -> ForkServerContext:
    return start_forkserver()


def run(tmp_path: Path, *sizes: int) -> dict[tuple[str, int], Outcome]:
    """Run random problems of so many variables; return outcomes by solver and variables."""
    random = {"families": ["no_rows"], "sizes": [[n, 0] for n in sizes], "steps": 3}
    text = suite_toml(solvers=["hostile", "quadprog"], random=[random], **USUAL)
    rows = load_results(run_suite(tmp_path, text, solver_module=HOSTILE)).runs
    assert rows["run_id"].is_unique and len(rows) == 2 * len(sizes)
    assert set(rows.loc[rows["solver"] == "quadprog", "outcome"]) == {"finished"}
    keep = rows[["solver", "sequence", "outcome", "outcome_detail", "process_peak_bytes"]]
    return {
        (solver, int(sequence.split("-n")[1].split("-")[0])): Outcome(
            outcome, detail, peak_bytes=peak
        )
        for solver, sequence, outcome, detail, peak in keep.itertuples(index=False)
    }


@pytest.mark.slow
def test_output_is_cut_and_said(tmp_path: Path) -> None:
    became = run(tmp_path, 7, 20)
    assert (became["hostile", 7].outcome, became["hostile", 7].detail) == ("finished", CUT)
    assert became["hostile", 20].detail == ""


@pytest.mark.slow
def test_a_hog_ends_at_its_limit_with_its_peak(tmp_path: Path) -> None:
    became = run(tmp_path, 6, 20)
    hog, modest = became["hostile", 6], became["hostile", 20]
    assert hog.outcome == "crashed", hog.detail
    assert "MemoryError" in hog.detail
    assert hog.peak_bytes is not None and modest.peak_bytes is not None
    assert modest.peak_bytes + 3e7 < hog.peak_bytes < modest.peak_bytes + 3.5e8


@pytest.mark.slow
def test_who_ends_the_template_is_found_and_pays(tmp_path: Path) -> None:
    became = run(tmp_path, 11, 12, 20)
    for n in (11, 12):
        found = became["hostile", n]
        assert replace(found, peak_bytes=None) == KILLED_FORKSERVER
    assert became["hostile", 20].outcome == "finished"


@pytest.mark.slow
def test_stopping_the_template_costs_nothing(tmp_path: Path) -> None:
    became = run(tmp_path, 13, 14)
    assert {found.outcome for found in became.values()} == {"finished"}


@pytest.mark.slow
@pytest.mark.parametrize("end", ["", "os._exit(0)", "os.abort()", "os.kill(os.getppid(), 9)"])
def test_daemons_end_with_workers(end: str, context: ForkServerContext, tmp_path: Path) -> None:
    number = tmp_path / "number"
    code = SOLVER + f"NUMBER = {str(number)!r}\n" + DAEMON + end
    child = Child(context, exec, (code,), tmp_path, "cell", limit_s=5.0)
    child.join()
    # Where the fork server ended, the keeper ends it, by itself.
    wait_until(lambda: not is_running(int(number.read_text())), "it lives")


@pytest.mark.slow
def test_all_end_with_the_main_program(tmp_path: Path) -> None:
    program = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from dpbench.bench.workers.child import Child, start_forkserver\n"
        "child = Child(start_forkserver(), time.sleep, (600.0,), Path(sys.argv[1]), 'cell',"
        " limit_s=None)\n"
        "print('ready', flush=True)\n"
        "time.sleep(600.0)\n"
    )
    with psutil.Popen(
        [sys.executable, "-c", program, str(tmp_path)],
        stdout=subprocess.PIPE,
    ) as process:
        process.stdout.readline()
        below = process.children(recursive=True)
        assert len(below) >= 3
        process.send_signal(signal.SIGKILL)
    _, alive = psutil.wait_procs(below, timeout=20.0)
    assert not alive


@pytest.mark.slow
def test_a_stopped_worker_is_given_up(
    context: ForkServerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervise, "STOPPED_S", 0.2)
    code = SOLVER + "os.kill(os.getpid(), signal.SIGSTOP)"
    child = Child(context, exec, (code,), tmp_path, "cell", limit_s=None, logs=False)
    wait_until(child.kill_if_overdue, "it is waited for")
    found = child.determine_outcome()
    assert found.outcome == "hung" and "stopped by a signal" in found.detail


@pytest.mark.slow
def test_output_of_children_counts(context: ForkServerContext, tmp_path: Path) -> None:
    code = SOLVER + (
        "subprocess.run(['head', '-c', '9000000', '/dev/zero'], stderr=subprocess.DEVNULL)\n"
        "print('still here', flush=True)\nos._exit(3)"
    )
    child = Child(context, exec, (code,), tmp_path, "cell", limit_s=5.0)
    assert child.determine_outcome().detail.endswith(CUT)
    assert child.notice.output.is_full and OUTPUT_BYTES == 2**20


@pytest.mark.slow
def test_the_keeper_has_one_child(context: ForkServerContext, tmp_path: Path) -> None:
    child = Child(context, exec, (SOLVER + "time.sleep(600.0)",), tmp_path, "cell", limit_s=5.0)
    wait_until(lambda: child.notice.page.forkserver, "it does not begin")
    page = child.notice.page
    assert list_children(page.keeper) == [page.forkserver]
    assert child.process.pid in list_children(page.forkserver)
    child.kill("seen")


MEASURED = """
import os

solved, calls = solve, iter(range(10**6))


def solve(qp):
    # The replay takes 3 steps before its first and two rounds; what comes then is not timed.
    if next(calls) == 3 + 2 * STEPS + 2:
        os._exit(0)
    return solved(qp)


open = opener("hostile", solve)
"""


@pytest.mark.slow
def test_an_exit_in_an_untimed_step_is_a_crash(tmp_path: Path) -> None:
    module, steps = tmp_path / "mine.py", 6
    replay = {"scenario": "paper", "steps": steps}
    suite = suite_toml(solvers=["hostile"], replay=[replay], **USUAL)
    text = HOSTILE.read_text(encoding="utf-8") + MEASURED.replace("STEPS", str(steps))
    module.write_text(text, encoding="utf-8")
    (row,) = load_results(run_suite(tmp_path, suite, solver_module=module)).runs.itertuples()
    assert (row.outcome, row.steps_done) == ("crashed", steps), row.outcome_detail
    assert "exit code 0" in row.outcome_detail


@pytest.mark.slow
def test_what_a_cell_started_ends_before_the_next(tmp_path: Path) -> None:
    running = set(psutil.pids())
    became = run(tmp_path, 8, 9, 20)
    assert {found.outcome for found in became.values()} == {"finished"}
    left = [
        process.pid
        for process in psutil.process_iter(["pid", "cmdline"])
        if process.pid not in running and process.info["cmdline"] == ["sleep", "600"]
    ]
    assert not any(map(is_running, left))
