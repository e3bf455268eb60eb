"""Deadlines in the records of a closed loop: which steps missed theirs, and how it went on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.arrays import Flags, Floats, Ints
from dpbench.bench.record.schema import ABSENT
from dpbench.bench.run.slow_computer import ComputationalDelay


def late_columns(
    delay: ComputationalDelay, latency_ns: Ints, total_ns: Ints
) -> dict[str, NDArray[Any]]:
    """`late` and, on a slow computer, `latency_ns` of the steps of a loop.

    Parameters
    ----------
    latency_ns : (K,) as the slow computer left them; total_ns : (K,) measured times.
    """
    if not delay.simulated:
        return {"late": total_ns > delay.budget_ns}
    idle = latency_ns < 0
    late = idle | (latency_ns > delay.budget_ns)
    return {"late": late, "latency_ns": np.maximum(latency_ns, ABSENT)}


def longest_streak(flags: Flags) -> int:
    """Longest run of true entries."""
    starts, ends = _runs(flags)
    return int((ends - starts).max()) if len(starts) else 0


def steps_to_recover(bad: Flags, good: Flags) -> int | None:
    """Most steps from the start of a bad run to the next good one; None if none, or never."""
    starts, _ = _runs(bad)
    good_at = np.flatnonzero(good)
    after = np.searchsorted(good_at, starts)
    recovered = after < len(good_at)
    if not len(starts) or not recovered.all():
        return None
    return int((good_at[after] - starts).max())


def _runs(flags: Flags) -> tuple[Ints, Ints]:
    """First entries of the runs of true ones, and the entries after their last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return edges[::2], edges[1::2]


def deadline_metrics(steps: Mapping[str, NDArray[Any]], slowdown: float) -> dict[str, Any]:
    """Misses, streaks and recovery of a loop, in step order; latencies too where it is slow."""
    late, true = steps["late"], steps["true"]
    recovered = steps_to_recover(late, true & ~late)
    total = _there(steps["total_ns"])
    metrics: dict[str, Any] = {
        "deadline_misses": int(late.sum()),
        "longest_miss_streak": longest_streak(late),
        "miss_recover_steps_max": pd.NA if recovered is None else recovered,
        "computations": len(total),
    }
    if slowdown > 0.0:
        latency = _there(steps["latency_ns"])
        # Rounding apart, only a time without that of others is less than what was measured.
        metrics["interrupted"] = int((latency < slowdown * total - 0.5).sum())
        metrics |= {"latency_p50_ns": np.median(latency), "latency_max_ns": latency.max()}
    return metrics


def _there(times_ns: Ints) -> Floats:
    """Those of the times that are not missing."""
    return times_ns[times_ns > ABSENT].astype(np.float64)
