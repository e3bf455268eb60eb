"""Waits of a thread for its core."""

import os
import subprocess
import sys
import threading
import time
from typing import Any

import pytest

from dpbench.bench.run.timed_solver import RunDelay, RunLimit, get_run_delay, read_process_wait_s


def _work_ms(ms: float) -> None:
    until = time.thread_time_ns() + round(1e6 * ms)
    while time.thread_time_ns() < until:
        pass


@pytest.fixture
def one_core() -> Any:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    yield
    os.sched_setaffinity(0, before)


@pytest.mark.slow
def test_a_shared_core_is_waited_for(one_core: None) -> None:
    """Beside an endless loop, 100 ms of work wait for some 100 ms, and for no more than passed."""
    other = subprocess.Popen(
        [sys.executable, "-c", "print(flush=True)\nwhile True: pass"], stdout=subprocess.PIPE
    )
    try:
        assert other.stdout is not None and other.stdout.readline() == b"\n"
        delay, began_ns, used_ns = RunDelay(), time.perf_counter_ns(), time.thread_time_ns()
        _work_ms(100.0)
        waited_ns = delay.read_wait_since_last_call_ns()
        passed_ns = time.perf_counter_ns() - began_ns
        used_ns = time.thread_time_ns() - used_ns
    finally:
        other.kill()
        other.communicate()
    assert waited_ns > 10e6
    # What passed was work or wait, but for what lies between the readings.
    assert waited_ns == pytest.approx(passed_ns - used_ns, abs=0.2 * passed_ns)


def test_sleep_is_no_wait_for_the_core() -> None:
    delay = RunDelay()
    waits_ms = []
    for _ in range(5):
        delay.read_wait_since_last_call_ns()
        time.sleep(0.02)
        waits_ms.append(1e-6 * delay.read_wait_since_last_call_ns())
    assert 0.0 <= min(waits_ms) < 10.0


def test_a_thread_has_its_own() -> None:
    others: list[RunDelay] = []
    thread = threading.Thread(target=lambda: others.append(get_run_delay()))
    thread.start()
    thread.join()
    assert get_run_delay() is get_run_delay()
    assert others[0] is not get_run_delay()


def test_where_the_kernel_does_not_show_it_it_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(path: str, flags: int) -> int:
        raise FileNotFoundError(path)

    monkeypatch.setattr(os, "open", missing)
    assert RunDelay().read_wait_since_last_call_ns() == -1
    monkeypatch.undo()
    delay = RunDelay()
    monkeypatch.setattr(os, "pread", lambda file, size, at: b"12")
    assert delay.read_wait_since_last_call_ns() == -1
    monkeypatch.undo()
    assert delay.read_wait_since_last_call_ns() == -1


def test_waits_for_the_core_use_up_no_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit of 100 lasts until 190 where 90 on the clock were waits."""
    waited = iter((1000, 1090, 1090, 1090))
    monkeypatch.setattr(RunDelay, "read_total_ns", lambda self: next(waited))
    limit = RunLimit(0, 100)
    assert not limit.is_exceeded(100)
    assert not limit.is_exceeded(150)
    assert not limit.is_exceeded(190)
    assert limit.is_exceeded(191)
    assert limit.spent_ns(200) == 110


def test_hidden_waits_leave_the_limit_to_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RunDelay, "read_total_ns", lambda self: -1)
    limit = RunLimit(1000, 100)
    assert not limit.is_exceeded(1100)
    assert limit.is_exceeded(1101)


@pytest.mark.slow
def test_the_waits_of_a_process_are_read_from_outside(one_core: None) -> None:
    """Two endless loops on one core wait for each other about half of the time."""
    loop = [sys.executable, "-c", "while True: pass"]
    both = [subprocess.Popen(loop) for _ in range(2)]
    try:
        time.sleep(1.0)
        waited_s = [read_process_wait_s(one.pid) for one in both]
    finally:
        for one in both:
            one.kill()
            one.wait()
    assert min(waited_s) > 0.05
    assert read_process_wait_s(both[0].pid) == 0.0
