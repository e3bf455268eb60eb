"""Determinism audit: does a solver give the same answer to the same QP in every round?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dpbench.bench.record.raw_log import RawLog


def repeatability(log: RawLog, own_per_scaled: NDArray[np.float64]) -> dict[str, float]:
    """The columns on how a replay repeats itself, over all rounds, the warm-up and disturbed ones
    too.

    Parameters
    ----------
    own_per_scaled : (n,) a variable in the solver's units over the same in scaled units.

    Returns
    -------
    Shares of the steps with two rounds or more whose status and bits of z are the same in all of
    them, and whose count of iterations is the same; the largest difference of a z between two
    rounds, in scaled units, and of iterations. NaN where no step was repeated, or the solver counts
    nothing.
    """
    z, iterations, done = log.z, log.iterations, log.done
    steps = z.shape[1]
    recorded = np.arange(steps) < done[:, None]
    repeated = recorded.sum(axis=0) >= 2
    nothing = float("nan")
    if not repeated.any():
        names = ("bit_identical_share", "answer_spread_max")
        return dict.fromkeys((*names, "iterations_identical_share", "iterations_spread"), nothing)
    first = recorded.argmax(axis=0)
    index = np.arange(steps)
    reference = z[first, index]
    # Bits, so that NaN equals NaN and 0.0 is not −0.0.
    same_bits = (z.view(np.uint64) == reference.view(np.uint64)).all(axis=2)
    same_answer = (same_bits & (log.status == log.status[first, index])) | ~recorded
    with np.errstate(invalid="ignore"):  # no answer less no answer
        apart = np.abs(z - reference) / own_per_scaled
    spread = np.where(recorded[:, :, None] & np.isfinite(apart), apart, 0.0).max(axis=(0, 2))
    counted = recorded & (iterations >= 0)
    whole = repeated & (counted.sum(axis=0) == recorded.sum(axis=0))
    most = np.where(counted, iterations, -1).max(axis=0)
    least = np.where(counted, iterations, np.iinfo(np.int64).max).min(axis=0)
    return {
        "bit_identical_share": float(same_answer.all(axis=0)[repeated].mean()),
        "answer_spread_max": float(spread[repeated].max()),
        "iterations_identical_share": (
            float((most == least)[whole].mean()) if whole.any() else nothing
        ),
        "iterations_spread": float((most - least)[whole].max()) if whole.any() else nothing,
    }
