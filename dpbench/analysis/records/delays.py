"""Single timings that took much longer than their step does, round by round.

A timing is taken net of its wait for the core (`waited_ns`), in which the machine ran something
else. The wait of a solver's other threads is not known, so that the timings of a solver that waits
for them are taken gross, and so are those that it is compared with.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from dpbench.arrays import Flags, Floats, Ints
from dpbench.bench.record.recorded_steps import places_of

COLUMNS = ("run_id", "repeat", "k", "counts", "total_ns", "waited_ns")
"""What `delays_by_run` asks of a step table."""
DELAYED = 2.0
"""A timing over this multiple of the fastest time of its step is a delay."""


@dataclass(frozen=True, eq=False)
class Delays:
    """Delays of one run, over the rounds that count.

    The base time of a timing is the fastest time of its step where the run has several rounds. A
    run of one round, such as a closed loop, has the median over its steps as the base of all, and
    every timing above it is a delay: of slow steps or of the machine.

    Parameters
    ----------
    samples : (R,) timings of each round.
    base_ns : (R,) sum of their base times: the time that the run is exposed to the machine.
    step_ns : median over the timings.
    round : (D,) index of the round of each delay; delay_ns : (D,) its timing; own_ns : (D,) its
        base time.
    """

    samples: Ints
    base_ns: Floats
    step_ns: float
    round: Ints
    delay_ns: Floats
    own_ns: Floats

    def count_late(self, limit_ns: float) -> Ints:
        """Count the delays beyond a limit in each round (R,)."""
        return self._count(self.delay_ns > limit_ns)

    def count_stalls(self, longer_than_ns: float) -> Ints:
        """Count the delays that exceed their base time by more than a duration, by round (R,)."""
        return self._count(self.delay_ns - self.own_ns > longer_than_ns)

    def _count(self, chosen: Flags) -> Ints:
        return np.bincount(self.round[chosen], minlength=len(self.samples)).astype(np.int64)


@dataclass(frozen=True, eq=False)
class RunDelays:
    """Delays of one run: net of its waits for the core, None if these are unknown, and gross."""

    net: Delays | None
    gross: Delays


def delays_by_run(steps: pd.DataFrame) -> Iterator[tuple[str, RunDelays]]:
    """Yield the delays of every run of a step table that left a counting row."""
    counting = steps[steps["counts"]]
    repeat, k = (counting[name].to_numpy(dtype=np.int64) for name in ("repeat", "k"))
    total_ns = counting["total_ns"].to_numpy(dtype=np.float64, na_value=np.nan)
    waited_ns = counting["waited_ns"].to_numpy(dtype=np.float64, na_value=np.nan)
    for run_id, (first, end) in places_of(counting["run_id"]).items():
        own = slice(first, end)
        timed = ~np.isnan(total_ns[own])
        known = not np.isnan(waited_ns[own][timed]).any()
        net_ns = total_ns[own] - waited_ns[own]
        yield (
            run_id,
            RunDelays(
                delays_of(repeat[own], k[own], net_ns) if known else None,
                delays_of(repeat[own], k[own], total_ns[own]),
            ),
        )


def delays_of(repeat: Ints, k: Ints, timing_ns: Floats) -> Delays:
    """Delays of the rows (N,) of one run that count: their round, step and time [ns].

    Steps without a computation, NaN, are left out.
    """
    timed = ~np.isnan(timing_ns)
    repeat, k, timing_ns = repeat[timed], k[timed], timing_ns[timed]
    rounds, index = np.unique(repeat, return_inverse=True)
    middle = float(np.median(timing_ns)) if len(timing_ns) else np.nan
    if len(rounds) > 1:
        fastest = np.full(int(k.max()) + 1, np.inf)
        np.minimum.at(fastest, k, timing_ns)
        base = fastest[k]
        delayed = timing_ns > DELAYED * base
    else:
        base = np.full(len(timing_ns), middle)
        delayed = timing_ns > base
    return Delays(
        samples=np.bincount(index, minlength=len(rounds)).astype(np.int64),
        base_ns=np.bincount(index, weights=base, minlength=len(rounds)).astype(np.float64),
        step_ns=middle,
        round=index[delayed].astype(np.int64),
        delay_ns=timing_ns[delayed],
        own_ns=base[delayed],
    )
