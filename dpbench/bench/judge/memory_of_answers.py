"""Does a solver remember the answers of earlier rounds? Then its replay times are of no solver.

All rounds of a replay are the same QPs, so a table of answers, kept by the bytes of q, l, u or by
the number of the step, answers every round but the first in no time. What it cannot do is answer a
step that it sees for the first time: the time of each first visit is kept apart, the one of a round
that is run again included, and held against the shortest of the later visits of the same step,
which is what the tables print. First visits are those of round 1 beyond the warm-up, so that
importing, compiling and first touching of memory are over; where there are too few, those of the
warm-up.

A table that outlives the process knows the replay from its first round. It does not know the ship
that the same configuration steers itself: the closed loop is the second witness.

Moving q a little in each round instead would not cure it: a table may round its keys or count the
steps, and identical bytes are what repeatability and paired comparisons rest on.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from dpbench.arrays import Floats, Ints
from dpbench.bench.record.configuration import COLUMNS
from dpbench.bench.record.raw_log import RawLog, step_ns

FEWEST_VISITS = 20
"""First visits, each with a later one, below which nothing is said."""
MOST_WARMING = 3.0
"""Largest median ratio of first to later visits that is put down to warming and to the machine.

Of 173 honest replays of `paper` and `rough`, all solvers, routes and policies, on two cores under a
load of three to eight, the largest was 2.15 and the median 1.00; a dictionary in place of 2 ms had
83. A memory that gains less than this factor is not told from noise, nor is one of fewer than half
of the steps: the 90th percentile of an honest ratio reached 44 there.
"""
MOST_LOOP = 10.0
"""Largest ratio of a closed loop's median step to that of the replay that is put down to caches and
to other QPs: a replay may be a window of the loop. 15 honest pairs had 0.5 to 1.3, the dictionary
124.
"""


def memory_metrics(log: RawLog) -> dict[str, float]:
    """`first_visit_ratio` of a replay; NaN with fewer than `FEWEST_VISITS` pairs of visits.

    The median over steps of the first visit's time over the shortest later one, less the factor by
    which the reference kernel was slower around the first visits than at its best.
    """
    total = step_ns(log.times)
    warm_up, steps = int(log.done[0]), len(log.first_ns)
    number = np.arange(steps)
    for r, group in ((1, number >= warm_up), (0, number < warm_up)):
        if r >= len(log.done):
            continue
        later = _shortest_later(log, total, r)
        pairs = group & (log.first_ns > 0) & np.isfinite(later)
        if np.count_nonzero(pairs) >= FEWEST_VISITS:
            ratio = float(np.median(log.first_ns[pairs] / later[pairs]))
            return {"first_visit_ratio": ratio / _slower(log, r)}
    return {"first_visit_ratio": np.nan}


def _shortest_later(log: RawLog, total: Ints, r: int) -> Floats:
    """The shortest visit of each step after its first one in round r; inf where there is none."""
    # A round that was run again holds its last attempt, which is a later visit too.
    rounds = range(r if log.attempts[r] > 1 else r + 1, len(log.done))
    shortest = np.full(total.shape[1], np.inf)
    for later in rounds:
        done = int(log.done[later])
        np.minimum(shortest[:done], np.maximum(total[later, :done], 1), out=shortest[:done])
    return shortest


def _slower(log: RawLog, r: int) -> float:
    """How much slower the machine was around the first attempt of round r than at its best."""
    seen = log.reference_kernel_ns[log.reference_kernel_ns > 0]
    if not len(seen) or not log.first_reference_kernel_ns[r] > 0:
        return 1.0
    return max(1.0, float(log.first_reference_kernel_ns[r] / seen.min()))


def is_remembered(first_visit_ratio: float, loop_ratio: float) -> bool:
    """Whether the times of a replay are those of remembered answers, by its two ratios.

    A ratio that is not there (no replay, too few steps, no closed loop) is NaN and marks nobody.
    """
    return first_visit_ratio > MOST_WARMING or loop_ratio > MOST_LOOP


_CONFIGURATION = ["scenario", *COLUMNS]


def with_loop_ratio(runs: pd.DataFrame) -> pd.DataFrame:
    """`runs` with `loop_ratio`: of a replay, the median step of its configuration's own closed loop
    over its own; NaN where that configuration steered no ship in that scenario without a failure.

    A solver that fails sails elsewhere, through QPs that may well take it longer.
    """
    if not {"raw_p50_ns", "failed_steps"} <= set(runs):
        return runs.assign(loop_ratio=np.nan)
    sound = (runs["outcome"] == "finished") & (runs["failed_steps"] == 0)
    loops = runs[(runs["mode"] == "closed_loop") & (runs["slowdown"] == 0.0) & sound]
    # The longest loop: the median of a part of it is one of other QPs.
    longest = loops.sort_values("steps_done", kind="stable").groupby(_CONFIGURATION).tail(1)
    median = longest.set_index(_CONFIGURATION)["raw_p50_ns"].astype(np.float64)
    if "controller_p50_ns" in longest:
        # Of a cascade, the QPs of the replay are the first ones.
        alone = longest.set_index(_CONFIGURATION)["controller_p50_ns"].astype(np.float64)
        median = alone.fillna(median)
    keys = pd.MultiIndex.from_frame(runs[_CONFIGURATION])
    ratio = median.reindex(keys).to_numpy() / runs["raw_p50_ns"].to_numpy(dtype=np.float64)
    return runs.assign(loop_ratio=np.where(runs["mode"] == "replay", ratio, np.nan))
