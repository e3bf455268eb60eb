"""Step times of one replayed configuration, out of its step rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dpbench.analysis.records.counting_rows import CountingRows
from dpbench.analysis.statistics import Floats


@dataclass(frozen=True, eq=False)
class StepTimes:
    """Step times of one replayed configuration, over the rounds that count.

    Parameters
    ----------
    k : (K,) steps, rising; algo_ns : (K,) least over the rounds, the algorithmic time.
    raw_max_ns : the largest single sample.
    rounds_ns : (R,) median of the samples of each round, in the order of the rounds: how far they
        lie apart is what the machine adds, whatever the solver.
    """

    k: NDArray[np.int64]
    algo_ns: Floats
    raw_max_ns: float
    rounds_ns: Floats


def step_times_of(rows: CountingRows) -> StepTimes | None:
    """Step times of the rows of one replay; None when no counting round left a step."""
    if not len(rows):
        return None
    best = np.full(int(rows.k.max()) + 1, np.inf)
    np.minimum.at(best, rows.k, rows.total_ns)
    done = np.flatnonzero(np.isfinite(best))
    rounds = [float(np.median(rows.total_ns[rows.repeat == r])) for r in np.unique(rows.repeat)]
    return StepTimes(done, best[done], float(rows.total_ns.max()), np.array(rounds))
