"""The state of the machine while a benchmark ran, stored beside its times."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from typing import Any, Protocol

import numpy as np

from dpbench.bench.judge.rules import mask_disturbed_rounds
from dpbench.bench.record.disturbance import (
    MAX_SWITCHES_PER_S,
    Disturbance,
    read_disturbance_counters,
)
from dpbench.bench.run.replay import time_speed_and_load_tests

LEAST_WINDOW_S = 1.0
"""Time below which counters are too coarse for a rate: a tick of stolen time is 10 ms."""
LEAST_PROCESSOR_SHARE = 0.95
"""Least share of the wall time that a process computes, unless it gives up the processor itself."""
KEY = "machine"
"""Key of the state in `extra_info`."""


class HasInfo(Protocol):
    """Part of the fixture `benchmark` of pytest-benchmark, an extra, that is used here."""

    extra_info: dict[str, Any]


@dataclass(frozen=True)
class MachineState:
    """Counters over one benchmark, and the reference kernel before and after it [ns]."""

    wall_s: float
    processor_s: float
    voluntary_switches: float
    involuntary_switches: float
    steal_s: float
    throttle_events: float
    kernel_before_ns: float
    kernel_after_ns: float

    @classmethod
    def from_stored_state(cls, stored: Mapping[str, Any]) -> "MachineState":
        """Return a stored machine state, hidden counters NaN; TypeError or ValueError if bad."""
        return cls(*(float(stored.get(one.name, np.nan)) for one in fields(cls)))

    def complaints(self) -> list[str]:
        """Return, in words, which limits of a quiet machine were exceeded."""
        counted = Disturbance(
            rounds=0.0,
            disturbed=0.0,
            rerun=0.0,
            seconds=max(self.wall_s, LEAST_WINDOW_S),
            involuntary=self.involuntary_switches,
            steal_s=self.steal_s,
            throttled=self.throttle_events,
        )
        lines = counted.complaints()
        share = self.processor_s / self.wall_s
        if share < LEAST_PROCESSOR_SHARE and not self.waits_itself:
            lines.append(f"a processor for only {100 * share:.0f} % of the time")
        kernels = np.array([[self.kernel_before_ns, self.kernel_after_ns]])
        if mask_disturbed_rounds(kernels)[0]:
            slower = kernels.max() / kernels.min()
            lines.append(f"a reference kernel {slower:.2f} times as slow at one end")
        return lines

    @property
    def waits_itself(self) -> bool:
        """True if the process often gives up the processor itself: it sleeps or waits."""
        return self.voluntary_switches > MAX_SWITCHES_PER_S * self.wall_s


@contextmanager
def watch_machine(benchmark: HasInfo) -> Iterator[None]:
    """Store the machine's state over the block, and its kernel's time [ns], in a benchmark."""
    time_speed_and_load_tests(time.perf_counter_ns)
    kernel_before_ns = time_speed_and_load_tests(time.perf_counter_ns)
    counters, processor_s = read_disturbance_counters(), time.process_time()
    yield
    processor_s = time.process_time() - processor_s
    wall_s, voluntary, involuntary, steal_s, throttled, _ = read_disturbance_counters() - counters
    kernel_after_ns = time_speed_and_load_tests(time.perf_counter_ns)
    state = MachineState(
        *(float(wall_s), processor_s, float(voluntary), float(involuntary)),
        *(float(steal_s), float(throttled), float(kernel_before_ns), float(kernel_after_ns)),
    )
    # JSON has no NaN.
    known = {name: value for name, value in asdict(state).items() if np.isfinite(value)}
    benchmark.extra_info[KEY] = known
    benchmark.extra_info["reference_ns"] = min(kernel_before_ns, kernel_after_ns)
