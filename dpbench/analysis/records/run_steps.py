"""Steps of runs from the rows that count: one value a step over the rounds, and the hardest.

A table of many runs is turned into arrays at once; a run is then a slice of them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
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
    *("run_id", "repeat", "k", "counts", "total_ns", "iterations", "error_move", "n_active"),
    *("certificate", "status", "fallback", "unconverged", *_COUNTING_FLAGS[:3], "clipped"),
)


def extract_counting_rows(steps: pd.DataFrame) -> CountingRows:
    """Convert a step table to arrays, without warm-up and disturbed repetitions."""
    counts = steps["counts"].to_numpy(dtype=np.bool_)
    arrays: dict[str, NDArray[np.generic]] = {
        "known": mask_decided_steps(steps)[counts],
        "failed": mask_failed_steps(steps)[counts],
    }
    for name in ("run_id", "status"):
        # One object a name, not one a row.
        codes, names = pd.factorize(steps[name])
        arrays[name] = np.asarray(names, dtype=object)[codes[counts]]
    for field in fields(CountingRows):
        if field.name in arrays:
            continue
        column = steps[field.name]
        if field.name in _COUNTING_FLAGS:
            arrays[field.name] = column.to_numpy(dtype=np.bool_)[counts]
        elif field.name in _INTS:
            arrays[field.name] = column.to_numpy(dtype=np.int64)[counts]
        else:
            arrays[field.name] = column.to_numpy(dtype=np.float64, na_value=np.nan)[counts]
    return CountingRows(**arrays)  # type: ignore[arg-type] # each array has its field's type, made so above


Measure = Literal["time", "iterations", "error"]
MEASURES: tuple[Measure, ...] = ("time", "iterations", "error")
_FLAGS = ("claimed", "failed", "late", "fallback", "clipped")


@dataclass(frozen=True, eq=False)
class RunSteps:
    """Steps (K,) of one run merged over its repetitions, rising in k.

    time_ns, raw_ns : least and largest time; error, iterations : the largest, NaN without one.
    n_active : active limits at the optimum.
    claimed, true, failed, late, fallback, clipped : of the last round; an answer without a known
        right one counts as true.
    status : of the round of the largest error, else of the last; rounds : how many there are.
    """

    k: Ints
    time_ns: Floats
    raw_ns: Floats
    error: Floats
    iterations: Floats
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
    """Merge a run's repetitions: least and largest time, and largest error, of each step."""
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
