"""Steps of runs as arrays: one value a step over the rounds, the hardest, step times and delays.

A table of many runs is turned into arrays at once; a run is then a slice of them.
A delay is a single timing that took much longer than its step does.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.arrays import Flags, Floats, Ints
from dpbench.bench.judge.rules import mask_decided_steps, mask_failed_steps
from dpbench.bench.record.recorded_steps import find_row_ranges_by_label


@dataclass(frozen=True, eq=False)
class CountingRows:
    """Arrays (N,) of all valid step rows of several runs, ordered by run; NaN where missing.

    known : whether the right answer is known; true : whether this one is, by the referee.
    failed : see `failed_steps`; the others as in the step table.
    """

    run_id: NDArray[np.object_]
    repeat: Ints
    k: Ints
    total_ns: Floats
    iterations: Floats
    error_move: Floats
    primal: Floats
    n_active: Floats
    known: Flags
    true: Flags
    failed: Flags
    claimed: Flags
    late: Flags
    fallback: Flags
    clipped: Flags
    status: NDArray[np.object_]

    def __len__(self) -> int:
        return len(self.k)

    @cached_property
    def row_range_by_run(self) -> dict[str, tuple[int, int]]:
        """First and one-past-last row index of each run, by run id."""
        return find_row_ranges_by_label(self.run_id)

    def select_run(self, run_id: str) -> "CountingRows":
        """Return the step arrays of one run only; empty where it has none."""
        first, end = self.row_range_by_run.get(run_id, (0, 0))
        return CountingRows(*(getattr(self, f.name)[first:end] for f in fields(self)))


_COUNTING_FLAGS = ("true", "claimed", "late", "fallback", "clipped")
_INTS = ("repeat", "k")
COUNTING_COLUMNS = (
    *(
        "run_id",
        "repeat",
        "k",
        "counts",
        "total_ns",
        "iterations",
        "error_move",
        "primal",
        "n_active",
    ),
    *("certificate", "status", "fallback", "unconverged", *_COUNTING_FLAGS[:3], "clipped"),
)


def extract_counting_rows(steps: pd.DataFrame) -> CountingRows:
    """Return a step table as arrays, without warm-up and disturbed repetitions."""
    counts = steps["counts"].to_numpy(dtype=np.bool_)
    arrays: dict[str, NDArray[np.generic]] = {
        "known": mask_decided_steps(steps)[counts],
        "failed": mask_failed_steps(steps)[counts],
    }
    for name in ("run_id", "status"):
        # One object a name, not one a row.
        codes, names = pd.factorize(steps[name])
        arrays[name] = np.asarray(names, dtype=object)[codes[counts]]
    for each in fields(CountingRows):
        if each.name in arrays:
            continue
        column = steps[each.name]
        if each.name in _COUNTING_FLAGS:
            arrays[each.name] = column.to_numpy(dtype=np.bool_)[counts]
        elif each.name in _INTS:
            arrays[each.name] = column.to_numpy(dtype=np.int64)[counts]
        else:
            arrays[each.name] = column.to_numpy(dtype=np.float64, na_value=np.nan)[counts]
    return CountingRows(**arrays)  # type: ignore[arg-type] # each array has its field's type, made so above


Measure = Literal["time", "iterations", "error"]
MEASURES: tuple[Measure, ...] = ("time", "iterations", "error")
_FLAGS = ("claimed", "failed", "late", "fallback", "clipped")


@dataclass(frozen=True, eq=False)
class RunSteps:
    """Steps (K,) of one run merged over its repetitions, rising in k.

    time_ns, raw_ns : least and largest time; error, iterations : the largest, NaN without one.
    violation : largest of a limit, scaled, of the last round; n_active : active limits at the
        optimum.
    claimed, true, failed, late, fallback, clipped : of the last round; an answer without a known
        right one counts as true.
    status : of the round of the largest error, else of the last; rounds : how many there are.
    """

    k: Ints
    time_ns: Floats
    raw_ns: Floats
    error: Floats
    iterations: Floats
    violation: Floats
    n_active: Floats
    claimed: Flags
    true: Flags
    failed: Flags
    late: Flags
    fallback: Flags
    clipped: Flags
    status: NDArray[np.object_]
    rounds: int

    def get_values_of_measure(self, measure: Measure) -> Floats:
        """Return the times [ns], iterations or errors of all steps (K,), by measure."""
        return {"time": self.time_ns, "iterations": self.iterations, "error": self.error}[measure]

    def select_steps(self, places: Ints) -> "RunSteps":
        """Return a copy of a run's steps with only those at the given indices."""
        arrays = [f.name for f in fields(self) if f.name != "rounds"]
        return RunSteps(**{n: getattr(self, n)[places] for n in arrays}, rounds=self.rounds)


def yield_merged_steps_by_run(counting: CountingRows) -> Iterator[tuple[str, RunSteps]]:
    """Yield each run's id and its steps merged over repetitions, in table order."""
    for run_id in counting.row_range_by_run:
        yield run_id, _merge_repetitions(counting.select_run(run_id))


def _merge_repetitions(rows: CountingRows) -> RunSteps:
    """Return a run's steps, each with its least and largest time and largest error."""
    steps, at = np.unique(rows.k, return_inverse=True)
    last = np.zeros(len(steps), dtype=np.int64)
    last[at] = np.arange(len(at))
    error = _reduce_repetitions_by_step(np.fmax, at, len(steps), rows.error_move)
    said = last.copy()
    worst = np.flatnonzero(rows.error_move == error[at])
    said[at[worst]] = worst
    flags = {name: getattr(rows, name)[last] for name in _FLAGS}
    return RunSteps(
        k=steps,
        time_ns=_reduce_repetitions_by_step(np.fmin, at, len(steps), rows.total_ns),
        raw_ns=_reduce_repetitions_by_step(np.fmax, at, len(steps), rows.total_ns),
        error=error,
        iterations=_reduce_repetitions_by_step(np.fmax, at, len(steps), rows.iterations),
        violation=rows.primal[last],
        n_active=_reduce_repetitions_by_step(np.fmax, at, len(steps), rows.n_active),
        true=(rows.true | ~rows.known)[last],
        **flags,
        status=rows.status[said],
        rounds=len(np.unique(rows.repeat)),
    )


def find_hardest_steps(run: RunSteps, measure: Measure, count: int = 5) -> Ints:
    """Return the indices of a run's steps of largest time, iterations or error, hardest first."""
    values = run.get_values_of_measure(measure)
    there = np.flatnonzero(~np.isnan(values))
    if len(there) > count:
        # Only those that reach the least of the hardest have to be put in order.
        least = np.partition(values[there], -count)[-count]
        there = there[values[there] >= least]
    return there[np.argsort(-values[there], kind="stable")][:count]


def _reduce_repetitions_by_step(choose: np.ufunc, at: Ints, count: int, values: Floats) -> Floats:
    """Return the minimum or maximum over the repetitions of each step (K,); NaN for none."""
    out = np.full(count, np.nan)
    choose.at(out, at, values)
    return out


TIME_COLUMNS = ("run_id", "repeat", "k", "counts", "total_ns", "waited_ns")


@dataclass(frozen=True, eq=False)
class StepTimes:
    """Step times of one replay: the fastest repetition of each step, and the largest timing.

    k : (K,) steps, rising; algo_ns : (K,) least over the rounds, the algorithmic time.
    net_ns : (K,) least timing less its wait for the core; None where a wait is unknown.
    timings : (K,) timings of each step that count.
    rounds_ns : (R,) median of the samples of each round: how far they differ is the machine's part.
    wait_ns : (K,) wait for the core in the fastest repetition of each step; 0 if unknown.
    """

    k: Ints
    algo_ns: Floats
    net_ns: Floats | None
    timings: Ints
    raw_max_ns: float
    rounds_ns: Floats
    wait_ns: Floats

    @property
    def hardest_wait_ns(self) -> float:
        """Wait for the core in the fastest repetition of the hardest step [ns]; 0 if unknown."""
        return float(self.wait_ns[self.algo_ns.argmax()])


def yield_step_times_by_run(steps: pd.DataFrame) -> Iterator[tuple[str, StepTimes]]:
    """Yield each run's id and its step times, from a table of steps."""
    for run_id, repeat, k, total_ns, waited_ns in _yield_valid_timings_by_run(steps):
        best = _find_least_by_step(k, total_ns)
        done = np.flatnonzero(np.isfinite(best))
        net_ns = _subtract_waits(total_ns, waited_ns)
        net = None if net_ns is None else _find_least_by_step(k, net_ns)[done]
        rounds = np.array([float(np.median(total_ns[repeat == r])) for r in np.unique(repeat)])
        timings = np.bincount(k)[done].astype(np.int64)
        fast = total_ns == best[k]
        wait_ns = _find_least_by_step(k[fast], np.nan_to_num(waited_ns[fast]))[done]
        raw_max_ns = float(total_ns.max())
        yield run_id, StepTimes(done, best[done], net, timings, raw_max_ns, rounds, wait_ns)


def _subtract_waits(total_ns: Floats, waited_ns: Floats) -> Floats | None:
    """Return timings (N,) less their waits for the core; None where any wait is NaN (unknown)."""
    return None if np.isnan(waited_ns).any() else total_ns - waited_ns


def _find_least_by_step(k: Ints, times_ns: Floats) -> Floats:
    """Return the least time of each step from 0 to the largest of `k`; inf without a time."""
    least = np.full(int(k.max()) + 1, np.inf)
    np.minimum.at(least, k, times_ns)
    return least


def _yield_valid_timings_by_run(
    steps: pd.DataFrame,
) -> Iterator[tuple[str, Ints, Ints, Floats, Floats]]:
    """Yield each run's id, and of its valid step rows repetition, step, time and wait [ns]."""
    counting = steps[steps["counts"]]
    repeat, k = (counting[name].to_numpy(dtype=np.int64) for name in ("repeat", "k"))
    total_ns, waited_ns = (
        counting[name].to_numpy(dtype=np.float64, na_value=np.nan)
        for name in ("total_ns", "waited_ns")
    )
    for run_id, (first, end) in find_row_ranges_by_label(counting["run_id"]).items():
        own = slice(first, end)
        yield run_id, repeat[own], k[own], total_ns[own], waited_ns[own]


DELAYED = 2.0
"""A timing over this multiple of the fastest time of its step is a delay."""


@dataclass(frozen=True, eq=False)
class Delays:
    """Timings of one run that took much longer than their step usually does.

    The base time of a timing is the fastest time of its step. In a run of one round it is the
    median over the steps, and every timing above it is a delay. Where the kernel shows how long
    every step waited for the core, only the rest of a timing is compared with limits.

    samples : (R,) timings of each round; base_ns : (R,) sum of their base times, the exposed time.
    step_ns, net_step_ns : median over the timings, and over them less their waits, if known.
    round, delay_ns, own_ns, net_ns : (D,) of each delay the index of its round, its timing, its
        base time, and its timing less the wait for the core, where that is known.
    has_waits : whether the wait of every timing is recorded.
    """

    samples: Ints
    base_ns: Floats
    step_ns: float
    net_step_ns: float
    round: Ints
    delay_ns: Floats
    own_ns: Floats
    net_ns: Floats
    has_waits: bool
    _stalls: dict[float, Ints] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def without_waits(self) -> "Delays":
        """Copy of these delays without the recorded waits for the processor core."""
        return replace(self, net_ns=self.delay_ns, net_step_ns=self.step_ns, has_waits=False)

    def count_late_by_repetition(self, limit_ns: float) -> Ints:
        """Return the number, by repetition (R,), of timings over a limit without their waits."""
        return self._count_chosen_by_repetition(self.net_ns > limit_ns)

    def count_stalls_by_repetition(self, longer_than_ns: float) -> Ints:
        """Return by repetition (R,) the number of timings so far over their step's usual time."""
        if longer_than_ns not in self._stalls:
            chosen = self.net_ns - self.own_ns > longer_than_ns
            self._stalls[longer_than_ns] = self._count_chosen_by_repetition(chosen)
        return self._stalls[longer_than_ns]

    def _count_chosen_by_repetition(self, chosen: Flags) -> Ints:
        """Return the number of selected delays in each repetition (R,) of the run."""
        return np.bincount(self.round[chosen], minlength=len(self.samples)).astype(np.int64)


def yield_delays_by_run(steps: pd.DataFrame) -> Iterator[tuple[str, Delays]]:
    """Yield each run's id and its unusually long timings, from a table of steps."""
    for run_id, repeat, k, total_ns, waited_ns in _yield_valid_timings_by_run(steps):
        yield run_id, find_delays(repeat, k, total_ns, waited_ns)


def find_delays(repeat: Ints, k: Ints, total_ns: Floats, waited_ns: Floats) -> Delays:
    """Return the timings (N,) of a run that took much longer than their step usually does.

    Steps without a computation, NaN, are left out. Where some wait is NaN, none is known.
    """
    timed = ~np.isnan(total_ns)
    repeat, k, total_ns, waited_ns = repeat[timed], k[timed], total_ns[timed], waited_ns[timed]
    net_ns = _subtract_waits(total_ns, waited_ns)
    rounds, index = np.unique(repeat, return_inverse=True)
    middle = float(np.median(total_ns)) if len(total_ns) else np.nan
    if len(rounds) > 1:
        base = _find_least_by_step(k, total_ns)[k]
        delayed = total_ns > DELAYED * base
    else:
        base = np.full(len(total_ns), middle)
        delayed = total_ns > base
    return Delays(
        samples=np.bincount(index, minlength=len(rounds)).astype(np.int64),
        base_ns=np.bincount(index, weights=base, minlength=len(rounds)).astype(np.float64),
        step_ns=middle,
        net_step_ns=float(np.median(net_ns)) if net_ns is not None and len(net_ns) else middle,
        round=index[delayed].astype(np.int64),
        delay_ns=total_ns[delayed],
        own_ns=base[delayed],
        net_ns=(total_ns if net_ns is None else net_ns)[delayed],
        has_waits=net_ns is not None,
    )
