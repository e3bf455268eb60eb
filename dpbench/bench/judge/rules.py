"""The rules of judging and counting, each of them once (method.md sections 1 and 2).

Which rounds of a replay count, when a percentile is supported, which steps have a right answer that
is known, what a failed step is, and what a false claim is. The step table has a column `counts`, so
whoever reads it asks nobody. Steps are the columns of `step_columns.py`, or those of
`steps.parquet`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.arrays import Flags, Floats
from dpbench.bench.record.schema import ABSENT
from dpbench.qp.solution import Status

StepColumns = dict[str, NDArray[Any]]
"""(N,) arrays by the names of `STEP_COLUMNS`, all but `run_id`."""
Steps = Mapping[str, NDArray[Any]] | pd.DataFrame
"""Columns of steps by name: (N,) arrays, or a table."""

WARM_UP = 0
"""The round of a replay that never counts."""
DISTURBED_FACTOR = 1.25
"""A round whose reference kernel took this much longer than the configuration's best is marked
disturbed."""
LEAST_PROCESSORS = 4.0
"""Processes that share a core with a busy worker, at most, itself included."""
BEYOND = 10
"""So many samples have to lie beyond a percentile before it is printed."""

INFEASIBLE, UNDECIDED, UNCERTIFIED = "infeasible", "undecided", "none"
"""Certificates of steps without an optimum: proven to have no feasible point; feasible or not only
by rounding, which is charged to nobody; nothing is proven."""
NO_ANSWER_CLAIMS = tuple(status.name for status in Status if status.denies_optimum)
"""Status names of the claims that there is no optimum."""
_UNFINISHED = tuple(status.name for status in Status if status.is_unfinished)
_NO_USE = tuple(status.name for status in Status if not status.usable)


def is_ranked(concurrency: float, machine_id: str, of_folder: str) -> bool:
    """Whether the times of a replay may stand beside those of others: taken with its machine to
    itself, and on the machine of its result folder.

    Parameters
    ----------
    concurrency : the column of that name; NaN where no times are compared, and in folders from
        before it was recorded, when all were taken alone.
    machine_id : of the run; of_folder : of `machine.json`.
    """
    return bool(np.isnan(concurrency)) or (concurrency <= 1.0 and machine_id == of_folder)


def explained_by(switches: float, timed_share: float) -> int:
    """Return how many late timings involuntary context switches may explain.

    A switch comes at any moment of the process's own time. A process gets at least a quarter of a
    core, so at most four times `timed_share` of that time is spent in timed calls. Three standard
    deviations of a Poisson count are added.

    Parameters
    ----------
    timed_share : base time of the timed calls over the wall time of the run; NaN where that is not
        known, which leaves all switches as an explanation.
    """
    hits = switches * (1.0 if math.isnan(timed_share) else min(1.0, LEAST_PROCESSORS * timed_share))
    return int(min(switches, math.ceil(hits + 3.0 * math.sqrt(hits))))


def is_disturbed(reference_kernel_ns: Floats) -> Flags:
    """(R,) in which rounds the reference kernel was slowed by more than `DISTURBED_FACTOR`.

    Parameters
    ----------
    reference_kernel_ns : (R, 2) the kernel before and after each round [ns], 0 where it was not
        timed.
    """
    seen = reference_kernel_ns[reference_kernel_ns > 0]
    best = seen.min() if seen.size else np.inf
    # Where it was not timed it is zero, and slower than nothing.
    slowed: Flags = reference_kernel_ns.max(axis=1) > DISTURBED_FACTOR * best
    return slowed


def disturbed_rounds(rounds: NDArray[np.int32], reference_kernel_ns: Floats) -> NDArray[np.int32]:
    """Of `rounds` (R,) those that are disturbed, by their `reference_kernel_ns` (R, 2); see
    `is_disturbed`."""
    return rounds[is_disturbed(reference_kernel_ns)]


def counting_rows(repeat: NDArray[np.int32], disturbed: Flags) -> Flags:
    """(N,) which rows of a replay count: never the warm-up, and no disturbed round.

    Where every round is disturbed all of them count but the warm-up, and `counting_disturbed` of
    `runs.parquet` says so.

    Parameters
    ----------
    repeat : (N,) round of each row; disturbed : (N,) whether it is a disturbed one.
    """
    rounds: Flags = repeat != WARM_UP
    undisturbed = rounds & ~disturbed
    return undisturbed if undisturbed.any() else rounds


def supports(samples: int, percent: float) -> bool:
    """Whether `samples` are enough for a percentile: at least `BEYOND` lie beyond it."""
    return samples * (100.0 - percent) / 100.0 >= BEYOND - 1e-9


def percentile(values: Floats, percent: float) -> float:
    """The percentile, or NaN when the samples do not support it."""
    if not supports(len(values), percent):
        return float(np.nan)
    return float(np.percentile(values, percent))


def median(values: Floats | Sequence[float]) -> float:
    """The median of the values that are there; NaN where none is."""
    known = _known(values)
    return float(np.median(known)) if len(known) else float(np.nan)


def largest(values: Floats | Sequence[float]) -> float:
    """The largest of the values that are there; NaN where none is."""
    known = _known(values)
    return float(known.max()) if len(known) else float(np.nan)


def _known(values: Floats | Sequence[float]) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    return array[~np.isnan(array)]


def decided(steps: Steps) -> Flags:
    """(N,) steps whose right answer is known: an optimum, or that no point is feasible."""
    return ~_among(steps, "certificate", (UNCERTIFIED, UNDECIDED))


def failed_steps(steps: Steps) -> Flags:
    """(N,) steps with a fallback though there was an answer to give, or with an unfinished iterate.

    A QP without a feasible point has no answer to give; an iterate that is given all the same
    fails. A step that is undecided at rounding never does.
    """
    infeasible = _among(steps, "certificate", (INFEASIBLE,))
    failed = (_flags(steps, "fallback") & ~infeasible) | _flags(steps, "unconverged")
    return failed & ~_among(steps, "certificate", (UNDECIDED,))


def steps_with_answers(steps: StepColumns, slowdown: float) -> StepColumns:
    """Return the steps with an answer to judge, of a computer that much slower; an answer that is
    late is not for that reason a failed one."""
    if slowdown == 0.0:
        return steps
    answered = select_rows(steps, steps["total_ns"] > ABSENT)
    return answered | {"fallback": unusable(answered)}


def select_rows(steps: StepColumns, rows: Flags) -> StepColumns:
    """Return some of the rows."""
    return {name: column[rows] for name, column in steps.items()}


def claimed_not_true(steps: Steps) -> Flags:
    """(N,) steps claimed solved that are not; where the right answer is not known, no claim is
    false."""
    return _flags(steps, "claimed") & ~_flags(steps, "true") & decided(steps)


def true_not_claimed(steps: Steps) -> Flags:
    """(N,) steps with a true optimum that its solver did not claim."""
    said_none = _among(steps, "status", NO_ANSWER_CLAIMS)
    return _flags(steps, "true") & ~_flags(steps, "claimed") & ~said_none & decided(steps)


def unusable(steps: Steps) -> Flags:
    """(N,) steps whose answer is none that a closed loop could apply: by its status, or not
    finite."""
    infinite: Flags = np.isinf(steps["error_plan"]) | np.isinf(steps["primal"])
    return _among(steps, "status", _NO_USE) | np.asarray(infinite)


def unfinished(steps: Steps) -> Flags:
    """(N,) steps whose answer, where it can be applied at all, is an unfinished iterate."""
    return _among(steps, "status", _UNFINISHED)


def errors(steps: Steps) -> Floats:
    """(N,) the error of the first move of each step, in rate-limit steps; of a cascade the larger
    of that of its force and that of its thrusters."""
    of_move = np.asarray(steps["error_move"])
    if "allocation_error" not in steps:
        return of_move
    larger: Floats = np.fmax(of_move, np.asarray(steps["allocation_error"]))
    return larger


def _flags(steps: Steps, name: str) -> Flags:
    return np.asarray(steps[name], dtype=np.bool_)


def _among(steps: Steps, name: str, values: tuple[str, ...]) -> Flags:
    """(N,) where a column of words has one of `values`."""
    column = steps[name]
    if isinstance(column, pd.Series):
        return column.isin(values).to_numpy(dtype=np.bool_)
    among: Flags = np.isin(column, values)
    return among
