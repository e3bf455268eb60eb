"""The uncertainty of step times between rounds: how near to a limit a time decides nothing."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.arrays import Floats
from dpbench.bench.record.cell import Configuration

QUANTILE = 0.95
"""Share of the configurations whose rounds differ by less than the usual factor."""
LEAST = 1.05
"""Smallest uncertainty, however even the rounds are."""
UNKNOWN = 1.5
"""Uncertainty without any replay of two rounds: machines of one kind differ by as much."""


@dataclass(frozen=True)
class Uncertainty:
    """Factors within which step times are uncertain, by configuration.

    A replay's time is the fastest round of each step, so it is as uncertain as the middle round is
    slower. A closed loop is timed once, maybe in a slow round: the upper quartile of the rounds.

    middle, slow, slowest : median of the middle round, of the upper quartile and of the slowest
        round over that of the fastest, the largest of its replays.
    usual : the quantile `QUANTILE` of `middle`, at least `LEAST`.
    """

    middle: dict[Configuration, float]
    slow: dict[Configuration, float]
    slowest: dict[Configuration, float]
    usual: float

    def get_factor_of_run(self, run: RunRecord) -> float:
        """Return the factor within which a run's step times are uncertain."""
        own = self.middle if run.mode == "replay" else self.slow
        return max(self.usual, own.get(run.configuration.moved_to_common_formulation, 0.0))


def estimate_uncertainty(records: Records) -> Uncertainty:
    """Estimate the uncertainty factors of step times from the spread between repetitions."""
    factors: dict[Configuration, list[Floats]] = {}
    for run in records.select_runs(mode="replay", units="scaled"):
        times = records.get_step_times(run)
        # A window has too few steps: the middle of each round is one of a few timings.
        if times is None or len(times.rounds_ns) < 2 or run.steps_searched_for_hardest:
            continue
        quantiles = np.quantile(times.rounds_ns, (0.5, 0.75, 1.0)) / times.rounds_ns.min()
        factors.setdefault(run.configuration.moved_to_common_formulation, []).append(quantiles)
    largest = {key: np.max(own, axis=0).tolist() for key, own in factors.items()}
    middle, slow, slowest = ({key: own[i] for key, own in largest.items()} for i in range(3))
    usual = max(LEAST, compute_factor_quantile(middle.values())) if middle else UNKNOWN
    return Uncertainty(middle, slow, slowest, usual)


def compute_factor_quantile(factors: Iterable[float]) -> float:
    """Return the 95 % quantile of some factors, as of the configurations' uncertainty."""
    return float(np.quantile(list(factors), QUANTILE))
