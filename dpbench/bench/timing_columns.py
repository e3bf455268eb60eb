"""The columns of `runs.parquet` on step times, from the judged steps of one cell."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.bench.cell import Cell
from dpbench.bench.grade import Columns, Graded
from dpbench.bench.replay import SPOILT_FACTOR


def timing_metrics(cell: Cell, graded: Graded, counting: pd.DataFrame) -> dict[str, Any]:
    """Step times over the steps that count; percentiles where the samples support them."""
    once = int(graded.columns["setup_once_ns"][0])
    raw = counting["total_ns"].to_numpy(dtype=np.float64)
    timing: dict[str, Any] = {
        "setup_once_ns": once if once > 0 else np.nan,
        "matrix_updates": int(graded.columns["matrix_updates"].max()),
        "raw_p50_ns": _percentile(raw, 50),
        "raw_p99_ns": _percentile(raw, 99),
        "raw_p999_ns": _percentile(raw, 99.9),
        "raw_max_ns": raw.max(),
        "raw_samples": len(raw),
    }
    if cell.mode == "closed_loop":
        for phase in ("emit", "overhead"):
            timing[f"{phase}_p50_ns"] = float(counting[f"{phase}_ns"].median())
        return timing
    per_step = pd.Series(raw).groupby(counting["k"].to_numpy())
    best = per_step.min().to_numpy()
    spoilt = spoilt_rounds(graded.columns)
    return timing | {
        "rounds": int(counting["repeat"].nunique()),
        # The warm-up is never run again and never counts, so it is not said to be spoilt either.
        "spoilt_rounds": int((spoilt > 0).sum()),
        "probe_ns": probe_median(graded.columns),
        "algo_p50_ns": _percentile(best, 50),
        "algo_p95_ns": _percentile(best, 95),
        "algo_p99_ns": _percentile(best, 99),
        "algo_max_ns": best.max(),
        "algo_median_p50_ns": _percentile(per_step.median().to_numpy(), 50),
    }


def probe_median(columns: Columns) -> float:
    """Median over rounds of the reference kernel, the better of its timings around a round [ns]."""
    probes = columns["probe_ns"].astype(np.float64)
    best = np.where(probes > 0, probes, np.inf).min(axis=1)
    known = best[np.isfinite(best)]
    return float(np.median(known)) if len(known) else np.nan


def _percentile(values: NDArray[np.float64], percent: float) -> float:
    """The percentile, or NaN with fewer than ten samples beyond it (method.md section 2)."""
    if len(values) * (100 - percent) / 100 < 10 - 1e-9:
        return np.nan
    return float(np.percentile(values, percent))


def spoilt_rounds(columns: Columns) -> NDArray[np.int32]:
    """Round numbers in which the reference kernel was slowed by more than `SPOILT_FACTOR`."""
    probes = columns["probe_ns"].astype(np.float64)
    seen = np.where(probes > 0, probes, np.nan)
    if not np.isfinite(seen).any():
        return np.empty(0, dtype=np.int32)
    worst = np.nanmax(np.where(np.isnan(seen), -np.inf, seen), axis=1)
    rounds: NDArray[np.int32] = np.unique(columns["repeat"]).astype(np.int32)
    slowed: NDArray[np.int32] = rounds[worst > SPOILT_FACTOR * np.nanmin(seen)]
    return slowed
