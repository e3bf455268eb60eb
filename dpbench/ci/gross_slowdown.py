"""Slowdowns that are shown in spite of other load on the machine.

Other load makes a time larger in three ways. It takes the processor away: of a run's shortest pass
at least the share of the time with a processor is the solver's own, so the head's time is
multiplied with that share and the base's is left as it is. It makes the processor slower: the
reference kernel shows that. It takes cache and memory bandwidth: GROSS leaves room for that.
"""

from collections.abc import Sequence

import numpy as np

from dpbench.analysis.records.machine import GROSS
from dpbench.analysis.statistics import Interval
from dpbench.bench.record.disturbance import MAX_STEAL_SHARE
from dpbench.ci.benchmarks import Benchmark
from dpbench.report.formats import plural, significant

MAX_KERNEL_RATIO = 1.1
"""Largest ratio of the reference kernel's times before and after the two runs of a pair."""
MAX_BUSY_THREADS = 1.05
"""Largest share of the wall time that a single thread computes, with the error of the clocks."""
MIN_PAIRS = 2
"""Pairs of runs that must agree: load that is there in one run alone shows in one pair."""


def find_unmet_condition(both: Sequence[tuple[Benchmark, Benchmark]], ratio: Interval) -> str:
    """Return the first condition of a slowdown beyond GROSS that is not met; "" if all are.

    both : pairs of runs (base, head), disturbed or not.
    ratio : of the times of all pairs.
    """
    if len(both) < MIN_PAIRS:
        return f"{plural(len(both), 'pair')} of runs < {MIN_PAIRS}"
    if not ratio.low > GROSS:
        return f"lower end of the interval {significant(ratio.low)} ≤ {GROSS}"
    return next(filter(None, (_find_unmet_condition_of_pair(*pair) for pair in both)), "")


def _find_unmet_condition_of_pair(was: Benchmark, now: Benchmark) -> str:
    """Return the first condition that a pair of runs does not meet; "" if it meets all."""
    if was.machine is None or now.machine is None:
        return "state of the machine unknown"
    head = now.machine
    states = was.machine, head
    kernels = np.array([(one.kernel_before_ns, one.kernel_after_ns) for one in states])
    change, largest = (100.0 * (x - 1.0) for x in (kernels.max() / kernels.min(), MAX_KERNEL_RATIO))
    stolen, threads = 100.0 * head.steal_s / head.wall_s, head.processor_s / head.wall_s
    # Of several threads, of stolen time and of a throttled processor the clock of the process is no
    # bound. The shortest pass is no longer than the mean one, of which it has computed this share.
    bound = now.minimum_s / was.minimum_s * min(threads, 1.0)
    lost = "waited itself" if head.waits_itself else "had no processor"
    # A kernel that was not timed is NaN, and so is a hidden counter of the head.
    conditions = {
        "reference kernel not timed": np.isfinite(kernels).all(),
        f"reference kernel changed by {significant(change)} % > {largest:.0f} %": change <= largest,
        f"stolen time of the head {significant(stolen)} % > {100.0 * MAX_STEAL_SHARE:g} %": not (
            stolen > 100.0 * MAX_STEAL_SHARE
        ),
        "processor of the head throttled": not head.throttle_events > 0,
        f"busy threads of the head {significant(threads)} > {MAX_BUSY_THREADS}": (
            threads <= MAX_BUSY_THREADS
        ),
        f"× {significant(bound)} ≤ {GROSS} after deducting the time in which the head {lost}": (
            bound > GROSS
        ),
    }
    return next((text for text, is_met in conditions.items() if not is_met), "")
