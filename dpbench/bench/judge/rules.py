"""Rules of evaluation and counting, each once (docs/method.md, Accuracy and Times).

Steps are the columns of `make_step_columns`, or those of `steps.parquet`.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dpbench.arrays import Flags, Floats
from dpbench.bench.record.schema import MISSING_INT
from dpbench.qp.solution import Status

StepColumns = dict[str, NDArray[Any]]
"""(N,) arrays by the names of `STEP_COLUMNS`, all but `run_id`."""
Steps = Mapping[str, NDArray[Any]] | pd.DataFrame

WARM_UP = 0
"""The round of a replay that never counts."""
DISTURBED_FACTOR = 1.25
"""Slowdown of the reference kernel beyond which a round is marked disturbed."""
LEAST_PROCESSORS = 4.0
"""Processes that share a core with a busy worker, at most, itself included."""
BEYOND = 10
"""Samples that have to lie beyond a percentile."""
LEAST_STRETCH = 100
"""Steps of a stretch of which a window of its hardest steps has the p99; of fewer the largest."""

INFEASIBLE, UNDECIDED, UNCERTIFIED = "infeasible", "undecided", "none"
"""Certificates of steps without an optimum.

Infeasible is proven; undecided is feasible or not by rounding alone, which counts for no solver; of
the last nothing is proven.
"""
NO_ANSWER_CLAIMS = tuple(status.name for status in Status if status.claims_no_optimum_exists)
"""Status names of the claims that there is no optimum."""
_UNFINISHED = tuple(status.name for status in Status if status.is_applied_though_unfinished)
_NO_USE = tuple(status.name for status in Status if not status.is_usable)


def has_comparable_times(concurrency: float, machine_id: str, of_folder: str) -> bool:
    """Return whether a replay's times may be compared with those of other replays in the folder.

    They are taken one cell at a time (`concurrency`, NaN where unknown), on the machine
    `of_folder`.
    """
    return bool(np.isnan(concurrency)) or (concurrency <= 1.0 and machine_id == of_folder)


def count_explained_late_timings(switches: float, timed_share: float) -> int:
    """Return how many late step times involuntary context switches may explain.

    A process gets at least a quarter of a core, so at most four times `timed_share`, the base time
    of timed calls over the wall time, is spent in timed calls; all of it where that is NaN. Three
    standard deviations of a Poisson count are added.
    """
    hits = switches * (1.0 if math.isnan(timed_share) else min(1.0, LEAST_PROCESSORS * timed_share))
    return int(min(switches, math.ceil(hits + 3.0 * math.sqrt(hits))))


def mask_disturbed_rounds(reference_kernel_ns: Floats) -> Flags:
    """Return a mask (R,) of the replay rounds in which the machine-speed test ran too slowly.

    `reference_kernel_ns` (R, 2) is before and after each round [ns], 0 where it was not timed.
    """
    seen = reference_kernel_ns[reference_kernel_ns > 0]
    best = seen.min() if seen.size else np.inf
    # Where it was not timed it is zero, and slower than nothing.
    slowed: Flags = reference_kernel_ns.max(axis=1) > DISTURBED_FACTOR * best
    return slowed


def mask_counted_rows(repeat: NDArray[np.int32], disturbed: Flags) -> Flags:
    """Return a mask (N,) of a replay's rows that count: no warm-up, disturbed rounds only if all.

    No disturbed round counts, unless all of them are.
    """
    rounds: Flags = repeat != WARM_UP
    undisturbed = rounds & ~disturbed
    return undisturbed if undisturbed.any() else rounds


def has_enough_samples_for_percentile(samples: int, percent: float) -> bool:
    """Return whether at least `BEYOND` samples lie beyond a percentile."""
    return samples * (100.0 - percent) / 100.0 >= BEYOND - 1e-9


def percentile_or_nan(values: Floats, percent: float) -> float:
    """Return a percentile of values; NaN where too few samples lie beyond it."""
    if not has_enough_samples_for_percentile(len(values), percent):
        return float(np.nan)
    return float(np.percentile(values, percent))


def median_of_known(values: Floats | Sequence[float]) -> float:
    """Return the median of the values that are not NaN; NaN without any."""
    known = _drop_nan(values)
    return float(np.median(known)) if len(known) else float(np.nan)


def maximum_of_known(values: Floats | Sequence[float]) -> float:
    """Return the largest of the values that are not NaN; NaN without any."""
    known = _drop_nan(values)
    return float(known.max()) if len(known) else float(np.nan)


def _drop_nan(values: Floats | Sequence[float]) -> Floats:
    """Return the values that are not NaN."""
    array = np.asarray(values, dtype=np.float64)
    return array[~np.isnan(array)]


def mask_decided_steps(steps: Steps) -> Flags:
    """Return a mask (N,) of steps with a certified optimum or a proof that there is none."""
    return ~_mask_column_in(steps, "certificate", (UNCERTIFIED, UNDECIDED))


def mask_failed_steps(steps: Steps) -> Flags:
    """Return a mask (N,) of steps whose answer is unusable or unfinished, though one exists.

    A QP without a feasible point has no answer; an iterate that is given all the same fails. A step
    that is undecided at rounding never does.
    """
    infeasible = _mask_column_in(steps, "certificate", (INFEASIBLE,))
    failed = (_read_flag_column(steps, "fallback") & ~infeasible) | _read_flag_column(
        steps, "unconverged"
    )
    return failed & ~_mask_column_in(steps, "certificate", (UNDECIDED,))


def select_answered_steps(steps: StepColumns, slowdown: float) -> StepColumns:
    """Return the step columns of those steps that have a solver's answer, also a late one."""
    if slowdown == 0.0:
        return steps
    answered = select_step_rows(steps, steps["total_ns"] > MISSING_INT)
    return answered | {"fallback": mask_unusable_steps(answered)}


def select_step_rows(steps: StepColumns, rows: Flags) -> StepColumns:
    """Return step columns reduced to the rows of a mask (N,)."""
    return {name: column[rows] for name, column in steps.items()}


def mask_claimed_not_true(steps: Steps) -> Flags:
    """Return a mask (N,) of steps the solver claims solved though its answer is proven wrong."""
    return (
        _read_flag_column(steps, "claimed")
        & ~_read_flag_column(steps, "true")
        & mask_decided_steps(steps)
    )


def mask_true_not_claimed(steps: Steps) -> Flags:
    """Return a mask (N,) of steps whose answer is optimal though the solver does not claim so."""
    said_none = _mask_column_in(steps, "status", NO_ANSWER_CLAIMS)
    return (
        _read_flag_column(steps, "true")
        & ~_read_flag_column(steps, "claimed")
        & ~said_none
        & mask_decided_steps(steps)
    )


def mask_unusable_steps(steps: Steps) -> Flags:
    """Return a mask (N,) of steps whose answer cannot be applied: by status, or not finite."""
    infinite: Flags = np.isinf(steps["error_plan"]) | np.isinf(steps["primal"])
    return _mask_column_in(steps, "status", _NO_USE) | np.asarray(infinite)


def mask_unfinished_steps(steps: Steps) -> Flags:
    """Return a mask (N,) of steps whose answer is an unfinished iterate, by its status."""
    return _mask_column_in(steps, "status", _UNFINISHED)


def compute_first_move_errors(steps: Steps) -> Floats:
    """Return the error (N,) of each step's first move, in maximum increments.

    Of a cascade it is the larger of that of its force and that of its thrusters.
    """
    of_move = np.asarray(steps["error_move"])
    if "allocation_error" not in steps:
        return of_move
    larger: Floats = np.fmax(of_move, np.asarray(steps["allocation_error"]))
    return larger


def _read_flag_column(steps: Steps, name: str) -> Flags:
    """Return a column of a table of steps as an array of booleans."""
    return np.asarray(steps[name], dtype=np.bool_)


def _mask_column_in(steps: Steps, name: str, values: tuple[str, ...]) -> Flags:
    """Return a mask (N,) of the steps whose text in one column is one of `values`."""
    column = steps[name]
    if isinstance(column, pd.Series):
        return column.isin(values).to_numpy(dtype=np.bool_)
    among: Flags = np.isin(column, values)
    return among
