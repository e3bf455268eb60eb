"""Step times of one replayed configuration, out of its step rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpbench.analysis.counting_rows import CountingRows
from dpbench.analysis.statistics import Floats

PHASES = ("setup", "update", "solve", "read")


@dataclass(frozen=True, eq=False)
class StepTimes:
    """Step times of one replayed configuration.

    Parameters
    ----------
    k : (K,) steps; algo_ns : (K,) minimum over the counting rounds, the algorithmic time.
    typical_ns : (K,) median over the counting rounds, what a typical round takes.
    raw_ns : (N,) all samples of the counting rounds; raw_k : (N,) the step of each.
    true : (K,) whether the referee found the answer untrue in no counting round.
    error : (K,) the accuracy achieved, which is the largest error_move of the counting rounds; inf
        where the step failed or its answer is untrue in one of them, 0 where it is neither and no
        certified optimum is there to differ from.
    phase_ns : median of each phase over the samples, NaN where it is no part of a step.
    iterations : median, mean and largest count, NaN where the solver gives none.
    rounds : how many rounds count.
    """

    k: NDArray[np.int64]
    algo_ns: Floats
    typical_ns: Floats
    raw_ns: Floats
    raw_k: NDArray[np.int64]
    true: NDArray[np.bool_]
    error: Floats
    phase_ns: dict[str, float]
    iterations: tuple[float, float, float]
    rounds: int


def step_times_of(rows: CountingRows) -> StepTimes | None:
    """Step times of the rows of one replay; None when no counting round left a step."""
    if not len(rows):
        return None
    k, raw = rows.k, rows.total_ns
    best = np.full(int(k.max()) + 1, np.inf)
    np.minimum.at(best, k, raw)
    done = np.flatnonzero(np.isfinite(best))
    true = np.ones(len(best), dtype=np.bool_)
    np.logical_and.at(true, k, rows.true | ~rows.known)
    error = np.zeros(len(best))
    np.maximum.at(error, k, _achieved(rows))
    counted = rows.iterations[np.isfinite(rows.iterations)]
    return StepTimes(
        k=done,
        algo_ns=best[done],
        typical_ns=_medians(k, raw, done),
        raw_ns=raw,
        raw_k=k,
        true=true[done],
        error=error[done],
        phase_ns={phase: _median(getattr(rows, f"{phase}_ns")) for phase in PHASES},
        iterations=(float(np.median(counted)), float(counted.mean()), float(counted.max()))
        if len(counted)
        else (float(np.nan), float(np.nan), float(np.nan)),
        rounds=len(np.unique(rows.repeat)),
    )


def _medians(k: NDArray[np.int64], raw: Floats, wanted: NDArray[np.int64]) -> Floats:
    """Median of the samples of each wanted step; a configuration cut short has fewer of its last
    ones."""
    order = np.lexsort((raw, k))
    steps, times = k[order], raw[order]
    first, end = (np.searchsorted(steps, wanted, side) for side in ("left", "right"))
    middle: Floats = 0.5 * (times[(first + end - 1) // 2] + times[(first + end) // 2])
    return middle


def _achieved(rows: CountingRows) -> Floats:
    """error_move of each row, inf where it failed or is not true; see `StepTimes.error`."""
    lost = rows.failed | (rows.known & ~rows.true)
    error = np.where(rows.known, np.nan_to_num(rows.error_move, nan=0.0, posinf=np.inf), 0.0)
    return np.where(lost, np.inf, error)


def _median(numbers: Floats) -> float:
    numbers = numbers[np.isfinite(numbers)]
    return float(np.median(numbers)) if len(numbers) else float(np.nan)
