"""Slowdowns that are shown in spite of other load on the machine.

Other load makes a time larger in three ways. It takes the processor away: of a run's shortest pass
at least the share of the time with a processor is the solver's own, so the head's time is
multiplied with that share and the base's is left as it is. It makes the processor slower: the
reference kernel shows that. It takes cache and memory bandwidth: GROSS leaves room for that.
"""

from collections.abc import Sequence

import numpy as np

from dpbench.analysis.statistics import Interval
from dpbench.analysis.times.machine import GROSS
from dpbench.ci.benchmarks import Benchmark

MAX_KERNEL_RATIO = 1.1
"""Largest ratio of the reference kernel's times before and after the two runs of a pair."""
MIN_PAIRS = 2
"""Pairs of runs that must agree: load that is there in one run alone shows in one pair."""


def is_grossly_slower(both: Sequence[tuple[Benchmark, Benchmark]], ratio: Interval) -> bool:
    """Return True if pairs of runs (base, head), disturbed or not, show a slowdown beyond GROSS.

    ratio : of the times of all pairs. Its interval is beyond GROSS, and so is every pair's ratio
        without the time in which the head had no processor.
    """
    if len(both) < MIN_PAIRS or not ratio.low > GROSS:
        return False
    return all(bound_ratio(*pair) > GROSS for pair in both)


def bound_ratio(was: Benchmark, now: Benchmark) -> float:
    """Return a lower bound on the ratio of two times under load; NaN if there is none."""
    if was.machine is None or now.machine is None:
        return np.nan
    states = was.machine, now.machine
    kernels = [ns for one in states for ns in (one.kernel_before_ns, one.kernel_after_ns)]
    # A kernel that was not timed is NaN and makes the comparison false.
    if not np.max(kernels) <= MAX_KERNEL_RATIO * np.min(kernels):
        return np.nan
    return now.minimum_s / was.minimum_s * now.machine.least_own_share
