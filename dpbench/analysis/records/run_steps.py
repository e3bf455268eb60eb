"""The steps of a run, one value each: over the rounds that count, and the hardest of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dpbench.analysis.records.counting_rows import CountingRows
from dpbench.arrays import Flags, Floats, Ints

Measure = Literal["time", "iterations", "error"]
MEASURES: tuple[Measure, ...] = ("time", "iterations", "error")
_FLAGS = ("claimed", "failed", "late", "fallback", "clipped")


@dataclass(frozen=True, eq=False)
class RunSteps:
    """One run by step, from the rows that count.

    Parameters
    ----------
    k : (K,) the steps, rising; time_ns, raw_ns : (K,) least and largest time over the rounds.
    error, iterations : (K,) the largest over them, NaN where there is none.
    n_active : (K,) active limits at the optimum.
    claimed, true, failed, late, fallback, clipped : (K,) of the last round; an answer whose right
        one is not known is taken as true.
    status : (K,) what the solver said in the round of the largest error, else in the last.
    rounds : how many there are.
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

    def values(self, measure: Measure) -> Floats:
        """(K,) what makes a step hard by a measure."""
        return {"time": self.time_ns, "iterations": self.iterations, "error": self.error}[measure]

    def at(self, places: Ints) -> RunSteps:
        """Some of the steps alone."""
        arrays = [f.name for f in fields(self) if f.name != "rounds"]
        return RunSteps(**{n: getattr(self, n)[places] for n in arrays}, rounds=self.rounds)


@dataclass(frozen=True)
class HardStep:
    """A step of a run and what made it hard: its least time [ns], its most iterations or error."""

    measure: Measure
    value: float
    at: int
    """Where it stands in the arrays of `RunSteps`."""


def run_steps(counting: CountingRows) -> Iterator[tuple[str, RunSteps]]:
    """Every run that left a counting row, in the order of the table."""
    for run_id in counting.bounds:
        yield run_id, _one(counting.of(run_id))


def _one(rows: CountingRows) -> RunSteps:
    """The steps of the rows of one run."""
    steps, at = np.unique(rows.k, return_inverse=True)
    last = np.zeros(len(steps), dtype=np.int64)
    last[at] = np.arange(len(at))
    error = _over(np.fmax, at, len(steps), rows.error_move)
    said = last.copy()
    worst = np.flatnonzero(rows.error_move == error[at])
    said[at[worst]] = worst
    flags = {name: getattr(rows, name)[last] for name in _FLAGS}
    return RunSteps(
        k=steps,
        time_ns=_over(np.fmin, at, len(steps), rows.total_ns),
        raw_ns=_over(np.fmax, at, len(steps), rows.total_ns),
        error=error,
        iterations=_over(np.fmax, at, len(steps), rows.iterations),
        n_active=_over(np.fmax, at, len(steps), rows.n_active),
        true=(rows.true | ~rows.known)[last],
        **flags,
        status=rows.status[said],
        rounds=len(np.unique(rows.repeat)),
    )


def hardest(run: RunSteps, measure: Measure, count: int = 5) -> list[HardStep]:
    """The hardest steps of a run, the hardest first; those without a figure are none of them."""
    values = run.values(measure)
    there = np.flatnonzero(~np.isnan(values))
    if len(there) > count:
        # Only those that reach the least of the hardest have to be put in order.
        least = np.partition(values[there], -count)[-count]
        there = there[values[there] >= least]
    order = there[np.argsort(-values[there], kind="stable")][:count]
    return [HardStep(measure, float(values[i]), int(i)) for i in order]


def _over(choose: np.ufunc, at: Ints, count: int, values: Floats) -> Floats:
    """Of each step the least or largest value that is there; NaN for none."""
    out = np.full(count, np.nan)
    choose.at(out, at, values)
    return out
