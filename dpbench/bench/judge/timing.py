"""Columns of `runs.parquet` on step times and deadlines, from the steps of one cell."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.arrays import Flags, Floats, Ints
from dpbench.bench.judge.evaluation import SECOND_QP_PREFIX, Columns, EvaluatedCell
from dpbench.bench.judge.rules import (
    WARM_UP,
    mask_disturbed_rounds,
    median_of_known,
    percentile_or_nan,
)
from dpbench.bench.record.cell import Cell, HardestSource, QPSource
from dpbench.bench.record.schema import MISSING_INT
from dpbench.bench.run.slow_computer import ComputationalDelay

Steps = Mapping[str, NDArray[Any]]


def compute_timing_percentiles(
    cell: Cell, evaluated: EvaluatedCell, counting: Steps
) -> dict[str, Any]:
    """Return percentiles of a run's step times, of all samples and of each step's best round."""
    columns = evaluated.columns
    once = int(columns["setup_once_ns"][0])
    second = f"{SECOND_QP_PREFIX}setup_once_ns"
    if once > 0 and second in columns:
        once += int(columns[second][0])
    raw = counting["total_ns"].astype(np.float64)
    timing: dict[str, Any] = {
        "setup_once_ns": once if once > 0 else np.nan,
        "matrix_updates": int(evaluated.columns["matrix_updates"].max()),
        "raw_p50_ns": percentile_or_nan(raw, 50),
        "raw_p90_ns": percentile_or_nan(raw, 90),
        "raw_p99_ns": percentile_or_nan(raw, 99),
        "raw_p999_ns": percentile_or_nan(raw, 99.9),
        "raw_max_ns": raw.max(),
        "raw_samples": len(raw),
    }
    if cell.mode == "closed_loop":
        timing["solve_s"] = 1e-9 * float((raw - np.maximum(counting["waited_ns"], 0)).sum())
        for phase in ("emit", "overhead"):
            times_ns = counting[f"{phase}_ns"]
            timing[f"{phase}_p50_ns"] = median_of_known(times_ns[times_ns > MISSING_INT])
        return timing | _compute_cascade_percentiles(counting)
    rounds, by_round = _rounds_and_values_by_round(counting, raw)
    best = np.nanmin(by_round, axis=0)
    return timing | {
        "rounds": len(rounds),
        # The warm-up is never run again and never counts, so it is not counted as disturbed.
        "disturbed_rounds": int((find_disturbed_rounds(evaluated.columns) != WARM_UP).sum()),
        "counting_disturbed": len(np.unique(counting["repeat"][counting["disturbed"]])),
        "reference_kernel_ns": median_reference_kernel_ns(evaluated.columns),
        "load_kernel_ns": average_load_test_ns(evaluated.columns, rounds),
        "algo_p50_ns": percentile_or_nan(best, 50),
        "algo_p95_ns": percentile_or_nan(best, 95),
        "algo_p99_ns": percentile_or_nan(best, 99),
        "algo_max_ns": best.max(),
        "window_p99_ns": window_p99_ns(best, cell.source),
        "algo_median_p50_ns": percentile_or_nan(np.nanmedian(by_round, axis=0), 50),
    }


def window_p99_ns(best_ns: Floats, source: QPSource) -> float:
    """Return the step time that one in a hundred steps of a window's stretch exceed; else NaN.

    best_ns : of each step of the window the time of its fastest round.
    """
    if not isinstance(source, HardestSource):
        return float(np.nan)
    slower = min(source.of // 100, len(best_ns) - 1)
    return float(np.sort(best_ns)[-1 - slower])


def _rounds_and_values_by_round(
    counting: Steps, values: Floats
) -> tuple[NDArray[np.int32], Floats]:
    """Return the replay rounds (R,), and values by round and step (R, K), NaN if missing."""
    rounds, row = np.unique(counting["repeat"], return_inverse=True)
    steps, column = np.unique(counting["k"], return_inverse=True)
    by_round = np.full((len(rounds), len(steps)), np.nan)
    by_round[row, column] = values
    return rounds, by_round


def _compute_cascade_percentiles(counting: Steps) -> dict[str, float]:
    """Return percentiles of a cascade's control and thrust-allocation QP times; else none."""
    if "allocation_ns" not in counting:
        return {}
    second = counting["allocation_ns"].astype(np.float64)
    parts = {"controller": counting["total_ns"] - second, "allocation": second}
    return {
        f"{name}_p{percent}_ns": percentile_or_nan(times, percent)
        for name, times in parts.items()
        for percent in (50, 90, 99)
    }


def median_reference_kernel_ns(columns: Columns) -> float:
    """Return the machine-speed test's time [ns]: the better of each round, median over rounds."""
    kernel_ns = columns["reference_kernel_ns"].astype(np.float64)
    best = np.where(kernel_ns > 0, kernel_ns, np.inf).min(axis=1)
    return median_of_known(best[np.isfinite(best)])


def average_load_test_ns(columns: Columns, counting: NDArray[np.int32]) -> float:
    """Return the machine-load test's time [ns]: least over rounds, then geometric mean."""
    rounds = np.unique(columns["repeat"])
    passes = columns["load_kernel_ns"].astype(np.float64)[np.isin(rounds, counting)]
    passes = np.where(passes > 0, passes, np.nan)
    whole = passes[np.isfinite(passes).all(axis=(1, 2))]
    return float(np.exp(np.log(whole.min(axis=0)).mean())) if len(whole) else float(np.nan)


def find_disturbed_rounds(columns: Columns) -> NDArray[np.int32]:
    """Return the rounds of a replay in which the machine-speed test ran too slowly."""
    rounds: NDArray[np.int32] = np.unique(columns["repeat"]).astype(np.int32)
    return rounds[mask_disturbed_rounds(columns["reference_kernel_ns"].astype(np.float64))]


def make_deadline_columns(
    delay: ComputationalDelay, latency_ns: Ints, total_ns: Ints
) -> dict[str, NDArray[Any]]:
    """Return whether each step (K,) of a loop missed its deadline, and simulated latency [ns]."""
    if not delay.is_simulated:
        return {"late": total_ns > delay.budget_ns}
    idle = latency_ns < 0
    late = idle | (latency_ns > delay.budget_ns)
    return {"late": late, "latency_ns": np.maximum(latency_ns, MISSING_INT)}


def length_of_longest_streak(flags: Flags) -> int:
    """Return the length of the longest streak of true entries."""
    starts, ends = _find_streak_starts_and_ends(flags)
    return int((ends - starts).max()) if len(starts) else 0


def count_steps_to_recover(bad: Flags, good: Flags) -> int | None:
    """Return the most steps from the start of a bad streak to a good step; None if never."""
    starts, _ = _find_streak_starts_and_ends(bad)
    good_at = np.flatnonzero(good)
    after = np.searchsorted(good_at, starts)
    recovered = after < len(good_at)
    if not len(starts) or not recovered.all():
        return None
    return int((good_at[after] - starts).max())


def _find_streak_starts_and_ends(flags: Flags) -> tuple[Ints, Ints]:
    """Return the first index of each streak of true entries, and the index after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return edges[::2], edges[1::2]


def compute_deadline_metrics(steps: Mapping[str, NDArray[Any]], slowdown: float) -> dict[str, Any]:
    """Return a closed loop's deadline misses, their longest streak, recovery and latencies."""
    late, true = steps["late"], steps["true"]
    recovered = count_steps_to_recover(late, true & ~late)
    total = _drop_missing_times(steps["total_ns"])
    metrics: dict[str, Any] = {
        "deadline_misses": int(late.sum()),
        "longest_miss_streak": length_of_longest_streak(late),
        "miss_recover_steps_max": pd.NA if recovered is None else recovered,
        "computations": len(total),
    }
    if slowdown > 0.0:
        latency = _drop_missing_times(steps["latency_ns"])
        # Rounding apart, only a time without that of others is less than what was measured.
        metrics["interrupted"] = int((latency < slowdown * total - 0.5).sum())
        metrics |= {"latency_p50_ns": np.median(latency), "latency_max_ns": latency.max()}
    return metrics


def _drop_missing_times(times_ns: Ints) -> Floats:
    """Return the times [ns] that were measured, as floats."""
    return times_ns[times_ns > MISSING_INT].astype(np.float64)
