"""The uncertainty of step times between rounds: how near to a limit a time decides nothing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.bench.record.configuration import Configuration

QUANTILE = 0.95
"""Share of the configurations whose rounds differ by less than the usual factor."""
LEAST = 1.05
"""Smallest uncertainty that is believed, however even the rounds are."""
UNKNOWN = 1.5
"""Uncertainty without any replay of two rounds: machines of one kind differ by as much."""


@dataclass(frozen=True)
class Uncertainty:
    """Factors within which the times of a campaign are uncertain.

    The algorithmic time of a step is its fastest round, which one slow round does not change, so
    that of a replay is as uncertain as the middle round is slower than the fastest. A closed loop
    is timed once, at a moment that may be like the slowest round.

    Parameters
    ----------
    middle, slowest : by configuration, the median of the middle and of the slowest round over that
        of the fastest, the largest of its replays.
    usual : the quantile `QUANTILE` of `middle`, at least `LEAST`.
    """

    middle: dict[Configuration, float]
    slowest: dict[Configuration, float]
    usual: float

    def of(self, run: RunRecord) -> float:
        """Return the factor of a run: that of its configuration, and at least the usual one."""
        own = self.middle if run.mode == "replay" else self.slowest
        return max(self.usual, own.get(run.configuration.in_common_formulation, 0.0))


def uncertainty_of(records: Records) -> Uncertainty:
    """Return the uncertainty of the times of a result folder."""
    middle: dict[Configuration, float] = {}
    slowest: dict[Configuration, float] = {}
    for run in records.select(mode="replay", units="scaled"):
        times = records.times(run)
        # A window has too few steps: the middle of each round is one of a few timings.
        if times is None or len(times.rounds_ns) < 2 or run.window_of:
            continue
        key, fastest = run.configuration.in_common_formulation, float(times.rounds_ns.min())
        middle[key] = max(float(np.median(times.rounds_ns)) / fastest, middle.get(key, 1.0))
        slowest[key] = max(float(times.rounds_ns.max()) / fastest, slowest.get(key, 1.0))
    usual = max(LEAST, usual_factor(middle.values())) if middle else UNKNOWN
    return Uncertainty(middle, slowest, usual)


def usual_factor(factors: Iterable[float]) -> float:
    """Return the factor that the share `QUANTILE` of the configurations stay below."""
    return float(np.quantile(list(factors), QUANTILE))
