"""Counts of the kernel around a round, and the rule that calls a machine quiet."""

import hashlib
import math
import os
import threading
import time

import numpy as np
import pytest

from dpbench.bench.record.disturbance import (
    MAX_DISTURBED_SHARE,
    MAX_STEAL_SHARE,
    MAX_SWITCHES_PER_S,
    Disturbance,
    compute_disturbance_metrics,
    read_disturbance_counters,
)
from dpbench.bench.record.raw_log import COUNTERS, PHASES, RawLog, make_replay_layout

# What the kernel counts on a core is to come from the test.
pytestmark = pytest.mark.alone

QUIET = Disturbance(
    rounds=100.0,
    disturbed=100 * MAX_DISTURBED_SHARE,
    rerun=30.0,
    seconds=10.0,
    involuntary=10 * MAX_SWITCHES_PER_S,
    steal_s=10 * MAX_STEAL_SHARE,
    throttled=0.0,
)


def test_a_process_that_waits_switches_of_its_own_will() -> None:
    before = read_disturbance_counters()
    for _ in range(10):
        time.sleep(0.001)
    change = dict(zip(COUNTERS, read_disturbance_counters() - before, strict=True))
    assert change["voluntary_switches"] >= 10
    assert change["replay_s"] >= 0.01


def test_steal_time_is_that_of_the_own_core() -> None:
    allowed = os.sched_getaffinity(0)
    core = max(allowed)
    os.sched_setaffinity(0, {core})
    try:
        with open("/proc/stat", encoding="ascii") as stat:
            (line,) = [text for text in stat if text.startswith(f"cpu{core} ")]
        found = read_disturbance_counters()[COUNTERS.index("steal_s")]
    finally:
        os.sched_setaffinity(0, allowed)
    user, nice, system, idle, iowait, irq, softirq, steal, *_ = map(int, line.split()[1:])
    assert user + nice + system + idle + iowait + irq + softirq > 0
    assert found == pytest.approx(steal / os.sysconf("SC_CLK_TCK"), abs=0.5)


def test_sums_are_over_the_rounds_that_count() -> None:
    log = RawLog.in_memory(make_replay_layout(4, 2, 1, 1))
    log.done[:] = (2, 2, 2, 0)
    log.attempts[:] = (1, 2, 1, 0)
    log.counters[:] = np.arange(1.0, 5.0)[:, None] * [1.0, 10.0, 100.0, 1000.0, np.nan, 1e4]
    found = compute_disturbance_metrics(log)
    assert found["rerun_rounds"] == 1
    assert [found[name] for name in COUNTERS[:4]] == [5.0, 50.0, 500.0, 5000.0]
    assert math.isnan(found["throttle_events"])
    assert found["thread_s"] == 5e4


def test_the_time_of_steps_is_of_the_same_rounds() -> None:
    log = RawLog.in_memory(make_replay_layout(4, 2, 1, 1))
    log.times[:] = -1
    log.done[:] = (2, 2, 2, 1)
    log.counters[:3] = 1.0
    log.counters[3] = np.nan
    log.times[:, :, PHASES.index("solve")] = np.array([[7], [100], [2000], [9]])
    log.times[:, :, PHASES.index("emit")] = 10**6
    assert compute_disturbance_metrics(log)["solve_s"] == pytest.approx(4200e-9)


def test_the_time_of_other_threads_is_theirs_alone() -> None:
    def work() -> None:
        end = time.thread_time() + 0.1
        while time.thread_time() < end:
            hashlib.sha256(bytes(10**6))

    def thread_s() -> float:
        return float(read_disturbance_counters()[COUNTERS.index("thread_s")])

    before = thread_s()
    work()
    alone = thread_s() - before
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert thread_s() - before - alone >= 0.1
    assert alone < 0.05


def test_at_the_limits_a_machine_is_quiet() -> None:
    assert QUIET.complaints() == []


@pytest.mark.parametrize(
    ("field", "value", "word"),
    [
        ("disturbed", 6.0, "6 of 100 rounds disturbed"),
        ("involuntary", 150.0, "context switches"),
        ("steal_s", 0.2, "stolen"),
        ("throttled", 1.0, "throttle"),
    ],
)
def test_each_disturbance_is_named(field: str, value: float, word: str) -> None:
    (complaint,) = Disturbance(**{**vars(QUIET), field: value}).complaints()
    assert word in complaint


def test_a_total_is_a_sum_and_what_nobody_saw_stays_unknown() -> None:
    blind = Disturbance(**{**vars(QUIET), "throttled": math.nan, "steal_s": math.nan})
    both = Disturbance.from_parts([blind, QUIET])
    assert (both.rounds, both.seconds, both.throttled) == (200.0, 20.0, 0.0)
    hidden = Disturbance.from_parts([blind, blind])
    assert math.isnan(hidden.throttled) and math.isnan(hidden.steal_share)
    assert hidden.complaints() == []
    assert Disturbance.from_parts([]).complaints() == []
