"""Compare two configurations step by step, on the steps that both have done."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.step_times import StepTimes
from dpbench.analysis.statistics import UNKNOWN, Interval, long_enough, pooled_mean
from dpbench.analysis.verdict.verdict import Verdict, Verdicts
from dpbench.arrays import Floats


@dataclass(frozen=True)
class PairedComparison:
    """Times of two configurations on the same steps, as a ratio second/first.

    `leaders` names the faster one by each yardstick; where they differ the order is unstable.
    """

    first: str
    second: str
    ratio: Interval
    steps: int
    leaders: dict[str, str]

    @property
    def tied(self) -> bool:
        """True if the two cannot be told apart."""
        return self.ratio.spans(1.0)

    @property
    def unstable(self) -> bool:
        """True if another yardstick names another leader."""
        return len(set(self.leaders.values())) > 1 or self.ratio.high < 1.0

    @property
    def row(self) -> dict[str, Any]:
        """Names, ratio with its interval, and its assessment, for a table."""
        r = self.ratio
        row: dict[str, Any] = {"first": self.first, "second": self.second}
        row |= {"ratio": r.value, "low": r.low, "high": r.high, "steps": self.steps}
        return row | {"tied": self.tied, "unstable": self.unstable}


def paired(first: StepTimes, second: StepTimes) -> tuple[Floats, Floats]:
    """Return the algorithmic times of the steps that both configurations have done."""
    if np.array_equal(first.k, second.k):
        return first.algo_ns, second.algo_ns
    _, in_first, in_second = np.intersect1d(first.k, second.k, return_indices=True)
    return first.algo_ns[in_first], second.algo_ns[in_second]


def common_ratio(replays: Iterable[tuple[StepTimes, StepTimes]]) -> Interval:
    """Return the ratio second/first on the steps that both of each pair have done.

    Each pair has equal weight; unknown where there are none.
    """
    common = (paired(first, second) for first, second in replays)
    return pooled_mean([np.log(second / first) for first, second in common if len(first)])


def log_reach(first: Mapping[int, StepTimes], second: Mapping[int, StepTimes]) -> float:
    """Return half the width of the log ratio's interval of two configurations; NaN without one.

    Both by the number of the replay.
    """
    ratio = common_ratio((first[place], second[place]) for place in first if place in second)
    known = ratio.low > 0.0 and ratio.high < math.inf
    return 0.5 * math.log(ratio.high / ratio.low) if known else math.nan


def paired_comparison(records: Records, first: Verdict, second: Verdict) -> PairedComparison:
    """Compare two configurations on the steps of the sequences that are `long_enough`.

    Each sequence has equal weight; `first` has the smaller p99, or the smaller largest step where
    there is none.
    """
    names = first.configuration.label, second.configuration.label
    logs: list[Floats] = []
    leaders: dict[str, str] = {}
    for sequence in records.sequences:
        first_times = _times(records, sequence, first)
        second_times = _times(records, sequence, second)
        if first_times is None or second_times is None:
            continue
        second_ns, first_ns = paired(second_times, first_times)
        if len(first_ns) == 0:
            continue
        logs.append(np.log(second_ns / first_ns))
        first_leads = np.median(first_ns) <= np.median(second_ns)
        leaders[f"median on `{sequence}`"] = names[0] if first_leads else names[1]
    if not logs:
        return PairedComparison(*names, UNKNOWN, 0, {})
    leaders["p99" if math.isfinite(first.p99_ns) else "largest step"] = names[0]
    steps = sum(map(len, long_enough(logs)))
    return PairedComparison(*names, pooled_mean(logs), steps, leaders)


def faster_but_open(records: Records, verdicts: Verdicts, chosen: Verdict) -> list[Verdict]:
    """Return the fastest inconclusive configuration of each solver, the fastest first.

    Only those surely faster than `chosen`, without anything against the requirements.
    """
    unsettled = [v for v in verdicts.all if v.state == "inconclusive" and v.timed_on]
    ratios = [paired_comparison(records, chosen, verdict).ratio for verdict in unsettled]
    faster = [pair for pair in zip(ratios, unsettled, strict=True) if pair[0].high < 1.0]
    first: dict[str, Verdict] = {}
    for _, verdict in sorted(faster, key=lambda pair: pair[0].value):
        first.setdefault(verdict.configuration.solver, verdict)
    return list(first.values())


def _times(records: Records, sequence: str, verdict: Verdict) -> StepTimes | None:
    for run in records.replays(sequence):
        if run.configuration.in_common_formulation == verdict.configuration:
            return records.times(run)
    return None
