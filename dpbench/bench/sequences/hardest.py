"""The hardest window of an exactly solved loop: steps in a row around its hardest step.

Hardness comes from the certified optima alone, so it favours no solver. Active limits and changes
of them are what an active-set method has to find. Over the closed loops of suite `standard` their
sum correlates better with the iterations of 20 solvers than either of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from dpbench.arrays import Flags, Floats, Ints
from dpbench.qp.referee.optimum import ACTIVE_MULTIPLIER, Optimum


def active_limits(optima: Sequence[Optimum]) -> Ints:
    """(K, m + n) the limits active at each optimum: 1 upper, −1 lower, 0 inactive.

    All 0 where there is no optimum.
    """
    multipliers = np.array([np.concatenate((o.y, o.y_box)) for o in optima])
    active = np.abs(multipliers) > ACTIVE_MULTIPLIER
    active &= has_optimum(optima)[:, None]
    return np.where(active, np.sign(multipliers), 0).astype(np.int64)


def has_optimum(optima: Sequence[Optimum]) -> Flags:
    """(K,) whether each step has a certified optimum, and is not proven infeasible."""
    finite: Flags = np.isfinite([optimum.bound for optimum in optima])
    return finite


def hardness(active: Ints, feasible: Flags) -> Floats:
    """Hardness of each step: active limits plus limits that differ from the step before.

    A step without an optimum is harder by 1 than the hardest of all others.

    Parameters
    ----------
    active : (K, m + n) as of `active_limits`; nothing is active before the first step.
    feasible : (K,) whether a step has an optimum.
    """
    before = np.vstack((np.zeros_like(active[:1]), active[:-1]))
    hard: Floats = (active != 0).sum(axis=1) + (active != before).sum(axis=1) + 0.0
    hard[~feasible] = hard.max() + 1.0
    return hard


def hardest_window(hard: Floats, steps: int) -> int:
    """The first step of the window of `steps` steps that holds the hardest step.

    Of the windows that hold it, the one with the largest sum of hardness; of equals the earliest.
    Of equally hard steps the earliest is the hardest.
    """
    sums = sliding_window_view(hard, steps).sum(axis=1)
    at = int(np.argmax(hard))
    earliest = max(0, at - steps + 1)
    return earliest + int(np.argmax(sums[earliest : at + 1]))


def first_of_hardest(optima: Sequence[Optimum], first: int, of: int, steps: int) -> int:
    """The step at which the hardest `steps` steps begin, within `first` to `first + of`."""
    optima = optima[: first + of]
    hard = hardness(active_limits(optima), has_optimum(optima))
    return first + hardest_window(hard[first:], steps)
