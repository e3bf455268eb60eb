"""The steps of a run, one value each: over the rounds that count, and the hardest of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.bench.judge.rules import decided, failed_steps

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
Measure = Literal["time", "iterations", "error"]
MEASURES: tuple[Measure, ...] = ("time", "iterations", "error")
_FLOATS = ("total_ns", "error_move", "iterations", "n_active")
_FLAGS = ("claimed", "late", "fallback", "clipped")


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
    rounds : how many there are; rows : (K,) the last row of each step in the step table.
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
    rows: Ints


@dataclass(frozen=True)
class HardStep:
    """A step of a run and what made it hard: its least time [ns], its most iterations or error."""

    measure: Measure
    value: float
    at: int
    """Where it stands in the arrays of `RunSteps`."""


def run_steps(steps: pd.DataFrame) -> Iterator[tuple[str, RunSteps]]:
    """Every run of a step table that left a counting row, in the order of the table.

    The table is turned into arrays once: a million rows take a second or two.
    """
    counts = steps["counts"].to_numpy(dtype=np.bool_)
    rows = np.flatnonzero(counts)
    if not len(rows):
        return
    table = steps.loc[counts]
    columns = {name: _floats(table, name) for name in _FLOATS}
    flags = {name: table[name].to_numpy(dtype=np.bool_) for name in _FLAGS}
    known = decided(table).to_numpy(dtype=np.bool_)
    flags["true"] = table["true"].to_numpy(dtype=np.bool_) | ~known
    flags["failed"] = failed_steps(table).to_numpy(dtype=np.bool_)
    k, status = table["k"].to_numpy(dtype=np.int64), table["status"].to_numpy(dtype=object)
    repeat = table["repeat"].to_numpy(dtype=np.int64)
    names, codes = np.unique(table["run_id"].to_numpy(dtype=object), return_inverse=True)
    edges = np.flatnonzero(np.diff(codes)) + 1
    for part in np.split(np.arange(len(k)), edges):
        rounds = len(np.unique(repeat[part]))
        yield str(names[codes[part[0]]]), _one(part, k, columns, flags, status, rows, rounds)


def _one(
    part: Ints,
    k: Ints,
    columns: Mapping[str, Floats],
    flags: Mapping[str, Flags],
    status: NDArray[np.object_],
    rows: Ints,
    rounds: int,
) -> RunSteps:
    """The run whose rows are `part` of the arrays."""
    steps, at = np.unique(k[part], return_inverse=True)
    last = np.zeros(len(steps), dtype=np.int64)
    last[at] = part
    error = _over(np.fmax, at, len(steps), columns["error_move"][part])
    said = last.copy()
    worst = columns["error_move"][part] == error[at]
    said[at[worst]] = part[worst]
    return RunSteps(
        k=steps,
        time_ns=_over(np.fmin, at, len(steps), columns["total_ns"][part]),
        raw_ns=_over(np.fmax, at, len(steps), columns["total_ns"][part]),
        error=error,
        iterations=_over(np.fmax, at, len(steps), columns["iterations"][part]),
        n_active=_over(np.fmax, at, len(steps), columns["n_active"][part]),
        **{name: values[last] for name, values in flags.items()},
        status=status[said],
        rounds=rounds,
        rows=rows[last],
    )


def hardest(run: RunSteps, measure: Measure, count: int = 5) -> list[HardStep]:
    """The hardest steps of a run, the hardest first; those without a figure are none of them."""
    values = {"time": run.time_ns, "iterations": run.iterations, "error": run.error}[measure]
    there = np.flatnonzero(~np.isnan(values))
    order = there[np.argsort(-values[there], kind="stable")][:count]
    return [HardStep(measure, float(values[i]), int(i)) for i in order]


def _floats(table: pd.DataFrame, name: str) -> Floats:
    return table[name].to_numpy(dtype=np.float64, na_value=np.nan)


def _over(choose: np.ufunc, at: Ints, count: int, values: Floats) -> Floats:
    """Of each step the least or largest value that is there; NaN for none."""
    out = np.full(count, np.nan)
    choose.at(out, at, values)
    return out
