"""Disturbances of a replay: kernel counters around every round.

They are read outside of the timed phases. A hidden counter is NaN; a steal time of 0 may also mean
that the host of a virtual machine hides it.
"""

import os
import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from dpbench.arrays import Floats
from dpbench.bench.record.raw_log import COUNTERS, RawLog, sum_phases_by_step_ns

_STEAL = 8
"""Place of the steal time in a line of /proc/stat (proc(5)), behind the name of the core."""
_THROTTLE = ("core_throttle_count", "package_throttle_count")

MAX_DISTURBED_SHARE = 0.05
"""Largest share of the rounds that may still be disturbed after they were run again."""
MAX_STEAL_SHARE = 0.01
"""Largest share of the time of the replays that may be stolen."""
MAX_SWITCHES_PER_S = 10.0
"""Largest rate of switches [1/s]: at it fewer than one in a hundred samples of 1 ms is hit, so a
p99 is still a solver's; of shorter samples fewer are."""
QUIET_RULE = (
    f"{100 * MAX_DISTURBED_SHARE:g} % of rounds disturbed after a repeat, "
    f"{100 * MAX_STEAL_SHARE:g} % of replay time stolen by the host, {MAX_SWITCHES_PER_S:g} "
    "involuntary context switches per second, no throttling"
)


def read_disturbance_counters() -> Floats:
    """Read the counters (6,) of `COUNTERS`, counted so far, of this process and its core.

    Steal time [s] and throttle events are means over its cores, where there are several; thread
    time [s] is that of all threads but the calling one.
    """
    used = resource.getrusage(resource.RUSAGE_SELF)
    # Both by the precise clock of the scheduler, the process last: an idle one adds nothing to it.
    alone_ns, all_ns = time.thread_time_ns(), time.process_time_ns()
    cores = os.sched_getaffinity(0)
    return np.array(
        [
            time.perf_counter(),
            used.ru_nvcsw,
            used.ru_nivcsw,
            _read_mean_steal_time_s(cores),
            _average_throttle_events(cores),
            1e-9 * (all_ns - alone_ns),
        ]
    )


def _read_mean_steal_time_s(cores: set[int]) -> float:
    """Return the mean time [s] a virtual machine's host took from some cores; NaN if hidden."""
    try:
        lines = Path("/proc/stat").read_text(encoding="ascii").splitlines()
        of_core = {fields[0]: fields for fields in map(str.split, lines) if fields}
        ticks = [int(of_core[f"cpu{core}"][_STEAL]) for core in cores]
    except (OSError, KeyError, IndexError, ValueError):
        return float("nan")
    return sum(ticks) / len(ticks) / os.sysconf("SC_CLK_TCK")


def _average_throttle_events(cores: set[int]) -> float:
    """Return the thermal throttle events of some cores, averaged; NaN where hidden."""
    seen = []
    for core in cores:
        for name in _THROTTLE:
            path = Path(f"/sys/devices/system/cpu/cpu{core}/thermal_throttle/{name}")
            try:
                seen.append(int(path.read_text(encoding="ascii")))
            except (OSError, ValueError):
                continue
    return sum(seen) / len(cores) if seen else float("nan")


def compute_disturbance_metrics(log: RawLog) -> dict[str, float]:
    """Return a replay's context switches, time taken by the host, throttling, in counted rounds.

    Of repeated rounds the last attempt counts. `solve_s` is the time of the steps of these rounds,
    less what they waited for the core.
    """
    whole = np.flatnonzero(log.done[1:] > 0) + 1
    metrics = {"rerun_rounds": float((log.attempts[whole] > 1).sum())}
    measured = [r for r in whole if np.isfinite(log.counters[r, 0])]
    sums = log.counters[measured].sum(axis=0) if measured else np.full(len(COUNTERS), np.nan)
    own_ns = sum_phases_by_step_ns(log.times[measured]) - np.maximum(log.waited_ns[measured], 0)
    metrics["solve_s"] = 1e-9 * float(own_ns.sum()) if measured else np.nan
    return metrics | dict(zip(COUNTERS, sums.tolist(), strict=True))


@dataclass(frozen=True)
class Disturbance:
    """Measures of what disturbed replays: slow rounds, context switches, time the host took.

    Of the `rounds` that count, `disturbed` ones still are and `rerun` ones were repeated; `steal_s`
    of their `seconds` was taken by the host.
    """

    rounds: float
    disturbed: float
    rerun: float
    seconds: float
    involuntary: float
    steal_s: float
    throttled: float

    @classmethod
    def from_parts(cls, parts: "Sequence[Disturbance]") -> "Disturbance":
        """Return the disturbances summed over several replays; a sum unknown in all is NaN."""
        rows = np.array([list(vars(part).values()) for part in parts]).reshape(-1, len(fields(cls)))
        seen = np.isfinite(rows).any(axis=0)
        return cls(*np.where(seen, np.nansum(rows, axis=0), np.nan).tolist())

    @property
    def steal_share(self) -> float:
        """Share of the replays' time that the host of a virtual machine took."""
        return self.steal_s / (self.seconds or np.nan)

    @property
    def switches_per_s(self) -> float:
        """Involuntary context switches per second of the replays."""
        return self.involuntary / (self.seconds or np.nan)

    def complaints(self) -> list[str]:
        """Return, in words, which limits of a quiet machine the disturbances exceeded."""
        return list(self.find_excesses().values())

    def find_excesses(self) -> dict[str, str]:
        """Return the limits of a quiet machine that are exceeded, each with the excess in words."""
        lines = {}
        if self.rounds > 0 and self.disturbed > MAX_DISTURBED_SHARE * self.rounds:
            lines[f"{100 * MAX_DISTURBED_SHARE:g} % disturbed rounds"] = (
                f"{self.disturbed:.0f} of {self.rounds:.0f} rounds disturbed after a repeat"
            )
        if self.steal_share > MAX_STEAL_SHARE:
            lines[f"{100 * MAX_STEAL_SHARE:g} % stolen time"] = (
                f"{100 * self.steal_share:.1f} % of the time stolen by the host"
            )
        if self.switches_per_s > MAX_SWITCHES_PER_S:
            lines[f"{MAX_SWITCHES_PER_S:g} involuntary context switches per second"] = (
                f"{self.switches_per_s:.0f} involuntary context switches per second"
            )
        if self.throttled > 0:
            lines["0 throttle events"] = f"{self.throttled:.0f} throttle events"
        return lines
