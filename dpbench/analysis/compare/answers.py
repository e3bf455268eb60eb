"""Accuracy and control of the same configurations in two runs: figures that no clock enters.

A deterministic solver repeats them bit for bit, so there is nothing to estimate: what differs by
more than the margin, beyond what the replay rounds of one run differ among themselves, differs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import pandas as pd

from dpbench.analysis.compare.pairs import Pair
from dpbench.analysis.records import Records, RunRecord, as_float, has_steps
from dpbench.bench.judge.rules import decided, failed_steps

Change = Literal["worse", "better", "same"]
Range = tuple[float, float]

ERROR_FLOOR = 1e-9
"""Errors below it are rounding: an active-set solver's 1e-15 may become 1e-13."""
CONTROL_FLOOR = 1e-12
"""Control figures below it are zero [m, deg, 1]."""
ORDER = ("finished", "timed_out", "invalid", "refused", "hung", "crashed")
"""Outcomes, best first."""


@dataclass(frozen=True)
class Measure:
    """A figure of a run: its column, whether less of it is better, what counts as zero.

    `relative` says that a change counts beyond the margin, else that any change does.
    """

    column: str
    head: str
    less_is_better: bool
    relative: bool
    floor: float


ACCURACY = (
    Measure("error_move_max", "largest error of the first move", True, True, ERROR_FLOOR),
    Measure("error_plan_max", "largest error of the plan", True, True, ERROR_FLOOR),
    Measure("true_share", "share of true answers", False, False, 0.0),
    Measure("failed_steps", "failed steps per round", True, False, 0.0),
)
CONTROL = (
    Measure("r_rms_m", "position, RMS [m]", True, True, CONTROL_FLOOR),
    Measure("closed_loop_cost", "closed-loop cost", True, True, CONTROL_FLOOR),
    Measure("total_variation", "total variation of the force", True, True, CONTROL_FLOOR),
)
OUTCOME = Measure("outcome", "outcome", True, False, 0.0)
DONE = Measure("steps_done", "steps done", False, False, 0.0)


@dataclass(frozen=True, eq=False)
class Answer:
    """One figure of a pair: its range over the rounds of either run, and what became of it."""

    pair: Pair
    measure: Measure
    a: Range
    b: Range
    change: Change


def compare_answers(a: Records, b: Records, pairs: Sequence[Pair], margin: float) -> list[Answer]:
    """Every figure of every pair; a pair whose outcome changed is judged by that."""
    found: list[Answer] = []
    for pair in pairs:
        ranks = tuple(float(ORDER.index(str(row["outcome"]))) for row in (pair.a, pair.b))
        if ranks[0] != ranks[1]:
            found.append(_answer(pair, OUTCOME, (ranks[0],) * 2, (ranks[1],) * 2, margin))
            continue
        if not (has_steps(pair.a) or has_steps(pair.b)):
            continue
        # A step limit in seconds stops a slow configuration somewhere: no property of its answers.
        if pair.a["outcome"] != "timed_out":
            done = [as_float(row["steps_done"]) for row in (pair.a, pair.b)]
            found.append(_answer(pair, DONE, (done[0],) * 2, (done[1],) * 2, margin))
        common = int(min(as_float(row["steps_done"]) for row in (pair.a, pair.b)))
        ranges = _accuracy(a, pair.a, common), _accuracy(b, pair.b, common)
        for measure in ACCURACY:
            was, now = (side[measure.column] for side in ranges)
            found.append(_answer(pair, measure, was, now, margin))
        for measure in CONTROL if pair.a["mode"] == "closed_loop" else ():
            one, other = (as_float(row[measure.column]) for row in (pair.a, pair.b))
            found.append(_answer(pair, measure, (one, one), (other, other), margin))
    return found


def _answer(pair: Pair, measure: Measure, a: Range, b: Range, margin: float) -> Answer:
    return Answer(pair, measure, a, b, _change(measure, a, b, margin))


def _change(measure: Measure, a: Range, b: Range, margin: float) -> Change:
    """What became of a figure; two missing ones are the same, one that went missing is worse."""
    if any(math.isnan(side[0]) for side in (a, b)):
        gone, came = math.isnan(b[0]), math.isnan(a[0])
        return "same" if gone and came else "worse" if gone else "better"
    factor = 1.0 + margin if measure.relative else 1.0
    less = "better" if measure.less_is_better else "worse"
    more = "worse" if measure.less_is_better else "better"
    if b[0] > max(factor * a[1], measure.floor):
        return more  # type: ignore[return-value] # one of the two words above
    if a[0] > max(factor * b[1], measure.floor):
        return less  # type: ignore[return-value] # the other one
    return "same"


def _accuracy(records: Records, row: RunRecord, common: int) -> dict[str, Range]:
    """Least and largest over the counting rounds of each figure, on the first `common` steps."""
    steps = records.steps(row)
    counting = steps[steps["counts"] & (steps["k"] < common)]
    if counting.empty:
        once = {m.column: as_float(row[m.column]) for m in ACCURACY}
        return {name: (value, value) for name, value in once.items()}
    failed, true = failed_steps(counting), counting["true"].where(decided(counting))
    rounds = counting.assign(failed=failed.astype(float), true=true.astype(float)).groupby("repeat")
    each = {
        "error_move_max": rounds["error_move"].max(),
        "error_plan_max": rounds["error_plan"].max(),
        "true_share": rounds["true"].mean(),
        "failed_steps": rounds["failed"].sum(),
    }
    return {name: _range(values) for name, values in each.items()}


def _range(values: pd.Series[float]) -> Range:
    return float(values.min()), float(values.max())
