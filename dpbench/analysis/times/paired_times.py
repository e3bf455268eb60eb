"""Step times paired on the same steps: of two solvers, or of two settings of one.

Only replays that were interleaved make a ratio, see `RunRecord.explain_separate_timing`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from dpbench.analysis.records.machine import compute_round_spread
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key, map_first_by_key
from dpbench.analysis.records.run_steps import StepTimes
from dpbench.analysis.statistics import UNKNOWN, Interval, estimate_pooled_ratio, select_long_series
from dpbench.analysis.verdict.verdict import Verdict, Verdicts
from dpbench.arrays import Floats
from dpbench.bench.judge.rules import percentile_or_nan
from dpbench.bench.record.cell import Configuration, sort_key_of_settings

MACHINE_DISTURBED: Final = "machine disturbed"
TOO_FEW_STEPS: Final = "too few steps"
"""Finding on a difference that other load can explain."""
UNSTABLE = "unstable"
"""Finding on a difference whose sign depends on the measure, such as the mean or the p99."""


RATIO_COLUMNS = (
    *("first", "second", "variables", "sequences", "ratio", "low", "high"),
    *("first_us", "second_us", "steps", "finding"),
)
"""Columns of the table of ratios, see `PairedComparison.table_row`."""


@dataclass(frozen=True)
class PairedComparison:
    """Step time ratio second/first of two configurations on the same steps of equal QP size.

    `leaders` names the faster one by each yardstick; where they differ the order is unstable.
    first_ns, second_ns : geometric mean step time of each on these steps [ns].
    sequences : the replays that these steps are of.
    slower_steps : those of `steps` in which the second takes longer.
    separate : why there is no ratio, as they were not interleaved; "" where they were.
    spread : slowest over fastest round, the larger of both, where other load disturbed one; else 1.
    """

    first: str
    second: str
    variables: float
    ratio: Interval
    steps: int
    leaders: dict[str, str]
    first_ns: float
    second_ns: float
    separate: str = ""
    spread: float = 1.0
    sequences: tuple[str, ...] = ()
    slower_steps: int = 0

    @property
    def is_tied(self) -> bool:
        """True if the time ratio's interval contains 1, so that neither solver is faster."""
        return self.ratio.contains(1.0)

    @property
    def is_within_spread(self) -> bool:
        """True if `spread` can explain the time ratio: its interval overlaps 1/spread to spread."""
        return self.ratio.is_within_spread(self.spread)

    @property
    def is_unstable(self) -> bool:
        """True if it depends on the measure which of two configurations is faster."""
        by_ratio = {self.second if self.ratio.high < 1.0 else self.first}
        return len({*self.leaders.values()} | (set() if self.is_tied else by_ratio)) > 1

    @property
    def is_of_one_run(self) -> bool:
        """True if all times are the same: settings without effect are two names of one run."""
        return self.ratio.value == 1.0 and not math.isfinite(self.ratio.high)

    @property
    def finding_text(self) -> str:
        """Finding in a word or two: the second is slower or faster, or why it is neither."""
        if self.separate:
            return self.separate
        if self.is_of_one_run:
            return "one run"
        if not math.isfinite(self.ratio.high):
            return TOO_FEW_STEPS
        if self.is_tied:
            return "tied"
        if self.is_unstable:
            return UNSTABLE
        if self.is_within_spread:
            return MACHINE_DISTURBED
        return "faster" if self.ratio.high < 1.0 else "slower"

    @property
    def table_row(self) -> dict[str, Any]:
        """Table row: names of both configurations, time ratio with interval, and the finding."""
        ratio = {"ratio": self.ratio.value, "low": self.ratio.low, "high": self.ratio.high}
        names = {"first": self.first, "second": self.second}
        size = {"variables": self.variables, "sequences": ";".join(self.sequences)}
        times = {"first_us": self.first_ns / 1e3, "second_us": self.second_ns / 1e3}
        return names | size | ratio | times | {"steps": self.steps, "finding": self.finding_text}


def match_times_by_step(first: StepTimes, second: StepTimes) -> tuple[Floats, Floats]:
    """Return the step times of two configurations on the steps that both have done."""
    if np.array_equal(first.k, second.k):
        return first.algo_ns, second.algo_ns
    _, in_first, in_second = np.intersect1d(first.k, second.k, return_indices=True)
    return first.algo_ns[in_first], second.algo_ns[in_second]


TimedReplay = tuple[RunRecord, StepTimes]


def compute_log_ratio_with_half_width(
    first: Mapping[int, TimedReplay], second: Mapping[int, TimedReplay], sizes: Mapping[int, float]
) -> tuple[float, float]:
    """Return two configurations' log time ratio on their largest common QPs, and its half-width.

    NaN if unknown. first, second : replays by their index; sizes : the variables of each.
    """
    logs: dict[float, list[Floats]] = {}
    for p in first.keys() & second.keys():
        (one, one_times), (other, other_times) = first[p], second[p]
        first_ns, second_ns = match_times_by_step(one_times, other_times)
        if len(first_ns) and not one.explain_separate_timing(other):
            logs.setdefault(sizes[p], []).append(np.log(second_ns / first_ns))
    ratio = estimate_pooled_ratio(logs[max(logs)]) if logs else UNKNOWN
    if not (ratio.low > 0.0 and ratio.high < math.inf):
        return math.nan, math.nan
    return math.log(ratio.value), 0.5 * math.log(ratio.high / ratio.low)


def compare_paired_times(
    records: Records, first: Verdict, second: Verdict
) -> list[PairedComparison]:
    """Return two configurations' step time ratios on the QP sequences that both replayed.

    One comparison for each number of variables, the fewest first: the ratio depends on the size.
    Sequences of one size have equal weight; `first` has the smaller limiting p99, or the smaller
    longest step if there is none.
    """
    label = first.configuration.label
    tail = {"limiting p99" if math.isfinite(first.p99_ns) else "longest step": label}
    found = compare_configurations(records, first.configuration, second.configuration, ())
    return [replace(one, leaders=one.leaders | tail) for one in found]


def compare_configurations(
    records: Records,
    first: Configuration,
    second: Configuration,
    percentiles: Sequence[float] = (99.0,),
) -> list[PairedComparison]:
    """Return two configurations' step time ratios on common replays, the smallest QPs first.

    percentiles : step times that name a leader beside the median, where a replay supports them.
    """
    found = [
        common
        for sequence in records.sequences
        if (common := _find_common_times(records, sequence, first, second)) is not None
    ]
    by_size = group_by_key(found, lambda common: common.variables)
    return [
        _compare_on_size(by_size[size], (first.label, second.label), percentiles)
        for size in sorted(by_size)
    ]


def _compare_on_size(
    found: Sequence["_CommonTimes"], names: tuple[str, str], percentiles: Sequence[float]
) -> PairedComparison:
    """Return the comparison of two configurations on replays of one size of QP.

    Of replays that were interleaved, if there are any.
    """
    paired = [common for common in found if not common.separate]
    leaders: dict[str, str] = {}
    for common in paired:
        for percent in (50.0, *percentiles):
            ends = [percentile_or_nan(ns, percent) for ns in (common.first_ns, common.second_ns)]
            measure = "median" if percent == 50.0 else f"p{percent:g}"
            if math.isfinite(ends[0]):
                leaders[f"{measure} on `{common.sequence}`"] = names[int(ends[0] > ends[1])]
    used = paired or found
    logs = [np.log(common.second_ns / common.first_ns) for common in used]
    means_ns = [
        math.exp(float(np.mean([np.log(ns).mean() for ns in select_long_series(series)])))
        for series in ([one.first_ns for one in used], [one.second_ns for one in used])
    ]
    long = {id(one) for one in select_long_series(logs)}
    return PairedComparison(
        *names,
        found[0].variables,
        estimate_pooled_ratio(logs) if paired else UNKNOWN,
        sum(map(len, select_long_series(logs))),
        leaders,
        first_ns=means_ns[0],
        second_ns=means_ns[1],
        separate="" if paired else found[0].separate,
        spread=max(common.spread for common in used),
        sequences=tuple(
            one.sequence for one, log in zip(used, logs, strict=True) if id(log) in long
        ),
        slower_steps=sum(int((log > 0.0).sum()) for log in select_long_series(logs)),
    )


def count_common_window_steps(records: Records, first: Verdict, second: Verdict) -> int:
    """Return how many steps two configurations both solved in windows."""
    replays = records.select_runs(mode="replay")
    windows = {run.sequence for run in replays if run.steps_searched_for_hardest}
    pair = first.configuration, second.configuration
    found = (_find_common_times(records, name, *pair) for name in windows)
    return sum(len(common.first_ns) for common in found if common is not None)


@dataclass(frozen=True, eq=False)
class _CommonTimes:
    """Step times (K,) [ns] of two configurations on the steps of a replay that both have done."""

    sequence: str
    variables: float
    first_ns: Floats
    second_ns: Floats
    separate: str
    spread: float


def _find_common_times(
    records: Records, sequence: str, first: Configuration, second: Configuration
) -> _CommonTimes | None:
    """Return two configurations' times on the common steps of a QP sequence; None without any."""
    runs = [_find_replay(records, sequence, wanted) for wanted in (first, second)]
    times = [None if run is None else records.get_step_times(run) for run in runs]
    if runs[0] is None or runs[1] is None or times[0] is None or times[1] is None:
        return None
    both = match_times_by_step(times[0], times[1])
    if not len(both[0]):
        return None
    separate = runs[0].explain_separate_timing(runs[1])
    spread = max(map(partial(compute_round_spread, records), runs, times))
    return _CommonTimes(sequence, runs[0].n, *both, separate, spread)


def find_faster_inconclusive(
    records: Records, verdicts: Verdicts, chosen: Verdict
) -> list[Verdict]:
    """Return configurations of inconclusive verdict that are surely faster than the chosen one.

    Those without anything against the requirements.
    """
    unsettled = [v for v in verdicts.all_verdicts if v.state == "inconclusive" and v.timed_on]
    compared = [(compare_paired_times(records, chosen, verdict), verdict) for verdict in unsettled]
    faster = [
        (max(one.ratio.value for one in sizes), verdict)
        for sizes, verdict in compared
        if sizes and all(one.ratio.high < 1.0 / one.spread for one in sizes)
    ]
    ordered = (verdict for _, verdict in sorted(faster, key=lambda pair: pair[0]))
    return list(map_first_by_key(ordered, lambda verdict: verdict.configuration.solver).values())


def _find_replay(records: Records, sequence: str, wanted: Configuration) -> RunRecord | None:
    """Return a configuration's replay of a QP sequence; None without one."""
    replays = records.select_replays(sequence)
    alike = (run for run in replays if run.configuration.moved_to_common_formulation == wanted)
    return next(alike, None)


def compare_settings_of_solvers(records: Records) -> list[PairedComparison]:
    """Return step time ratios of each solver's settings to the first of them, in one call mode.

    The first is `default` where it was timed, else the preset of the largest tolerance, else the
    first by `sort_key_of_settings`. Settings that no common step was timed of have no ratio.
    """
    replays = records.select_runs(mode="replay", units="scaled")
    configurations = dict.fromkeys(
        run.configuration.moved_to_common_formulation
        for run in replays
        if records.get_step_times(run) is not None
    )
    modes = group_by_key(configurations, lambda c: (c.solver, c.route, c.policy))
    found: list[PairedComparison] = []
    for alike in modes.values():
        first, *others = sorted(alike, key=lambda c: sort_key_of_settings(c.settings))
        for other in others:
            found += compare_configurations(records, first, other)
    return found
