"""The rows of a step table that count, as plain arrays: where questions about steps start.

A table of many runs is turned into arrays at once, some tenths of a second for a million rows; a
run is then a slice of them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.arrays import Flags, Floats, Ints
from dpbench.bench.judge.rules import decided, failed_steps
from dpbench.bench.record.recorded_steps import places_of


@dataclass(frozen=True, eq=False)
class CountingRows:
    """(N,) arrays over the rows that count, ordered by run; a missing number is NaN.

    Parameters
    ----------
    run_id, repeat, k : run, round and step.
    total_ns, iterations, error_move, n_active : as in the step table.
    known : whether the right answer is known; true : whether this one is, by the referee.
    failed : see `failed_steps`; claimed, late, fallback, clipped, status : as in the step table.
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
    def bounds(self) -> dict[str, tuple[int, int]]:
        """First row of each run, and the one after its last."""
        return places_of(self.run_id)

    def of(self, run_id: str) -> CountingRows:
        """The rows of one run; none when it left none."""
        first, end = self.bounds.get(run_id, (0, 0))
        return CountingRows(*(getattr(self, f.name)[first:end] for f in fields(self)))


_FLAGS = ("true", "claimed", "late", "fallback", "clipped")
_INTS = ("repeat", "k")
COLUMNS = (
    *("run_id", "repeat", "k", "counts", "total_ns", "iterations", "error_move", "n_active"),
    *("certificate", "status", "fallback", "unconverged", *_FLAGS[:3], "clipped"),
)
"""What `counting_of` asks of a step table."""


def counting_of(steps: pd.DataFrame) -> CountingRows:
    """The rows of a step table that count."""
    counts = steps["counts"].to_numpy(dtype=np.bool_)
    arrays: dict[str, NDArray[np.generic]] = {
        "known": decided(steps)[counts],
        "failed": failed_steps(steps)[counts],
    }
    for name in ("run_id", "status"):
        # One object a name, not one a row.
        codes, names = pd.factorize(steps[name])
        arrays[name] = np.asarray(names, dtype=object)[codes[counts]]
    for field in fields(CountingRows):
        if field.name in arrays:
            continue
        column = steps[field.name]
        if field.name in _FLAGS:
            arrays[field.name] = column.to_numpy(dtype=np.bool_)[counts]
        elif field.name in _INTS:
            arrays[field.name] = column.to_numpy(dtype=np.int64)[counts]
        else:
            arrays[field.name] = column.to_numpy(dtype=np.float64, na_value=np.nan)[counts]
    return CountingRows(**arrays)  # type: ignore[arg-type] # each array has its field's type, made so above
