"""Rank the step times of replayed arms and compare them in pairs, step by step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.report.statistics import UNKNOWN, Floats, Interval, paired_ratio
from dpbench.report.verdict import Verdict
from dpbench.report.view import Row, StepTimes, View


@dataclass(frozen=True)
class Duel:
    """Two solvers on the same steps: how many times as long `second` takes as `first`.

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


def fastest_first(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """Verdicts by p99, those without one by their largest step time, those without time last."""
    return sorted(verdicts, key=lambda v: (_known(v.p99_ns), _known(v.algo_max_ns), v.solver))


def _known(value: float) -> float:
    return value if math.isfinite(value) else math.inf


def paired(slower: StepTimes, faster: StepTimes) -> tuple[Floats, Floats]:
    """Algorithmic times of the steps that both arms have done."""
    _, mine, theirs = np.intersect1d(slower.k, faster.k, return_indices=True)
    return slower.algo_ns[mine], faster.algo_ns[theirs]


def duel(view: View, first: Verdict, second: Verdict) -> Duel:
    """Compare two solvers on the steps of all sequences, policy fresh."""
    slow: list[Floats] = []
    fast: list[Floats] = []
    leaders: dict[str, str] = {}
    for sequence in view.sequences:
        both = [_fresh(view, sequence, verdict) for verdict in (first, second)]
        if both[0] is None or both[1] is None:
            continue
        a, b = paired(both[1], both[0])
        if len(a) == 0:
            continue
        slow.append(a)
        fast.append(b)
        leaders[f"median on `{sequence}`"] = (
            first.solver if np.median(b) <= np.median(a) else second.solver
        )
    if not slow:
        return Duel(first.solver, second.solver, UNKNOWN, 0, {})
    mine, theirs = np.concatenate(slow), np.concatenate(fast)
    leaders["p99"] = first.solver
    return Duel(first.solver, second.solver, paired_ratio(mine, theirs), len(mine), leaders)


def _fresh(view: View, sequence: str, verdict: Verdict) -> StepTimes | None:
    rows: list[Row] = view.replays(
        sequence, solver=verdict.solver, settings=verdict.settings, policy="fresh"
    )
    return view.times(rows[0]) if rows else None
