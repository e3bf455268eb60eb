"""Step times of one replayed configuration, out of its step rows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from dpbench.arrays import Floats, Ints
from dpbench.bench.record.recorded_steps import places_of

COLUMNS = ("run_id", "repeat", "k", "counts", "total_ns")
"""What `times_by_run` asks of a step table."""


@dataclass(frozen=True, eq=False)
class StepTimes:
    """Step times of one replayed configuration, over the rounds that count.

    Parameters
    ----------
    k : (K,) steps, rising; algo_ns : (K,) least over the rounds, the algorithmic time.
    raw_max_ns : the largest single timing.
    rounds_ns : (R,) median of the samples of each round, in the order of the rounds: how far they
        lie apart is what the machine adds, whatever the solver.
    """

    k: Ints
    algo_ns: Floats
    raw_max_ns: float
    rounds_ns: Floats


def times_by_run(steps: pd.DataFrame) -> Iterator[tuple[str, StepTimes]]:
    """Those of every run of a table that left a counting row."""
    counting = steps[steps["counts"]]
    repeat, k = (counting[name].to_numpy(dtype=np.int64) for name in ("repeat", "k"))
    total_ns = counting["total_ns"].to_numpy(dtype=np.float64, na_value=np.nan)
    for run_id, (first, end) in places_of(counting["run_id"]).items():
        own = slice(first, end)
        yield run_id, step_times_of(repeat[own], k[own], total_ns[own])


def step_times_of(repeat: Ints, k: Ints, total_ns: Floats) -> StepTimes:
    """Step times of the rows (N,) of one replay that count: their round, step and time."""
    best = np.full(int(k.max()) + 1, np.inf)
    np.minimum.at(best, k, total_ns)
    done = np.flatnonzero(np.isfinite(best))
    rounds = [float(np.median(total_ns[repeat == r])) for r in np.unique(repeat)]
    return StepTimes(done, best[done], float(total_ns.max()), np.array(rounds))
