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
    """Two configurations on the same steps: how many times as long `second` takes as `first`.

    `leaders` names the faster one by each yardstick; where they differ the order is unstable.
    """

    first: str
    second: str
    ratio: Interval
    steps: int
    leaders: dict[str, str]

    @property
    def tied(self) -> bool:
        """Whether the two cannot be told apart."""
        return self.ratio.spans(1.0)

    @property
    def unstable(self) -> bool:
        """Whether another yardstick names another leader."""
        return len(set(self.leaders.values())) > 1 or self.ratio.high < 1.0

    @property
    def row(self) -> dict[str, Any]:
        """Who, the ratio and its interval, and what is said of it, for a table."""
        r = self.ratio
        row: dict[str, Any] = {"first": self.first, "second": self.second}
        row |= {"ratio": r.value, "low": r.low, "high": r.high, "steps": self.steps}
        return row | {"tied": self.tied, "unstable": self.unstable}


def paired(first: StepTimes, second: StepTimes) -> tuple[Floats, Floats]:
    """Algorithmic times of the steps that both configurations have done."""
    if np.array_equal(first.k, second.k):
        return first.algo_ns, second.algo_ns
    _, in_first, in_second = np.intersect1d(first.k, second.k, return_indices=True)
    return first.algo_ns[in_first], second.algo_ns[in_second]


def common_ratio(replays: Iterable[tuple[StepTimes, StepTimes]]) -> Interval:
    """How many times as long the second of each pair takes as the first, on the steps that both
    have done, each pair of equal weight; unknown where there are none."""
    common = (paired(first, second) for first, second in replays)
    return pooled_mean([np.log(second / first) for first, second in common if len(first)])


def log_reach(first: Mapping[int, StepTimes], second: Mapping[int, StepTimes]) -> float:
    """How far the interval of the ratio of two configurations reaches to either side, as a
    logarithm; NaN where there is none. Both by the number of the replay."""
    ratio = common_ratio((first[place], second[place]) for place in first if place in second)
    known = ratio.low > 0.0 and ratio.high < math.inf
    return 0.5 * math.log(ratio.high / ratio.low) if known else math.nan


def paired_comparison(records: Records, first: Verdict, second: Verdict) -> PairedComparison:
    """Compare two configurations on the steps of the sequences that are `long_enough`, each of
    equal weight; `first` has the smaller p99, or the smaller largest step where there is none."""
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
    """Of each solver the configuration that takes least time beside `chosen`, where that is surely
    less and nothing contradicts the requirements, but the verdict is inconclusive; the fastest
    first.
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
