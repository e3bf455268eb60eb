"""A cell's process that crashes, hangs or never starts becomes an outcome."""

import os
import time
from multiprocessing.context import ForkServerContext
from multiprocessing.popen_forkserver import Popen
from pathlib import Path

import numba
import numpy as np
import pytest

from dpbench.bench.record.cell import Outcome
from dpbench.bench.record.raw_log import RawLog, make_replay_layout
from dpbench.bench.workers import child as supervise
from dpbench.bench.workers.child import (
    FORKSERVER_DIED,
    Child,
    has_compiled_kernels,
    start_forkserver,
)
from dpbench.bench.workers.worker import write_outcome
from tests.bench.deterministic import wait_until
from tests.processes import is_running

# Limits of a second and less, which what else runs could use up.
pytestmark = pytest.mark.alone


@pytest.fixture(scope="module")
def context() -> ForkServerContext:
    return start_forkserver()


def wait(child: Child) -> None:
    wait_until(lambda: not child.process.is_alive() or child.kill_if_overdue(), "it was not ended")


SOLVER = """
import os, signal, time
from dpbench.bench.workers.shared_status import Phase, set_phase
set_phase(Phase.SOLVER)
"""
"""The head of a process in which the solver is at work; without it the harness is."""
HARNESS = "import os, signal, time\n"


def ended(context: ForkServerContext, folder: Path, code: str) -> tuple[str, str]:
    child = Child(context, exec, (code,), folder, "cell", limit_s=5.0)
    wait(child)
    found = child.determine_outcome()
    return found.outcome, found.detail


@pytest.mark.parametrize(
    ("act", "words"),
    [
        ("signal.raise_signal(signal.SIGSEGV)", "killed by SIGSEGV"),
        ("os._exit(0)", "its process left with exit code 0: no output"),
        ("os._exit(3)", "its process left with exit code 3: no output"),
        ("raise SystemExit(0)", "SystemExit(0)"),
        ("raise KeyboardInterrupt", "KeyboardInterrupt:"),
    ],
)
def test_who_ended_it(act: str, words: str, context: ForkServerContext, tmp_path: Path) -> None:
    assert ended(context, tmp_path, SOLVER + act) == ("crashed", words)
    assert ended(context, tmp_path, HARNESS + act) == ("lost", words)


def test_errors_of_the_harness_are_lost(context: ForkServerContext, tmp_path: Path) -> None:
    raises = "raise OSError(28, 'No space left on device')"
    said = "OSError: [Errno 28] No space left on device"
    assert ended(context, tmp_path, SOLVER + raises) == ("lost", said)
    through = (
        "from types import SimpleNamespace as N\n"
        "from dpbench.bench.run.timed_solver import TimedSolver\n"
        "def setup(qp): raise ValueError('bad matrix')\n"
        "work = N(setup_every_step=False, setup=setup)\n"
        "import numpy as np\n"
        "from dpbench.qp.program import QuadraticProgram\n"
        "one = np.ones(1)\n"
        "base = QuadraticProgram(np.eye(1), one, np.eye(1), -one, one, -one, one)\n"
        "TimedSolver(work, N(step=None, base=base), time.perf_counter_ns).prepare()"
    )
    assert ended(context, tmp_path, SOLVER + through) == ("crashed", "ValueError: bad matrix")


@pytest.mark.parametrize(("size", "outcome"), [(None, "crashed"), (64, "lost")])
def test_a_log_that_lost_its_room_is_no_crash_of_the_solver(
    size: int | None, outcome: str, context: ForkServerContext, tmp_path: Path
) -> None:
    raw = tmp_path / "cell.raw"
    RawLog.create(raw, make_replay_layout(1, 4, 2, 2))
    if size is not None:
        os.truncate(raw, size)
    assert ended(context, tmp_path, SOLVER + "signal.raise_signal(signal.SIGBUS)")[0] == outcome


def test_a_removed_scratch_folder_is_lost(context: ForkServerContext, tmp_path: Path) -> None:
    folder = tmp_path / "scratch"
    outcome, detail = ended(
        context, folder, f"import shutil; shutil.rmtree({str(folder)!r}); raise SystemExit"
    )
    assert outcome == "lost" and str(folder) in detail


def test_a_hanging_call_is_killed_and_its_steps_stay(
    context: ForkServerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervise, "GRACE_S", 0.1)
    log = RawLog.create(tmp_path / "cell.raw", make_replay_layout(1, 4, 2, 2))
    log.z[0, 0] = [1.0, 2.0]
    log.done[0] = 1
    log.started[0] = 1
    code = SOLVER + "time.sleep(600.0)"
    child = Child(context, exec, (code,), tmp_path, "cell", limit_s=0.2)
    wait(child)
    assert child.determine_outcome().outcome == "hung"
    assert "limit of 0.2 s" in child.determine_outcome().detail
    np.testing.assert_array_equal(RawLog.open(tmp_path / "cell.raw").z[0, 0], [1.0, 2.0])


def test_a_wait_for_the_core_is_no_run_time(
    context: ForkServerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervise, "GRACE_S", 0.1)
    RawLog.create(tmp_path / "cell.raw", make_replay_layout(1, 4, 2, 2)).started[0] = 1
    child = Child(context, exec, (SOLVER + "time.sleep(600.0)",), tmp_path, "cell", limit_s=0.2)
    monkeypatch.setattr(supervise, "read_process_wait_s", lambda process: 600.0)
    assert not child.kill_if_overdue()
    time.sleep(0.5)
    assert not child.kill_if_overdue()
    monkeypatch.setattr(supervise, "read_process_wait_s", lambda process: 0.0)
    assert child.kill_if_overdue()
    assert child.determine_outcome().outcome in ("hung", "lost")


@pytest.mark.parametrize(("head", "outcome"), [(SOLVER, "hung"), (HARNESS, "lost")])
def test_a_process_that_never_starts_its_loop_is_killed(
    head: str,
    outcome: str,
    context: ForkServerContext,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(supervise, "START_ALLOWANCE_S", 2.0)
    child = Child(context, exec, (head + "time.sleep(600.0)",), tmp_path, "cell", limit_s=5.0)
    wait(child)
    assert child.determine_outcome().outcome == outcome
    assert "did not start" in child.determine_outcome().detail


def test_a_killed_process_keeps_its_verdict(context: ForkServerContext, tmp_path: Path) -> None:
    child = Child(context, time.sleep, (600.0,), tmp_path, "cell", limit_s=5.0)
    assert not child.has_verdict
    write_outcome(tmp_path / "cell.json", Outcome("finished", ""))
    child.kill("" if child.has_verdict else "no verdict")
    assert child.determine_outcome().outcome == "finished"


def test_template_pins_threads(context: ForkServerContext, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    start_forkserver()
    assert os.environ["OMP_NUM_THREADS"] == "7"


def test_a_template_that_is_killed_is_no_solver(
    context: ForkServerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = SOLVER + "os.kill(os.getppid(), signal.SIGKILL)\ntime.sleep(600.0)"
    child = Child(context, exec, (code,), tmp_path, "cell", limit_s=5.0)
    wait(child)
    assert child.determine_outcome() == FORKSERVER_DIED and child.forkserver_died
    assert child.process.pid is not None and not is_running(child.process.pid)
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    left = "its process left with exit code 255: no output"
    code = SOLVER + "os._exit(255 if os.environ['OMP_NUM_THREADS'] == '1' else 1)"
    assert ended(context, tmp_path, code) == ("crashed", left)


def has_come(file: Path, child: Child) -> bool:
    """True once a process has left its number in a file."""
    return file.exists() and str(child.process.pid) in file.read_text().split()


@pytest.mark.parametrize("wait_s", [0.0, 1.0])
def test_of_two_processes_of_one_start_one_lives(
    context: ForkServerContext, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wait_s: float
) -> None:
    launch, begun = Popen._launch, list[int]()

    def launched(self: Popen, process: object) -> None:
        launch(self, process)
        if not begun:
            begun.append(self.pid)
            time.sleep(wait_s)
            raise EOFError

    monkeypatch.setattr(Popen, "_launch", launched)
    file = tmp_path / "came"
    code = f"import os, time\nopen({str(file)!r}, 'a').write(f'{{os.getpid()}} ')\ntime.sleep(60)"
    child = Child(context, exec, (code,), tmp_path, "cell", limit_s=5.0, logs=False)
    wait_until(lambda: not is_running(begun[0]) and has_come(file, child), "two are at work")
    came = [int(pid) for pid in file.read_text().split()]
    assert came[-1] == child.process.pid
    # At once it may be on either side of its beginning.
    assert came[:-1] in ([[begun[0]]] if wait_s else [[], [begun[0]]])
    child.kill("seen")


def test_an_empty_cache_is_recognised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    assert not has_compiled_kernels()
    (tmp_path / "kernel").mkdir()
    (tmp_path / "kernel" / "replay._reference_kernel-26.py311.nbi").touch()
    assert has_compiled_kernels()
