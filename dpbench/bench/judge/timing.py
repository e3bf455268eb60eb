"""The columns of `runs.parquet` on step times, from the judged steps of one cell."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.bench.judge.closed_loop import Columns, Graded
from dpbench.bench.judge.rules import WARM_UP, percentile, spoilt_rounds
from dpbench.bench.record.cell import Cell


def timing_metrics(cell: Cell, graded: Graded, counting: pd.DataFrame) -> dict[str, Any]:
    """Step times over the steps that count; percentiles where the samples support them."""
    once = int(graded.columns["setup_once_ns"][0])
    raw = counting["total_ns"].to_numpy(dtype=np.float64)
    timing: dict[str, Any] = {
        "setup_once_ns": once if once > 0 else np.nan,
        "matrix_updates": int(graded.columns["matrix_updates"].max()),
        "raw_p50_ns": percentile(raw, 50),
        "raw_p99_ns": percentile(raw, 99),
        "raw_p999_ns": percentile(raw, 99.9),
        "raw_max_ns": raw.max(),
        "raw_samples": len(raw),
    }
    if cell.mode == "closed_loop":
        for phase in ("emit", "overhead"):
            timing[f"{phase}_p50_ns"] = float(counting[f"{phase}_ns"].median())
        return timing
    per_step = pd.Series(raw).groupby(counting["k"].to_numpy())
    best = per_step.min().to_numpy()
    return timing | {
        "rounds": int(counting["repeat"].nunique()),
        # The warm-up is never run again and never counts, so it is not said to be spoilt either.
        "spoilt_rounds": int((spoilt_rounds_of(graded.columns) != WARM_UP).sum()),
        "counting_spoilt": int(counting.loc[counting["spoilt"], "repeat"].nunique()),
        "probe_ns": probe_median(graded.columns),
        "load_ns": load_time(graded.columns, counting["repeat"].unique()),
        "algo_p50_ns": percentile(best, 50),
        "algo_p95_ns": percentile(best, 95),
        "algo_p99_ns": percentile(best, 99),
        "algo_max_ns": best.max(),
        "algo_median_p50_ns": percentile(per_step.median().to_numpy(), 50),
    }


def probe_median(columns: Columns) -> float:
    """Median over rounds of the reference kernel, the better of its timings around a round [ns]."""
    probes = columns["probe_ns"].astype(np.float64)
    best = np.where(probes > 0, probes, np.inf).min(axis=1)
    known = best[np.isfinite(best)]
    return float(np.median(known)) if len(known) else np.nan


def load_time(columns: Columns, counting: NDArray[np.int32]) -> float:
    """The load kernel as a step is timed [ns]: per pass the minimum over the rounds that count.

    Of the passes before and after a round the geometric mean.
    """
    rounds = np.unique(columns["repeat"])
    passes = columns["load_ns"].astype(np.float64)[np.isin(rounds, counting)]
    passes = np.where(passes > 0, passes, np.nan)
    whole = passes[np.isfinite(passes).all(axis=(1, 2))]
    return float(np.exp(np.log(whole.min(axis=0)).mean())) if len(whole) else float(np.nan)


def spoilt_rounds_of(columns: Columns) -> NDArray[np.int32]:
    """The spoilt rounds of a judged replay."""
    rounds: NDArray[np.int32] = np.unique(columns["repeat"]).astype(np.int32)
    return spoilt_rounds(rounds, columns["probe_ns"].astype(np.float64))
