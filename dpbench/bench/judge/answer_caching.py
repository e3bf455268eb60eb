"""Detection of solvers that remember the answers of earlier rounds.

All rounds of a replay are the same QPs, so a table of answers answers every round but the first in
no time. It cannot answer a step that it sees for the first time: the time of each first visit is
compared with the shortest of the later visits of that step, which is what the tables print. First
visits are those of round 1 beyond the warm-up, where importing and compiling are over; where there
are too few, those of the warm-up. A table that outlives the process is found by the closed loop of
its configuration, whose QPs it has not seen.

Moving q a little in each round instead would not help: a table may round its keys or count the
steps, and repeatability and paired comparisons rest on identical bytes.
"""

from typing import Literal

import numpy as np
import pandas as pd

from dpbench.arrays import Floats, Ints
from dpbench.bench.judge.rules import count_explained_late_timings
from dpbench.bench.record.cell import CONFIGURATION_COLUMNS
from dpbench.bench.record.raw_log import COUNTERS, RawLog, sum_phases_by_step_ns

FEWEST_VISITS = 20
"""First visits, each with a later one, below which the figures are NaN."""
MOST_WARMING = 3.0
"""Largest median ratio of first to later visits that warming and the machine explain.

Of 173 honest replays of `paper` and `rough` under a load of three to eight the largest was 2.15 and
the median 1.00; a dictionary in place of 2 ms had 83.
"""
SLOW_VISIT = 4.0
"""A visit that takes so many times as long as the shortest other one is slow."""
MOST_SLOW_FIRST = 0.05
"""Largest share of slow first visits, beyond twice that of later rounds, put down to the machine.

Of 26 honest replays under a load of five to six the largest excess was below 0.
"""
MOST_LOOP = 10.0
"""Largest ratio of a closed loop's median step to the replay's that caches and other QPs explain.

15 honest pairs had 0.5 to 1.3, the dictionary 124.
"""
MOST_LOOP_TAIL = 15.0
"""Largest such ratio of the 90th percentiles: 144 honest pairs had 0.7 to 1.6."""


def compute_caching_metrics(log: RawLog) -> dict[str, float]:
    """Return how much slower QPs are solved the first time than later, a sign of cached answers.

    `first_visit_ratio` is the median over steps of the first visit's time over the shortest later
    one, by the slowdown of the reference kernel. `first_visit_excess` is the share of slow first
    visits less twice that of any later round and less what switches explain: a memory of hard steps
    alone leaves the median as it is.
    """
    total = sum_phases_by_step_ns(log.times)
    warm_up, steps = int(log.done[0]), len(log.first_ns)
    number = np.arange(steps)
    for r, group in ((1, number >= warm_up), (0, number < warm_up)):
        if r >= len(log.done):
            continue
        later = _collect_times_of_later_rounds(log, total, r)
        shortest = later.min(axis=0, initial=np.inf)
        pairs = group & (log.first_ns > 0) & np.isfinite(shortest)
        if np.count_nonzero(pairs) >= FEWEST_VISITS:
            slower = _measure_machine_slowdown(log, r)
            ratio = float(np.median(log.first_ns[pairs] / shortest[pairs])) / slower
            first, later = log.first_ns[pairs].astype(np.float64), later[:, pairs]
            excess = _compute_share_slow_at_first(
                first, later, slower, _count_explained_slow_steps(log, r, later)
            )
            return {"first_visit_ratio": ratio, "first_visit_excess": excess}
    return {"first_visit_ratio": np.nan, "first_visit_excess": np.nan}


def _compute_share_slow_at_first(
    first: Floats, later: Floats, slower: float, explained: int
) -> float:
    """Return the share of steps slow when first solved (K,) but not in later rounds (R, K)."""
    slow_first = np.count_nonzero(first > SLOW_VISIT * slower * later.min(axis=0))
    slow_later = 0
    for i, visits in enumerate(later):
        others = np.vstack([first, np.delete(later, i, axis=0)]).min(axis=0)
        slow_later = max(slow_later, int(np.count_nonzero(visits > SLOW_VISIT * others)))
    return float((slow_first - 2 * slow_later - explained) / len(first))


def _count_explained_slow_steps(log: RawLog, r: int, later: Floats) -> int:
    """Return how many slow steps in round r its involuntary context switches may explain."""
    if log.attempts[r] > 1:
        return 0
    counted = dict(zip(COUNTERS, log.counters[r].tolist(), strict=True))
    timed_share = 1e-9 * float(later.min(axis=0).sum()) / (counted["replay_s"] or float("nan"))
    return count_explained_late_timings(
        float(np.nan_to_num(counted["involuntary_switches"])), timed_share
    )


def _collect_times_of_later_rounds(log: RawLog, total: Ints, r: int) -> Floats:
    """Return the solve times (R, K) of each step in the rounds after round r; inf for none."""
    # A round that was run again holds its last attempt, which is a later visit too.
    rounds = np.arange(r if log.attempts[r] > 1 else r + 1, len(log.done))
    rounds = rounds[log.done[rounds] > 0]
    recorded = np.arange(total.shape[1]) < log.done[rounds][:, np.newaxis]
    return np.where(recorded, np.maximum(total[rounds], 1), np.inf)


def _measure_machine_slowdown(log: RawLog, r: int) -> float:
    """Return how many times slower than at its best the machine was around replay round r."""
    seen = log.reference_kernel_ns[log.reference_kernel_ns > 0]
    if not len(seen):
        return 1.0
    return max(1.0, float(log.first_reference_kernel_ns[r] / seen.min()))


CachingSign = tuple[Literal["first visit", "loop", "slow first visits", "loop tail"], float]
"""Sign of cached answers in a replay's times, and its value."""


def find_caching_sign(
    first_visit_ratio: float,
    loop_ratio: float,
    first_visit_excess: float = np.nan,
    loop_tail_ratio: float = np.nan,
) -> CachingSign | None:
    """Return the first of four ratios (NaN: unknown) that is as of cached answers; or None."""
    if first_visit_ratio > MOST_WARMING:
        return "first visit", first_visit_ratio
    if loop_ratio > MOST_LOOP:
        return "loop", loop_ratio
    if first_visit_excess > MOST_SLOW_FIRST:
        return "slow first visits", first_visit_excess
    return ("loop tail", loop_tail_ratio) if loop_tail_ratio > MOST_LOOP_TAIL else None


_CONFIGURATION = ["scenario", *CONFIGURATION_COLUMNS]


def add_loop_ratios(runs: pd.DataFrame) -> pd.DataFrame:
    """Return a copy of a table of runs with loop over replay step times added, at p50 and p90.

    NaN without a loop in that scenario that finished without a failed step, as a solver that fails
    meets other QPs.
    """
    columns = {"loop_ratio": "p50", "loop_tail_ratio": "p90"}
    if not {"raw_p50_ns", "failed_steps"} <= set(runs):
        return runs.assign(**dict.fromkeys(columns, np.nan))
    sound = (runs["outcome"] == "finished") & (runs["failed_steps"] == 0)
    loops = runs[(runs["mode"] == "closed_loop") & (runs["slowdown"] == 0.0) & sound]
    # The longest loop: the median of a part of it is one of other QPs.
    longest = loops.sort_values("steps_done", kind="stable").groupby(_CONFIGURATION).tail(1)
    keys = pd.MultiIndex.from_frame(runs[_CONFIGURATION])
    ratios = {}
    times = longest.set_index(_CONFIGURATION)
    for column, percent in columns.items():
        name = f"raw_{percent}_ns"
        if name not in runs:
            ratios[column] = np.full(len(runs), np.nan)
            continue
        loop_ns = times[name].astype(np.float64)
        if f"controller_{percent}_ns" in times:
            # Of a cascade, the QPs of the replay are the first ones.
            loop_ns = times[f"controller_{percent}_ns"].astype(np.float64).fillna(loop_ns)
        ratio = loop_ns.reindex(keys).to_numpy() / runs[name].to_numpy(dtype=np.float64)
        ratios[column] = np.where(runs["mode"] == "replay", ratio, np.nan)
    return runs.assign(**ratios)
