"""Who is fastest: of all verdicts, at an accuracy, on common steps; and which one to use.

To use is the fastest that nothing contradicts and that can go aboard a ship. The fastest of all may
exist only as this benchmark's own Python code. It is named, and never recommended by itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dpbench.analysis.times.pooled import CommonSteps, PooledTimes
from dpbench.analysis.times.work_precision import LevelPoint
from dpbench.analysis.verdict import Verdict, Verdicts
from dpbench.bench.record.configuration import settings_level
from dpbench.errors import UnknownNameError
from dpbench.solvers.record import SolverRecord
from dpbench.solvers.table import record

ALIKE = 0.03
"""Settings whose figures differ by less are equally fast: another day may swap them."""


def fastest_first(verdicts: Sequence[Verdict]) -> list[Verdict]:
    """By p99, those without one by their largest step time, those without time last."""
    return sorted(
        verdicts,
        key=lambda v: (_known(v.p99_ns), _known(v.algo_max_ns), v.configuration.solver),
    )


def _known(time_ns: float) -> float:
    return time_ns if math.isfinite(time_ns) else math.inf


def ranked(verdicts: Verdicts) -> list[Verdict]:
    """The configurations that nothing is said against, timed on as many sequences as any; the
    fastest first, and of two names of one run the more usual settings."""
    ranks = [verdict for verdict in verdicts.all if verdict.ranks]
    widest = max((verdict.replays for verdict in ranks), default=0)
    wide = [verdict for verdict in ranks if verdict.replays == widest]
    return fastest_first(sorted(wide, key=_level))


def fastest_of(verdicts: Verdicts, solver: str) -> Verdict | None:
    """The fastest configuration of one solver, at its most usual settings where others are hardly
    faster."""
    own = [verdict for verdict in ranked(verdicts) if verdict.configuration.solver == solver]
    return _most_usual(own) if own else None


def podium(verdicts: Verdicts) -> list[Verdict]:
    """The fastest configuration of each solver, the fastest solver first."""
    by_solver: dict[str, list[Verdict]] = {}
    for verdict in ranked(verdicts):
        by_solver.setdefault(verdict.configuration.solver, []).append(verdict)
    return [_most_usual(own) for own in by_solver.values()]


def _most_usual(own: Sequence[Verdict]) -> Verdict:
    """Of one solver's verdicts, the fastest first: the most usual settings that are as fast."""
    best = own[0]
    alike = [
        verdict
        for verdict in own
        if verdict.configuration.route == best.configuration.route
        and verdict.configuration.policy == best.configuration.policy
        and _figure(verdict) <= (1.0 + ALIKE) * _figure(best)
    ]
    return min(alike, key=_level)


def _level(verdict: Verdict) -> tuple[int, str]:
    return settings_level(verdict.configuration.settings)


def _figure(verdict: Verdict) -> float:
    return verdict.p99_ns if math.isfinite(verdict.p99_ns) else verdict.p50_ns


@dataclass(frozen=True)
class Recommendation:
    """The answer of a result folder.

    Parameters
    ----------
    chosen : the fastest configuration that can be deployed; None where nobody qualifies.
    runner_up : the fastest one of another solver that can be.
    faster : the fastest of all, where that is another one; `because` says why it is not chosen.
    """

    chosen: Verdict | None
    runner_up: Verdict | None
    faster: Verdict | None
    because: str = ""


def recommend(verdicts: Verdicts) -> Recommendation:
    """The recommendation: by p99, among those that meet the demand.

    Where nobody can meet it, as the suite has no closed loop, those that nothing contradicts are
    compared; their outcome says that it is open.
    """
    open_or_met = podium(verdicts)
    candidates = [verdict for verdict in open_or_met if verdict.outcome == "meets"] or open_or_met
    aboard = [v for v in candidates if not why_not_aboard(v.configuration.solver)]
    chosen = aboard[0] if aboard else None
    faster = candidates[0] if candidates and candidates[0] is not chosen else None
    because = why_not_aboard(faster.configuration.solver) if faster is not None else ""
    return Recommendation(chosen, aboard[1] if aboard[1:] else None, faster, because)


def known_record(solver: str) -> SolverRecord | None:
    """The record of a solver; None for one that this installation does not know."""
    try:
        return record(solver)
    except UnknownNameError:
        return None


def why_not_aboard(solver: str) -> str:
    """Why a solver cannot go aboard as it is; "" where it can."""
    known = known_record(solver)
    return "not in the table of this installation" if known is None else known.why_not_aboard


def fastest_at(
    levels_by_solver: Mapping[str, Sequence[LevelPoint]], error_move: float
) -> list[str]:
    """Solvers with a point of this accuracy and without a failed step, the fastest p50 first."""
    best = {
        solver: min(
            (point.p50_ns for point in points if point.reaches(error_move)), default=math.inf
        )
        for solver, points in levels_by_solver.items()
    }
    return sorted((s for s in best if math.isfinite(best[s])), key=lambda solver: best[solver])


def fastest_on(common_steps: CommonSteps, solver: str | None) -> PooledTimes:
    """The configuration that others are compared with on common steps, the baseline.

    The fastest, by the geometric mean of its step times, among those of `solver` (of all where it
    is None or was not replayed) that meet the demand; among those that do not if there is none.
    """
    own = [p for p in common_steps.pooled if p.configuration.solver == solver]
    candidates = own or list(common_steps.pooled)
    right = [pooled for pooled in candidates if pooled.right] or candidates
    return min(right, key=lambda pooled: _mean_log(pooled, common_steps))


def _mean_log(pooled: PooledTimes, common_steps: CommonSteps) -> float:
    """Mean logarithm of the step times; a configuration that has not done every step comes last."""
    mean = float(common_steps.weights @ np.log(pooled.time_ns))
    return mean if np.isfinite(mean) else math.inf
